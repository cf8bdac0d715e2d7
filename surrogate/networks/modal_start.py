"""What a modal training begins with: drawn layers, and principal components of remainders; or earlier weights."""

from __future__ import annotations

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats32, Ints
from .modal import QUIET, WITHOUT_BIAS, ModalConfig, modal_layers, modal_shapes
from .modal_faces import LessonFaces
from .ridge import find_components
from .tables import IN_FILE
from .trainer import Tensors, draw_layers, draw_positions, torch
from .weights import Weights

FRAMES = 4
"""Of each face whose remainders the modes start from."""
QUIETER = 0.1
"""Of the usual weights, in layers that begin near zero."""


def continue_network(start: Weights, data: LessonFaces, config: ModalConfig) -> tuple[Tensors, dict[str, Floats32]]:
    """Return the network of earlier weights, and its tables as a file has them; InputError where they do not fit."""
    if start.kind != "modal":
        raise InputError(f"training: the weights to begin with are of a {start.kind} network, not of a modal one")
    start.check_mesh(data.corpus.mean)
    expected = modal_shapes(config, data.features, data.code_size)
    if any(start.network[name].shape != shape for name, shape in expected.items()):
        raise InputError("training: the weights to begin with have other sizes than the network's config")
    tables = {name: np.array(value) for name, value in start.network.items() if name.endswith(IN_FILE)}
    rest = {name: value for name, value in start.network.items() if name not in tables}
    return {name: torch.from_numpy(np.array(value)) for name, value in rest.items()}, tables


def draw_network(data: LessonFaces, config: ModalConfig, framed: Ints, rng: np.random.Generator) -> Tensors:
    """Return a network without tables, whose modes are principal components of the remainders of some faces."""
    network = draw_layers(modal_layers(config, data.features, data.code_size), WITHOUT_BIAS)
    for name in QUIET:
        network[f"{name}.weight"] *= QUIETER
        network[f"{name}.bias"] *= 0.0
    network["remainder_linear.weight"] *= 0.0
    mean = data.corpus.mean
    arrays = {
        f"{name}_position": draw_positions(mean.vertices, mean.vertex_normals, config.position, rng)
        for name in ("gain", "response", "effect")
    }
    modes, sizes = find_components(_sample_remainders(data, framed, rng), config.modes, rng)
    arrays["modes"] = modes.reshape(len(modes), *mean.vertices.shape) * np.sqrt(np.float32(mean.vertices.size))
    arrays["size_remainder"] = sizes.astype(np.float32)
    return network | {name: torch.from_numpy(array) for name, array in arrays.items()}


def _sample_remainders(data: LessonFaces, framed: Ints, rng: np.random.Generator) -> Floats32:
    """Return what some frames of faces have beyond first order [mm], a row (3 n,) each."""
    rows = []
    for number in framed.tolist():
        (face,) = data.draw_sides(data.faces([number]), rng)
        frames = data.corpus.frames(number, rng.permutation(len(data.corpus.frames_of[number]))[:FRAMES])
        rows.append(face.see(frames).remainder(face).reshape(len(frames.weights), -1))
    return np.vstack(rows)
