"""Muscles and skull carried by their wraps (SoftDECA 3.1.1, last step: B = RBF of the skull wrap's motion at B_T)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from ..base.geometry.warp import TriharmonicWarp, farthest_points
from ..base.mesh import Floats, Ints, Surface
from ..head import CRANIUM, FREE, MANDIBLE

CENTRES = 400


@dataclass(frozen=True, eq=False)
class Carrier:
    """Moves a surface with the vertices of a wrap; factorised once per template.

    `surface` [mm] and `wrap` (n, 3) [mm] as in the template; `chosen` (k,): the wrap's vertices that lead.
    """

    surface: Surface
    wrap: Floats = field(repr=False)
    chosen: Ints = field(repr=False)
    _warp: TriharmonicWarp = field(init=False, repr=False)
    _basis: Floats = field(init=False, repr=False)

    def __post_init__(self):
        warp = TriharmonicWarp(self.wrap[self.chosen])
        object.__setattr__(self, "_warp", warp)
        object.__setattr__(self, "_basis", warp.basis(self.surface.vertices))

    @classmethod
    def of(cls, surface: Surface, wrap: Floats, among: Ints) -> Carrier:
        """Led by up to CENTRES of the wrap's vertices `among` (k,), the farthest from one another."""
        first = np.zeros(1, dtype=np.int64)
        count = min(CENTRES, len(among))
        return cls(surface, wrap, among[farthest_points(wrap[among], count, first)])

    def moved(self, wrap: Floats) -> Surface:
        """The surface [mm] when the wrap is at `wrap` (n, 3) [mm]."""
        coefficients = self._warp.coefficients(wrap[self.chosen] - self.wrap[self.chosen])
        return self.surface.with_vertices(self.surface.vertices + self._basis @ coefficients)


class SkullCarrier:
    """Cranium and mandible carried apart, each led by the wrap over it, and blended between them by distance."""

    def __init__(self, skull: Surface, skull_bone: Ints | None, wrap: Floats, bone: Ints):
        self.skull = skull
        self.cranium = Carrier.of(skull, wrap, np.flatnonzero(bone != MANDIBLE))
        self.mandible: Carrier | None = None
        if skull_bone is not None and (skull_bone == MANDIBLE).any() and np.count_nonzero(bone == MANDIBLE) >= 8:
            self.mandible = Carrier.of(skull, wrap, np.flatnonzero(bone == MANDIBLE))
            self.share = _mandibular(skull.vertices, skull_bone)[:, None]

    def moved(self, wrap: Floats) -> Surface:
        """The skull [mm] when the skull wrap is at `wrap` (n, 3) [mm]."""
        moved = self.cranium.moved(wrap)
        if self.mandible is None:
            return moved
        x = (1 - self.share) * moved.vertices + self.share * self.mandible.moved(wrap).vertices
        return self.skull.with_vertices(x)


def _mandibular(points: Floats, bone: Ints) -> Floats:
    """1 on the mandible, 0 on the cranium, between them by the distances to both, shape (k,)."""
    share = (bone == MANDIBLE).astype(np.float64)
    free = np.flatnonzero(bone == FREE)
    to = [cKDTree(points[bone == label]).query(points[free])[0] for label in (CRANIUM, MANDIBLE)]
    share[free] = to[0] / np.maximum(to[0] + to[1], 1e-12)
    return share
