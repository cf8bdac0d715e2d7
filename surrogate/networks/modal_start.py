"""What a modal training begins with: drawn layers, and principal components of remainders."""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats32, Ints
from .components import find_components
from .modal import QUIET, WITHOUT_BIAS, ModalConfig, remainder_layers
from .modal_faces import LessonFaces
from .table_training import draw_mixers
from .trainer import draw_layers, draw_positions, quieten

FRAMES = 4
"""Of each face whose remainders the modes start from."""


def draw_network(
    data: LessonFaces, config: ModalConfig, framed: Ints, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Return a network without tables, whose modes are principal components of the remainders of some faces."""
    mean = data.corpus.mean
    modes, sizes = find_components(_sample_remainders(data, framed, rng), config.modes, rng)
    place = draw_positions(mean.vertices, mean.vertex_normals, config.position, rng)
    mixers = draw_mixers(config, mean, data.code_size, rng)
    layers = draw_layers(remainder_layers(config, data.features, data.code_size), WITHOUT_BIAS)
    quieten(layers, QUIET)
    layers["remainder_linear.weight"] *= 0.0
    return mixers | {
        **{name: value.numpy() for name, value in layers.items()},
        "gain_position": place,
        "modes": modes.reshape(len(modes), *mean.vertices.shape) * np.sqrt(np.float32(mean.vertices.size)),
        "size_remainder": sizes.astype(np.float32),
    }


def _sample_remainders(data: LessonFaces, framed: Ints, rng: np.random.Generator) -> Floats32:
    """Return what some frames of faces have beyond first order [mm], a row (3 n,) each."""
    rows = []
    for number in framed.tolist():
        (face,) = data.draw_sides(data.faces([number]), rng)
        frames = data.corpus.frames(number, rng.permutation(len(data.corpus.frames_of[number]))[:FRAMES])
        rows.append(face.see(frames).remainder(face).reshape(len(frames.weights), -1))
    return np.vstack(rows)
