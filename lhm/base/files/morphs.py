"""Rigs of morph targets, as glTF and USD have them: surfaces that one set of weights moves; a motion as few targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..mesh import Floats, Floats32, Surface

COLOUR = (0.69, 0.37, 0.27)
"""Colour of skin, in linear light."""


@dataclass(frozen=True, eq=False)
class MorphedSurface:
    """A surface at rest, and what each target at full weight adds to its positions [mm] and normals, (t, n, 3) each.

    A surface that stands still has no targets. Its node then may stand at `place` (3,) [mm], from where its vertices
    are, and turn about that. colour: red, green, blue in linear light, shape (3,) or (n, 3).
    """

    name: str
    rest: Surface
    targets: Floats | Floats32
    normals: Floats
    colour: Floats | tuple[float, float, float] = COLOUR
    place: Floats | tuple[float, float, float] = (0.0, 0.0, 0.0)

    @classmethod
    def from_targets(cls, name: str, rest: Surface, targets: Floats | Floats32, **look: Any) -> MorphedSurface:
        """Make a surface whose normals are right at rest and with any one target at full weight."""
        usual = np.eye(len(targets))
        return cls(name, rest, targets, fit_normals(rest, targets, usual), **look)


@dataclass(frozen=True, eq=False)
class MorphRig:
    """Surfaces that move by the same named targets; their weights (k, t) at `times` (k,) [s] where a take plays.

    notes: what its file tells of it, texts and numbers by name.
    """

    surfaces: Sequence[MorphedSurface]
    names: Sequence[str]
    notes: Mapping[str, Any] = field(default_factory=dict)
    times: Floats = field(default_factory=lambda: np.zeros(0))
    weights: Floats | Floats32 = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True, eq=False)
class Morphs:
    """A motion as neutral + weights · targets: weights (k, t), targets (t, n, 3) [mm], greatest error [mm]."""

    weights: Floats
    targets: NDArray[np.float32]
    error: float


def reduce_to_morphs(motion: NDArray[np.float32], *, tolerance: float, most: int = 256) -> Morphs:
    """Find as few morph targets as bring every vertex of every frame within `tolerance` [mm], at most `most`.

    motion (k, n, 3) [mm]: displacements from neutral. The targets are chosen greedily: the displacement that is worst
    represented so far, less what the earlier targets have of it (a reduced basis, with its bound on the worst case
    that principal components lack). Each weight reaches 1 at the frame that its target is taken from.
    """
    remainder = np.array(motion, dtype=np.float32).reshape(len(motion), -1)
    targets: list[NDArray[np.float32]] = []
    columns: list[Floats] = []
    while True:
        off = np.sqrt((remainder.reshape(len(remainder), -1, 3) ** 2).sum(axis=2).max(axis=1))
        worst = int(np.argmax(off))
        if off[worst] <= tolerance or len(targets) == min(most, len(motion)):
            weights = np.stack(columns, axis=1) if columns else np.zeros((len(motion), 0))
            stacked = np.array(targets, dtype=np.float32).reshape(len(targets), motion.shape[1], 3)
            return Morphs(weights, stacked, float(off[worst]))
        target = remainder[worst].copy()
        column = (remainder @ target) / np.float32(target @ target)
        remainder -= column[:, None] * target
        targets.append(target)
        columns.append(column.astype(np.float64))


def morph_take(name: str, neutral: Surface, times: Floats, morphs: Morphs, usual: Floats) -> MorphRig:
    """Make the rig of a skin [mm] that plays a motion's morphs at `times` (k,) [s], rising.

    usual: weights (u, t) for which the normals of the targets are fitted. Targets have no meaning of their own, and
    their numbers as names. The notes tell the error.
    """
    skin = MorphedSurface(name, neutral, morphs.targets, fit_normals(neutral, morphs.targets, usual))
    names = [f"component {k + 1}" for k in range(len(morphs.targets))]
    return MorphRig([skin], names, {"greatest_error_mm": morphs.error}, times, morphs.weights)


def fit_normals(neutral: Surface, targets: Floats | Floats32, weights: Floats | Floats32) -> Floats:
    """Fit what each target adds to the normals, (t, n, 3), by least squares over skins of weights (u, t).

    At most 4 t + 8 of them are taken, evenly.
    """
    count = len(targets)
    if not count:
        return np.zeros((0, *neutral.vertices.shape))
    some = np.unique(np.linspace(0, len(weights) - 1, min(len(weights), 4 * count + 8)).astype(int))
    moved = (np.tensordot(weights[k], targets, axes=1) for k in some)
    turned = np.array([neutral.with_vertices(neutral.vertices + one).vertex_normals for one in moved])
    turned -= neutral.vertex_normals
    fitted = np.linalg.lstsq(weights[some], turned.reshape(len(some), -1), rcond=1e-6)[0]
    return fitted.reshape(count, *neutral.vertices.shape)
