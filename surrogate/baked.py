"""A bound surrogate as plain morph targets, which any engine draws: few of them, with the error of leaving out more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..lhm.errors import InputError
from ..lhm.expressions import conversation
from ..lhm.expressions.combinations import combinations
from ..lhm.mesh import Floats32, Ints
from .rigs import add_combination

SAMPLED = 400
"""Expressions of each of made-up conversation and random combinations, which the targets are chosen for."""


@dataclass(frozen=True, eq=False)
class BakedRig:
    """neutral (n, 3) and targets (rank, n, 3) [mm]; `mixing` (52 + k, rank) from weights and the network's amplitudes.

    mean_error and largest_error [mm]: of vertices, over expressions that the targets were not chosen for.
    """

    neutral: Floats32
    targets: Floats32
    triangles: Ints
    mixing: Floats32
    remainder_of: Callable[[Floats32], Floats32]
    mean_error: float
    largest_error: float

    def target_weights(self, weights) -> Floats32:
        """Weights of the targets, shape (..., rank), for ARKit weights (..., 52)."""
        weights = np.asarray(weights, dtype=np.float32)
        return np.concatenate([weights, self.remainder_of(weights)], axis=-1) @ self.mixing

    def frame(self, weights) -> Floats32:
        """The skin [mm], shape (n, 3), for 52 ARKit weights."""
        surface = self.neutral.copy()
        add_combination(self.target_weights(weights), self.targets.reshape(len(self.targets), -1), surface.reshape(-1))
        return surface


def baked(
    neutral: Floats32, shapes: Floats32, remainder_of: Callable[[Floats32], Floats32], triangles: Ints, rank: int
) -> BakedRig:
    """The best `rank` targets for usual expressions, from shapes (52 + k, 3 n) [mm]: their principal components."""
    if isinstance(rank, bool) or not isinstance(rank, int) or not 1 <= rank <= len(shapes):
        raise InputError(f"bake rank: expected a whole number from 1 to {len(shapes)}, got {rank!r}")
    chosen, other = (_amplitudes(seed, remainder_of) for seed in (0, 1))
    second = (chosen.T @ chosen).astype(np.float64) / len(chosen)
    size, turn = np.linalg.eigh(second + 1e-9 * np.trace(second) * np.eye(len(second)))
    root = (turn * np.sqrt(np.maximum(size, 0.0))).T
    gram = root @ (shapes @ shapes.T).astype(np.float64) @ root.T
    _, vectors = np.linalg.eigh(gram)
    targets = np.linalg.qr((shapes.T @ (root.T @ vectors[:, ::-1][:, :rank])).astype(np.float64))[0].T
    mixing = shapes @ targets.T.astype(np.float32)
    wrong = (other @ shapes - (other @ mixing) @ targets.astype(np.float32)).reshape(len(other), -1, 3)
    distance = np.linalg.norm(wrong, axis=2)
    return BakedRig(
        neutral=neutral,
        targets=np.ascontiguousarray(targets, dtype=np.float32).reshape(rank, -1, 3),
        triangles=triangles,
        mixing=mixing.astype(np.float32),
        remainder_of=remainder_of,
        mean_error=float(distance.mean()),
        largest_error=float(distance.max()),
    )


def _amplitudes(seed: int, remainder_of) -> Floats32:
    weights = np.concatenate(
        [
            conversation(np.random.default_rng([seed, 0]), SAMPLED),
            combinations(np.random.default_rng([seed, 1]), SAMPLED),
        ]
    ).astype(np.float32)
    return np.concatenate([weights, remainder_of(weights)], axis=1)
