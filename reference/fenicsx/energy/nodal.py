"""The base of classes that model terms given node by node."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Self

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ..mesh.numbering import Numbering


class NodalEnergy(ABC):
    """Elements with their energy, its gradient and its Hessian by positions of `nodes` (m, k), on one rank.

    `is_load` says that they follow a load: they grow with it, hold nothing, and their Hessian need not be symmetric.
    """

    is_load: ClassVar[bool] = False
    nodes: Ints

    @classmethod
    @abstractmethod
    def from_scene(cls, scene: Scene, numbering: Numbering) -> Sequence[Self]:
        """Make the elements of all terms of one kind; SceneError for those that the mesh has no nodes for."""

    @abstractmethod
    def energy(self, x: Floats) -> float:
        """Return the energy [µJ] at nodes x [mm], shape (n, 3)."""

    @abstractmethod
    def add_gradient(self, x: Floats, into: Floats):
        """Add the energy's gradient [mN] to an array (n, 3)."""

    @abstractmethod
    def hessian(self, x: Floats, kept: float) -> Floats:
        """Return the Hessian's blocks [mN/mm], shape (m, k, k, 3, 3): node, node, component, component.

        Negative curvature is multiplied by `kept`: 1 for the exact Hessian, 0 for its projection.
        """
