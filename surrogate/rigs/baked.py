"""Few shapes for the expressions a rig is likely to be asked for: a remainder in few modes, or plain morph targets."""

from __future__ import annotations

import numbers
from dataclasses import dataclass, replace
from functools import cache
from os import PathLike

import numpy as np
from scipy.linalg.blas import ssyrk

from ...lhm.base.checks import real
from ...lhm.base.errors import InputError
from ...lhm.base.files.glb import write_glb
from ...lhm.base.files.morphs import Morphs, morph_take
from ...lhm.base.mesh import Floats32, Ints, Surface
from ...lhm.expressions import Take, conversation
from ...lhm.expressions.made_up import combinations
from .inertia import DynamicRig, Swings, dynamic_rig
from .rig import (
    WEIGHTS,
    FaceModes,
    Remainder,
    add_combination,
    check_out,
    check_weights,
    clip_weights,
)

APART = 8
"""Frames of a conversation: those in a row hardly differ."""
LEFT_OUT, COMPRESSED = 5e-4, 300
"""[mm] Root mean square over vertices and usual expressions of what may be left out of the remainder; and how many."""
SAMPLED = 400
"""Expressions of each of made-up conversation and random combinations, which the targets are chosen for."""


@cache
def usual_expressions(seed: int, count: int) -> Floats32:
    """Return weights (2 count, 52): every APART-th frame of a made-up conversation, then random combinations."""
    talked = conversation(np.random.default_rng([seed, 0]), APART * count)[::APART]
    random = combinations(np.random.default_rng([seed, 1]), count)
    weights: Floats32 = np.concatenate([talked, random]).astype(np.float32)
    weights.flags.writeable = False
    return weights


def compress(full: FaceModes) -> FaceModes:
    """Return the same face in principal components of its remainder: they are what a frame costs; see LEFT_OUT."""
    amplitudes = full.remainder_of(usual_expressions(2, COMPRESSED)).astype(np.float64)
    flat = full.modes.reshape(len(full.modes), -1)
    second = amplitudes.T @ amplitudes / len(amplitudes)
    # Both Gram matrices count: components of amplitudes · modes are wanted, and modes are not orthogonal.
    gram = ssyrk(1.0, flat.T, trans=1).astype(np.float64)  # its upper triangle, in a third of a product's time
    size, turn = np.linalg.eigh(gram, UPLO="U")
    root = turn * np.sqrt(np.maximum(size, 1e-12 * size[-1]))
    power, vectors = np.linalg.eigh(root.T @ second @ root)
    tail = np.cumsum(np.maximum(power, 0.0)) / full.modes.shape[1]
    kept = vectors[:, np.count_nonzero(tail <= LEFT_OUT**2) :][:, ::-1]
    into = root @ kept  # amplitudes of the components, of those of the modes
    back = np.linalg.solve(root.T, kept).T  # components, of the modes
    remainder = full.remainder_of
    return replace(
        full,
        modes=(back.astype(np.float32) @ flat).reshape(-1, *full.modes.shape[1:]),
        remainder_of=replace(
            remainder,
            outer=np.ascontiguousarray(remainder.outer @ into, dtype=np.float32),
            linear=np.ascontiguousarray(remainder.linear @ into, dtype=np.float32),
            rest=(remainder.rest @ into).astype(np.float32),
        ),
    )


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
    swing: Swings | None = None

    def __post_init__(self):
        for array in (self.neutral, self.targets, self.mixing):
            array.flags.writeable = False  # a frame might be asked to be written over them

    def target_weights(self, weights) -> Floats32:
        """Weights of the targets, shape (..., rank), for ARKit weights (..., 52), clipped to [0, 1] with a warning."""
        with np.errstate(over="ignore"):  # which is clipped
            weights = real("weights", weights).astype(np.float32)
        if weights.shape[-1:] != (WEIGHTS,):
            raise InputError(f"weights: expected the {WEIGHTS} of ARKit, got shape {weights.shape}")
        inside = clip_weights(weights, stacklevel=3)
        return np.concatenate([inside, self.remainder_of(inside)], axis=-1) @ self.mixing

    def frame(self, weights, blended=None, *, out: Floats32 | None = None) -> Floats32:
        """The skin [mm], shape (n, 3), for 52 ARKit weights; written to `out`, if given. It takes no `blended`."""
        if blended is not None:
            raise InputError("blended: a baked rig has the blendshapes in its targets")
        weights, surface = check_weights(weights), check_out(out, self.neutral.shape)
        amplitudes = np.empty(len(self.mixing), dtype=np.float32)
        amplitudes[: len(weights)] = weights
        self.remainder_of.write(weights, amplitudes[len(weights) :])
        surface[:] = self.neutral
        add_combination(amplitudes @ self.mixing, self.targets.reshape(len(self.targets), -1), surface.reshape(-1))
        return surface

    def write_gltf(self, path: str | PathLike[str], take: Take) -> None:
        """Write the rig as glTF: its neutral skin, its targets, and their weights over a take.

        The targets serve any take, by weights that `target_weights` gives. The error of leaving out more stands in the
        asset's `extras`. Raises InputError for a file that cannot be written.
        """
        usual, played = self.target_weights(usual_expressions(1, SAMPLED)), self.target_weights(take.weights)
        reach = np.maximum(np.abs(np.concatenate([usual, played])).max(axis=0), 1e-6)
        morphs = Morphs(played / reach, self.targets * reach[:, None, None], self.largest_error)
        neutral = Surface(self.neutral.astype(np.float64), self.triangles)
        write_glb(path, morph_take("rig", neutral, take.times, morphs, usual / reach))

    def dynamic(self, time_step: float = 1.0 / 60.0) -> DynamicRig:
        """Frames with inertia (Eq. 21), time_step [s] apart; see `BoundSurrogate.dynamic`."""
        return dynamic_rig(self, self.swing, time_step)


def bake(
    neutral: Floats32,
    shapes: Floats32,
    remainder_of: Remainder,
    triangles: Ints,
    rank: int,
    swing: Swings | None = None,
) -> BakedRig:
    """Find the best `rank` targets for usual expressions from shapes (52 + k, 3 n) [mm]: their principal components."""
    if isinstance(rank, bool) or not isinstance(rank, numbers.Integral) or rank < 1:
        raise InputError(f"bake rank: expected a whole number from 1 on, got {rank!r}")
    rank = min(int(rank), len(shapes))
    expressions = (usual_expressions(seed, SAMPLED) for seed in (0, 1))
    chosen, other = (np.concatenate([w, remainder_of(w)], axis=1) for w in expressions)
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
