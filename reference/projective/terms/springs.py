"""Springs that pull vertices to places, and dead loads."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Target
from .local_step import COMPILED
from .part import Part


@dataclass(frozen=True, eq=False)
class Springs(Part):
    """Per term vertices (k,), displacements [mm] (k, 3) that draw them, and stiffness [mN/mm], (k, 1) or (1, 1).

    There are always Springs, if only of no vertices.
    """

    drawn: tuple[tuple[Ints, Floats, Floats], ...]

    @classmethod
    def from_scene(cls, scene: Scene) -> Springs:
        drawn = tuple(
            (term.vertices, term.positions - scene.vertices[term.vertices], np.reshape(term.stiffness, (-1, 1)))
            for term in scene.of(Target)
        )
        return cls(drawn)

    def for_scene(self, scene: Scene) -> Springs:
        return Springs.from_scene(scene)

    def shift(self, moved: Floats) -> Springs:
        """Move the first term's places by `moved` [mm], shape (k, 3)."""
        (vertices, displacements, stiffness), *others = self.drawn
        return Springs(((vertices, displacements + moved, stiffness), *others))

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        for vertices, displacements, stiffness in self.drawn:
            total += _add_springs(vertices, displacements, stiffness, u, gradient)
        return total

    def add_anchors(self, anchored: Floats):
        for vertices, _, stiffness in self.drawn:
            anchored[vertices] += stiffness.ravel()

    def pairs(self, scene: Scene) -> Ints:
        """Return each vertex with itself, all of them: a matrix needs its whole diagonal, whatever is drawn."""
        return np.repeat(np.arange(len(scene.vertices)), 2).reshape(-1, 2)

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        for vertices, _, stiffness in self.drawn:
            for r in range(3):
                blocks[slots[vertices], r, r] += stiffness.ravel()


@njit(**COMPILED)
def _add_springs(vertices, displacements, stiffness, u, gradient):
    """Add the springs' gradient in place; return their energy."""
    energy = 0.0
    for k in range(len(vertices)):
        vertex, weight = vertices[k], stiffness[min(k, len(stiffness) - 1), 0]
        for r in range(3):
            away = u[vertex, r] - displacements[k, r]
            gradient[vertex, r] += weight * away
            energy += 0.5 * weight * away * away
    return energy


@dataclass(frozen=True, eq=False)
class DeadLoads(Part):
    """Forces [mN], shape (n, 3), whose energy is -f·u. There are always DeadLoads, if only of zero."""

    forces: Floats

    @cached_property
    def is_zero(self) -> bool:
        """Whether nothing pushes."""
        return not self.forces.any()

    @classmethod
    def from_scene(cls, scene: Scene) -> DeadLoads:
        return cls(scene.loads())

    def for_scene(self, scene: Scene) -> DeadLoads:
        return DeadLoads.from_scene(scene)

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        if self.is_zero:
            return total
        gradient -= self.forces
        return total - float(np.vdot(self.forces, u))
