"""Loads and springs on nodes: Gravity and Traction, which are dead, Pressure, which follows, and Target.

Follower pressure on linear or quadratic triangles: with x(ξ, η) on a triangle the outer normal times area is
x_ξ × x_η, so the pressure p adds p ∫ N_a x_ξ × x_η dξ dη to the gradient. Its derivative is symmetric where the border
of the triangles is held or slides in a plane that closes the volume, and not else (Bonet and Wood 2008, Section 8.5.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Gravity, Pressure, Target, Traction
from ...terms.term import triangle_areas
from .. import dolfinx_version as seam
from ..mesh.numbering import CELL_SHARES, FACE_SHARES, Numbering
from .assembly import add_forces, skew
from .nodal import NodalEnergy

PRESSURE_DEGREES = {3: 2, 6: 6}
"""Degree of the rule that is exact, by the nodes of a triangle."""
SPREAD_DEGREE = 5
"""Degree of the rule that is exact for springs of linear stiffness between shape functions up to quadratic ones."""


def dead_loads(scene: Scene, numbering: Numbering) -> Floats:
    """Forces [mN] of Gravity and Traction, a vector (owned, 3); exact, and of degree 1 the scene's lumped ones."""
    forces = np.zeros(numbering.X.shape)
    for term in scene.of(Gravity):
        tets = scene.tets_of(term)
        weight = np.broadcast_to(term.density, tets.shape) * scene.volumes[tets]
        cells = numbering.cell[tets]
        nodes = numbering.cell_dofs[cells[cells >= 0]]
        shares = np.outer(weight[cells >= 0], CELL_SHARES[numbering.degree])
        forces += np.bincount(nodes.ravel(), shares.ravel(), minlength=len(forces))[:, None] * term.acceleration
    for term in scene.of(Traction):
        if not term.triangles.size:
            continue
        here, nodes = numbering.faces(term.name, term.triangles)
        shares = np.outer(term.areas(scene.vertices)[here], FACE_SHARES[numbering.degree])
        forces += np.bincount(nodes.ravel(), shares.ravel(), minlength=len(forces))[:, None] * term.vector
    return numbering.nodes.sum_up(forces)


@dataclass(frozen=True, eq=False)
class FollowerPressure(NodalEnergy):
    """Triangles' nodes (m, k), pressure (m,) [kPa], and a rule: weights (q,), shapes (q, k), derivatives (q, k, 2)."""

    is_load: ClassVar[bool] = True

    nodes: Ints
    value: Floats
    weights: Floats
    shapes: Floats
    derivatives: Floats

    @classmethod
    def from_scene(cls, scene: Scene, numbering: Numbering) -> list[FollowerPressure]:
        """See NodalEnergy."""
        faces = [(term, *numbering.faces(term.name, term.triangles)) for term in scene.of(Pressure)]
        return [cls.from_term(term, nodes, here) for term, here, nodes in faces]

    @classmethod
    def from_term(cls, term: Pressure, nodes: Ints, here: Ints | None = None) -> FollowerPressure:
        """The term on its triangles that are `here`, by default all, with nodes (m, 3) or (m, 6), corners first."""
        k = nodes.shape[1]
        points, weights = seam.quadrature_rule(PRESSURE_DEGREES[k], "triangle")
        value = np.broadcast_to(term.value, len(term.triangles))
        value = value if here is None else value[here]
        return cls(nodes, value, weights, *seam.shapes(k // 3, points, "triangle"))

    def _tangents(self, x: Floats) -> tuple[Floats, Floats]:
        """x_ξ and x_η [mm] at the points, shape (m, q, 3)."""
        both = np.einsum("mkc,qkd->dmqc", x[self.nodes], self.derivatives)
        return both[0], both[1]

    def add_gradient(self, x: Floats, into: Floats):
        """See NodalEnergy."""
        along, across = self._tangents(x)
        force = np.einsum("m,q,qk,mqc->mkc", self.value, self.weights, self.shapes, np.cross(along, across))
        add_forces(self.nodes, force, into)

    def energy(self, x: Floats) -> float:
        """The pressure times the volume under the triangles, seen from the origin [µJ]: a potential if they close."""
        along, across = self._tangents(x)
        at = np.einsum("mkc,qk->mqc", x[self.nodes], self.shapes)
        return float(np.einsum("m,q,mqc,mqc->", self.value, self.weights, at, np.cross(along, across)) / 3.0)

    def hessian(self, x: Floats, kept: float = 1.0) -> Floats:
        """Return the derivative of the gradient, exact whatever is `kept`; see NodalEnergy."""
        along, across = (skew(t) for t in self._tangents(x))
        by_along, by_across = self.derivatives[:, :, 0], self.derivatives[:, :, 1]
        scaled = np.einsum("m,q,qa->mqa", self.value, self.weights, self.shapes)
        tangent = np.einsum("mqa,qb,mqij->mabij", scaled, by_across, along, optimize=True)
        return tangent - np.einsum("mqa,qb,mqij->mabij", scaled, by_along, across, optimize=True)


@dataclass(frozen=True, eq=False)
class Springs(NodalEnergy):
    """Springs of a Target: at nodes (m, 1) that this process owns, or spread over its triangles (m, 3) or (m, 6).

    places [mm] (m, k, 3); stiffness [mN/mm] (m, k, k) joins the nodes of an element.
    """

    nodes: Ints
    places: Floats
    stiffness: Floats

    @classmethod
    def from_scene(cls, scene: Scene, numbering: Numbering) -> Sequence[Springs]:
        """Make the springs of each target."""
        springs = []
        for term in scene.of(Target):
            at_vertices = np.ones(len(term.vertices), dtype=bool)
            if term.is_spread(numbering.degree):
                at_vertices, density, places = term.spread(scene)
                springs.append(cls.over_triangles(term, scene, numbering, density, places))
            stiffness = np.broadcast_to(term.stiffness, len(term.vertices))[at_vertices]
            ids, places = term.vertices[at_vertices], term.positions[at_vertices]
            springs.append(cls.at_vertices(term.name, ids, places, stiffness, numbering))
        return springs

    @classmethod
    def at_vertices(cls, name: str, vertices: Ints, places: Floats, stiffness: Floats, numbering: Numbering) -> Springs:
        """Springs (k,) at a term's vertices."""
        mine, dofs = numbering.own_dofs(name, vertices)
        return cls(dofs[:, None], places[mine, None], stiffness[mine, None, None])

    @classmethod
    def over_triangles(
        cls, term: Target, scene: Scene, numbering: Numbering, density: Floats, places: Floats
    ) -> Springs:
        """Springs of a density and to places that are linear on the triangles; see `Target.spread`."""
        here, nodes = numbering.faces(term.name, term.triangles)
        points, weights = seam.quadrature_rule(SPREAD_DEGREE, "triangle")
        shapes, linear = (seam.shapes(degree, points, "triangle")[0] for degree in (numbering.degree, 1))
        weighted = (density[here] @ linear.T) * weights / weights.sum()
        areas = triangle_areas(scene.vertices, term.triangles[here])
        stiffness = np.einsum("m,mq,qa,qb->mab", areas, weighted, shapes, shapes)
        corners = places[here]
        between = 0.5 * (corners[:, [1, 2, 0]] + corners[:, [2, 0, 1]])
        return cls(nodes, np.concatenate([corners, between], axis=1)[:, : nodes.shape[1]], stiffness)

    def energy(self, x: Floats) -> float:
        """See NodalEnergy."""
        away = x[self.nodes] - self.places
        return 0.5 * float(np.sum(away * (self.stiffness @ away)))

    def add_gradient(self, x: Floats, into: Floats):
        """See NodalEnergy."""
        add_forces(self.nodes, self.stiffness @ (x[self.nodes] - self.places), into)

    def hessian(self, x: Floats, kept: float) -> Floats:
        """See NodalEnergy."""
        return np.multiply.outer(self.stiffness, np.eye(3))
