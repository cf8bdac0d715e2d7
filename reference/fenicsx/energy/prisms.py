"""Prisms of three tets that share one deformation: its gradients, and the hourglass that holds what it does not see."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Hourglass
from ..mesh.numbering import Numbering
from .assembly import add_forces
from .nodal import NodalEnergy


@dataclass(frozen=True, eq=False)
class Prisms:
    """Prisms as elements of six nodes (r, 6): gradients [1/mm] of each tet's F, (r, 3, 6, 3), and of their `mean`.

    volumes (r, 3) [mm³] are of the tets; the mean, (r, 6, 3), is weighted by them.
    """

    nodes: Ints
    volumes: Floats
    gradients: Floats

    @classmethod
    def from_scene(cls, scene: Scene, numbering: Numbering) -> Prisms:
        """Make those that this rank integrates over, in the order of `numbering.prisms`."""
        tets = scene.prisms[numbering.prisms]
        vertices, corners = scene.prism_cells.vertices[numbering.prisms], scene.tets[tets]
        x = scene.vertices[corners]
        inverse = np.linalg.inv((x[..., 1:, :] - x[..., :1, :]).swapaxes(-1, -2))
        place = (corners[..., None] == vertices[:, None, None]).argmax(axis=-1)
        gradients = np.zeros((*tets.shape, 6, 3))
        np.put_along_axis(gradients, place[..., 1:, None], inverse, axis=2)
        np.put_along_axis(gradients, place[..., :1, None], -inverse.sum(axis=-2, keepdims=True), axis=2)
        return cls(numbering.dof[vertices], scene.volumes[tets], gradients)

    @property
    def mean(self) -> Floats:
        """The gradients of the mean."""
        shares = self.volumes / self.volumes.sum(axis=1, keepdims=True)
        return np.einsum("rt,rtaj->raj", shares, self.gradients)

    def deformation(self, u: Floats) -> Floats:
        """Return the mean F, shape (r, 3, 3), at a displacement [mm] by node, (n, 3)."""
        return np.eye(3) + np.einsum("rai,raj->rij", u[self.nodes], self.mean)


@dataclass(frozen=True, eq=False)
class Hourglasses(NodalEnergy):
    """weight/2 ‖F_t - F‖² of prisms' tets: gradients (r, 3, 6, 3) are of F_t - F, weight (r, 3) [µJ]."""

    nodes: Ints
    gradients: Floats
    weight: Floats

    @classmethod
    def from_scene(cls, scene: Scene, numbering: Numbering) -> list[Hourglasses]:
        """Make those of each Hourglass."""
        prisms, made = Prisms.from_scene(scene, numbering), []
        off = prisms.gradients - prisms.mean[:, None]
        for term in scene.of(Hourglass):
            rows = numbering.prism[term.tets[:, 0]]
            here = rows >= 0
            stiffness = np.broadcast_to(term.stiffness, len(rows))[here, None]
            rows = rows[here]
            made.append(cls(prisms.nodes[rows], off[rows], stiffness * prisms.volumes[rows]))
        return made

    def _off(self, x: Floats) -> Floats:
        """What F_t is off F, shape (r, 3, 3, 3)."""
        return np.einsum("rai,rtaj->rtij", x[self.nodes] - x[self.nodes[:, :1]], self.gradients)

    def energy(self, x: Floats) -> float:
        """See NodalEnergy."""
        return 0.5 * float(np.einsum("rt,rtij->", self.weight, self._off(x) ** 2))

    def add_gradient(self, x: Floats, into: Floats):
        """See NodalEnergy."""
        forces = np.einsum("rt,rtij,rtaj->rai", self.weight, self._off(x), self.gradients, optimize=True)
        add_forces(self.nodes, forces, into)

    def hessian(self, x: Floats, kept: float) -> Floats:
        """See NodalEnergy."""
        blocks = np.einsum("rt,rtaj,rtbj->rab", self.weight, self.gradients, self.gradients, optimize=True)
        return np.multiply.outer(blocks, np.eye(3))
