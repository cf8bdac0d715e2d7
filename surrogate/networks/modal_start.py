"""What a modal training begins with: principal components of what it learns, or earlier weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32
from ..rigs.rig import WEIGHTS
from .features import EFFECTS, Features, Inputs
from .modal import PARTS, QUIET, WITHOUT_BIAS, ModalConfig, modal_layers, modal_shapes
from .modal_faces import LessonFace, LessonFaces, NeutralMotion
from .response_tables import expand
from .ridge import find_components
from .trainer import Tensors, draw_layers, draw_positions, torch
from .weights import Weights

SOLVED = ("response_table", "response_scale")
"""What a file has in place of the `tables` that are solved for in training; see `response_tables`."""


@dataclass(frozen=True)
class StartPolicy:
    """Constants of the start from principal components."""

    more: int = 2  # times as many faces without frames as with
    frames: int = 4  # of each sampled face
    quiet: float = 0.1  # of the usual weights, in layers that begin near zero
    effect_penalty: float = 3.0  # of the ridge regression of effects, by an effect's mean square
    linear_penalty: float = 0.2  # of that of amplitudes, by the number of faces


def continue_network(start: Weights, data: LessonFaces, config: ModalConfig) -> Tensors:
    """Return the network of earlier weights; InputError where they do not fit."""
    if start.kind != "modal":
        raise InputError(f"training: the weights to begin with are of a {start.kind} network, not of a modal one")
    start.check_mesh(data.corpus.mean)
    expected = modal_shapes(config, data.features, data.code_size)
    if any(start.network[name].shape != shape for name, shape in expected.items()):
        raise InputError("training: the weights to begin with have other sizes than the network's config")
    network = {name: value for name, value in start.network.items() if name not in SOLVED}
    network["tables"] = expand(start.network)
    return {name: torch.from_numpy(np.array(value)) for name, value in network.items()}


def draw_network(
    data: LessonFaces,
    config: ModalConfig,
    sampled: int,
    rng: np.random.Generator,
    policy: StartPolicy | None = None,
) -> Tensors:
    """Return a network with modes and linear amplitudes from principal components of so many faces."""
    policy = StartPolicy() if policy is None else policy
    features, n = data.features, data.vertex_count
    numbers = rng.permutation(data.training)[:sampled]
    kept = data.faces(numbers)
    faces = data.draw_sides(kept, rng)
    more = rng.permutation(len(data.more or ()))[: policy.more * sampled]
    both = [side for face in [*kept, *data.more_faces(more)] for side in data.both_sides(face)]
    motions = [face.settling for face in both], [face.relaxing for face in both]
    effects = np.stack([fit_effects(part, features, policy) for part in motions])
    unexplained = [_subtract_effects(part, features, table) for part, table in zip(motions, effects, strict=True)]
    remainders = []
    for face, number in zip(faces, numbers, strict=True):
        frames = data.corpus.frames(int(number), rng.permutation(len(data.corpus.frames_of[number]))[: policy.frames])
        remainders.append(face.see(frames).remainder(face).reshape(-1, 3 * n))
    summaries = [_summarise_moved(both, part, data.inputs) for part in motions]
    learned = *unexplained, np.vstack(remainders)
    parts = [find_components(rows, count, rng) for rows, count in zip(learned, config.modes, strict=True)]
    arrays: dict[str, np.ndarray] = {"effects": effects}
    for number, (name, (modes, size)) in enumerate(zip(PARTS, parts, strict=True)):
        arrays |= {f"modes.{number}": modes.reshape(len(modes), n, 3) * np.sqrt(3 * n), f"size_{name}": size}
    network = draw_layers(modal_layers(config, features, data.code_size), WITHOUT_BIAS)
    for name in QUIET:
        network[f"{name}.weight"] *= policy.quiet
        network[f"{name}.bias"] *= 0.0
    network["remainder_linear.weight"] *= 0.0
    mean = data.corpus.mean
    for name in ("position", "response_position"):
        arrays[name] = draw_positions(mean.vertices, mean.vertex_normals, config.position, rng)
    arrays["tables"] = np.zeros((config.response_tables + 1, WEIGHTS, n, 3))
    for name, left, rows, (modes, _) in zip(PARTS[:2], unexplained, summaries, parts[:2], strict=True):
        arrays[f"{name}_linear.weight"] = _fit_linear(rows, left @ modes.T, policy.linear_penalty).T
    return network | {name: torch.from_numpy(value.astype(np.float32)) for name, value in arrays.items()}


def _subtract_effects(motions: Sequence[NeutralMotion], features: Features, table: Floats32) -> np.ndarray:
    """Return what effects by a table (EFFECTS, n, 3) leave of each displacement, a row (3 n,) each."""
    explained = [np.einsum("ve,evc->vc", features.effects(p, skin), table) for p, skin, _ in motions]
    return np.stack([(motion.displacement - part).ravel() for motion, part in zip(motions, explained, strict=True)])


def _summarise_moved(faces: Sequence[LessonFace], motions: Sequence[NeutralMotion], inputs: Inputs) -> Floats32:
    """Return how far each face's summary is from that of nothing moved, a row each."""
    rows = []
    for face, motion in zip(faces, motions, strict=True):
        unmoved = inputs.features.unmoved(motion.parameters)
        rows.append(inputs.summary(face.code, motion.parameters) - inputs.summary(face.code, unmoved))
    return np.stack(rows)


def fit_effects(motions: Sequence[NeutralMotion], features: Features, policy: StartPolicy) -> Floats32:
    """Fit what each effect does at each vertex, by ridge regression over faces, shape (EFFECTS, n, 3)."""
    n = len(features.mean.vertices)
    gram, products = np.zeros((n, EFFECTS, EFFECTS)), np.zeros((n, EFFECTS, 3))
    for parameters, skin, displacement in motions:
        effects = features.effects(parameters, skin).astype(np.float64)
        gram += effects[:, :, None] * effects[:, None]
        products += effects[:, :, None] * displacement[:, None].astype(np.float64)
    size = np.maximum(np.einsum("vee->ve", gram).mean(axis=0) / max(len(motions), 1), 1e-12)
    table = np.linalg.solve(gram + policy.effect_penalty * np.diag(size), products)
    return table.transpose(1, 0, 2).astype(np.float32)


def _fit_linear(features: Floats32, values: Floats32, penalty: float) -> Floats:
    rows = features.astype(np.float64)
    gram = rows.T @ rows + penalty * len(rows) * np.eye(rows.shape[1])
    return np.linalg.solve(gram, rows.T @ values)
