"""Follower pressure on linear or quadratic triangles: nodal forces and their tangent, of the present shape.

With x(ξ, η) on a triangle the outer normal times area is x_ξ × x_η, so the pressure p adds p ∫ N_a x_ξ × x_η dξ dη to
the gradient. Its derivative is symmetric where the border of the triangles is held or slides in a plane that closes
the volume, and not else (Bonet and Wood 2008, Section 8.5.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..terms import Pressure
from . import dolfinx_version as seam
from .assembly import add_forces, skew

DEGREES = {3: 2, 6: 6}
"""Degree of the rule that is exact, by the nodes of a triangle."""


@dataclass(frozen=True, eq=False)
class FollowerPressure:
    """Triangles' nodes (m, k), pressure (m,) [kPa], and a rule: weights (q,), shapes (q, k), derivatives (q, k, 2)."""

    nodes: Ints
    value: Floats
    weights: Floats
    shapes: Floats
    derivatives: Floats

    @classmethod
    def of(cls, term: Pressure, nodes: Ints, here: Ints | None = None) -> FollowerPressure:
        """The term on its triangles that are `here`, by default all, with nodes (m, 3) or (m, 6), corners first."""
        k = nodes.shape[1]
        points, weights = seam.quadrature_rule(DEGREES[k], "triangle")
        value = np.broadcast_to(term.value, len(term.triangles))
        value = value if here is None else value[here]
        return cls(nodes, value, weights, *seam.shapes(k // 3, points, "triangle"))

    def _tangents(self, x: Floats) -> tuple[Floats, Floats]:
        """x_ξ and x_η [mm] at the points, shape (m, q, 3)."""
        both = np.einsum("mkc,qkd->dmqc", x[self.nodes], self.derivatives)
        return both[0], both[1]

    def add_gradient(self, x: Floats, into: Floats, share: float = 1.0):
        """Add a share of the pressure's part of the gradient [mN] at nodes x [mm], shape (n, 3), to an array (n, 3)."""
        along, across = self._tangents(x)
        force = np.einsum("m,q,qk,mqc->mkc", share * self.value, self.weights, self.shapes, np.cross(along, across))
        add_forces(self.nodes, force, into)

    def energy(self, x: Floats) -> float:
        """The pressure times the volume under the triangles, seen from the origin [µJ]: a potential if they close."""
        along, across = self._tangents(x)
        at = np.einsum("mkc,qk->mqc", x[self.nodes], self.shapes)
        return float(np.einsum("m,q,mqc,mqc->", self.value, self.weights, at, np.cross(along, across)) / 3.0)

    def tangent(self, x: Floats) -> Floats:
        """The derivative of the gradient [mN/mm], shape (m, k, k, 3, 3): node, node, component, component."""
        along, across = (skew(t) for t in self._tangents(x))
        by_along, by_across = self.derivatives[:, :, 0], self.derivatives[:, :, 1]
        scaled = np.einsum("m,q,qa->mqa", self.value, self.weights, self.shapes)
        tangent = np.einsum("mqa,qb,mqij->mabij", scaled, by_across, along, optimize=True)
        return tangent - np.einsum("mqa,qb,mqij->mabij", scaled, by_along, across, optimize=True)
