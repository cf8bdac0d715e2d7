"""Prisms of three tets that share one deformation: its gradients, and the hourglass that holds what it does not see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Hourglass
from ..mesh.numbering import Numbering
from .loads import Springs


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

    @cached_property
    def mean(self) -> Floats:
        """The gradients of the mean."""
        shares = self.volumes / self.volumes.sum(axis=1, keepdims=True)
        return np.einsum("rt,rtaj->raj", shares, self.gradients)

    def deformation(self, u: Floats) -> Floats:
        """Return the mean F, shape (r, 3, 3), at a displacement [mm] by node, (n, 3)."""
        return np.eye(3) + np.einsum("rai,raj->rij", u[self.nodes], self.mean)


class Hourglasses(Springs):
    """stiffness/2 Σ v_t ‖F_t - F‖² of prisms' tets: springs that pull their nodes to rest, where F_t is F."""

    @classmethod
    def from_scene(cls, scene: Scene, numbering: Numbering) -> Sequence[Hourglasses]:
        """Make those of each Hourglass."""
        prisms, made = Prisms.from_scene(scene, numbering), []
        off = prisms.gradients - prisms.mean[:, None]
        for term in scene.of(Hourglass):
            rows = numbering.prism[term.tets[:, 0]]
            here = rows >= 0
            stiffness = np.broadcast_to(term.stiffness, len(rows))[here, None]
            rows = rows[here]
            weight, nodes = stiffness * prisms.volumes[rows], prisms.nodes[rows]
            matrix = np.einsum("rt,rtaj,rtbj->rab", weight, off[rows], off[rows], optimize=True)
            made.append(cls(nodes, numbering.X[nodes], matrix))
        return made
