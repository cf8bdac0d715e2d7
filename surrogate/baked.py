"""A bound surrogate as plain morph targets, which any engine draws: few of them, with the error of leaving out more."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.files.moving_surface import Morphs, write_rig
from ..lhm.base.mesh import Floats32, Ints, Surface
from ..lhm.expressions import Take
from .dynamics import DynamicRig, Swing, dynamic_rig
from .modal.rig import Remainder
from .rigs import add_combination, checked_out, checked_weights
from .usual import usual_expressions

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
    remainder_of: Remainder
    mean_error: float
    largest_error: float
    swing: Swing | None = None

    def target_weights(self, weights) -> Floats32:
        """Weights of the targets, shape (..., rank), for ARKit weights (..., 52)."""
        weights = np.asarray(weights, dtype=np.float32)
        return np.concatenate([weights, self.remainder_of(weights)], axis=-1) @ self.mixing

    def frame(self, weights, blended=None, *, out: Floats32 | None = None) -> Floats32:
        """The skin [mm], shape (n, 3), for 52 ARKit weights; written to `out`, if given. It takes no `blended`."""
        if blended is not None:
            raise InputError("blended: a baked rig has the blendshapes in its targets")
        weights, surface = checked_weights(weights), checked_out(out, self.neutral.shape)
        amplitudes = np.empty(len(self.mixing), dtype=np.float32)
        amplitudes[: len(weights)] = weights
        self.remainder_of.of_one(weights, amplitudes[len(weights) :])
        surface[:] = self.neutral
        add_combination(amplitudes @ self.mixing, self.targets.reshape(len(self.targets), -1), surface.reshape(-1))
        return surface

    def write_gltf(self, path: str | PathLike[str], take: Take) -> None:
        """Write the rig as glTF: its neutral skin, its targets, and their weights over a take.

        The targets serve any take, by weights that `target_weights` gives. The error of leaving out more stands in the
        mesh's `extras`. Raises InputError for a file that cannot be written.
        """
        usual, played = self.target_weights(usual_expressions(1, SAMPLED)), self.target_weights(take.weights)
        reach = np.maximum(np.abs(np.concatenate([usual, played])).max(axis=0), 1e-6)
        rig = Morphs(played / reach, self.targets * reach[:, None, None], self.largest_error)
        neutral = Surface(self.neutral.astype(np.float64), self.triangles)
        write_rig(path, neutral, take.times, rig, usual / reach, name="rig")

    def dynamic(self, time_step: float = 1.0 / 60.0) -> DynamicRig:
        """Frames with inertia (Eq. 21), time_step [s] apart; see `BoundSurrogate.dynamic`."""
        return dynamic_rig(self, self.swing, time_step)


def baked(
    neutral: Floats32,
    shapes: Floats32,
    remainder_of: Remainder,
    triangles: Ints,
    rank: int,
    swing: Swing | None = None,
) -> BakedRig:
    """The best `rank` targets for usual expressions from shapes (52 + k, 3 n) [mm]: their principal components."""
    if isinstance(rank, bool) or not isinstance(rank, int) or rank < 1:
        raise InputError(f"bake rank: expected a whole number from 1 on, got {rank!r}")
    rank = min(rank, len(shapes))
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
        swing=swing,
    )


def _amplitudes(seed: int, remainder_of: Remainder) -> Floats32:
    weights = usual_expressions(seed, SAMPLED)
    return np.concatenate([weights, remainder_of(weights)], axis=1)
