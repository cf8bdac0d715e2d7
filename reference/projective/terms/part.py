"""The base of classes that model terms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Self

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene

NO_ENTRIES = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty(0)


class Part(ABC):
    """The energy of all terms of one kind, element by element.

    `is_bounded` says that the part's share of the PD matrix bounds its energy, so that a plain step never raises it.
    """

    is_bounded: ClassVar[bool] = True

    @classmethod
    @abstractmethod
    def from_scene(cls, scene: Scene) -> Self | None:
        """Make the part of a scene, or None where the scene has nothing of it."""

    @abstractmethod
    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        """Add the gradient [mN] at displacement u [mm], both (n, 3), in place; return `total` plus the energy [µJ]."""

    def for_scene(self, scene: Scene) -> Self:
        """Return the same elements with a scene's numbers that are `varying`."""
        return self

    def rebuilt(self, scene: Scene) -> Part | None:
        """Return the same elements with all numbers of a scene of the same terms."""
        return self.from_scene(scene)

    def add_anchors(self, anchored: Floats):
        """Add the stiffness [mN/mm] that ties vertices to places in space, to an array (n,)."""
        return

    def matrix_entries(self, scene: Scene, volume_share: float) -> tuple[Ints, Ints, Floats]:
        """Return rows, columns and values of the part's share of the PD matrix [mN/mm]; see `Energy.matrix`."""
        return NO_ENTRIES

    def elements(self, scene: Scene) -> tuple[Ints, ...]:
        """Return all that says which vertices the elements join."""
        return ()

    def pairs(self, scene: Scene) -> Ints:
        """Return the pairs of vertices (k, 2) of all elements' blocks of the Hessian, in `add_tangent`'s order."""
        return np.empty((0, 2), dtype=np.int64)

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        """Add the Hessian [mN/mm] at displacement u [mm], shape (n, 3), to blocks (pairs, 3, 3), in place.

        slots (k,): the block of each of `pairs`, which holds rows of its higher vertex. Where `least` is not negative,
        no element's eigenvalue is left below that share of its weight.
        """
        return
