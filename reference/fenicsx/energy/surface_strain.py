"""SurfaceStrain on triangles: energy, gradient and Hessian blocks, at one point of linear or several of quadratic ones.

F (3x2) maps a triangle's rest plane to space, F = U diag(s) Vᵀ with s₁ ≥ s₂ ≥ 0. psi = w/2 ‖F - cR‖², c = √growth,
has curvature w along stretches and flips, w(1 - 2c/(s₁+s₂)) along the twist, and w(1 - c/s_i) for n ⊗ v_i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import SurfaceStrain
from .. import dolfinx_version as seam
from ..mesh.numbering import Numbering
from .nodal import NodalEnergy

FLAT = 1e-8  # stretch below which a triangle's directions are not defined, and its curvature not finite
TINY = 1e-15  # of the longer stretch: a shorter one has no direction
DEGREES = {3: 1, 6: 4}
"""Degree of the rule by the nodes of a triangle: one point for linear ones, whose F is constant."""


@dataclass(frozen=True, eq=False)
class Membrane(NodalEnergy):
    """Points (m,): the nodes they hang on (m, k), shape gradients (m, k, 2) [1/mm], area [mm²], w [mN/mm], c."""

    nodes: Ints
    gradients: Floats
    area: Floats
    stiffness: Floats
    stretch: Floats

    @classmethod
    def from_scene(cls, scene: Scene, numbering: Numbering) -> list[Membrane]:
        """See NodalEnergy."""
        return [cls._from_term(scene, term, numbering) for term in scene.of(SurfaceStrain)]

    @classmethod
    def _from_term(cls, scene: Scene, term: SurfaceStrain, numbering: Numbering) -> Membrane:
        here, nodes = numbering.faces(term.name, term.triangles)
        triangles = term.triangles[here]
        _, area = _plane(scene.vertices, triangles)
        inverse, _ = _plane(scene.vertices if term.rest is None else term.rest, triangles)
        k = nodes.shape[1]
        points, weights = seam.quadrature_rule(DEGREES[k], "triangle")
        q, derivatives = len(points), seam.shapes(k // 3, points, "triangle")[1]

        def at_points(values) -> Floats:
            return np.repeat(np.broadcast_to(values, len(term.triangles))[here], q)

        return cls(
            np.repeat(nodes, q, axis=0),
            (derivatives @ inverse[:, None]).reshape(-1, k, 2),
            np.outer(area, weights / weights.sum()).ravel(),
            at_points(term.stiffness),
            np.sqrt(at_points(term.growth)),
        )

    def _svd(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """U (m, 3, 3), s (m, 2) and Vᵀ (m, 2, 2) of F at vertices x."""
        return _planar_svd(_deformation(self.nodes, self.gradients, x))

    def energy(self, x: Floats) -> float:
        """See NodalEnergy."""
        _, s, _ = self._svd(x)
        away = s - self.stretch[:, None]
        return float(0.5 * np.sum(self.area * self.stiffness * np.sum(away**2, axis=1)))

    def add_gradient(self, x: Floats, into: Floats):
        """See NodalEnergy."""
        U, s, Vt = self._svd(x)
        pull = (self.area * self.stiffness)[:, None] * (s - self.stretch[:, None])
        _add_forces(self.nodes, self.gradients, U, Vt, pull, into)

    def hessian(self, x: Floats, kept: float) -> Floats:
        """See NodalEnergy."""
        U, s, Vt = self._svd(x)
        w, c = self.stiffness, self.stretch
        twist = w * (1.0 - 2.0 * c / np.maximum(s.sum(axis=1), FLAT))
        bend = w[:, None] * (1.0 - c[:, None] / np.maximum(s, FLAT))
        curvature = np.column_stack([twist, bend])
        change = np.maximum(curvature, kept * curvature) - w[:, None]
        return _blocks(U, Vt, self.gradients, self.area, w, change)


@njit(cache=True)
def _deformation(nodes, gradients, x):
    """F (m, 3, 2) of nodes (m, k) with shape gradients (m, k, 2) at vertices x."""
    F = np.zeros((len(nodes), 3, 2))
    for e in range(len(nodes)):
        for a in range(nodes.shape[1]):
            for i in range(3):
                for j in range(2):
                    F[e, i, j] += x[nodes[e, a], i] * gradients[e, a, j]
    return F


@njit(cache=True)
def _add_forces(nodes, gradients, U, Vt, pull, into):
    """Add forces of a stress whose principal values, times the area, are pull (m, 2)."""
    for e in range(len(nodes)):
        for a in range(nodes.shape[1]):
            for c in range(2):
                along = pull[e, c] * (Vt[e, c, 0] * gradients[e, a, 0] + Vt[e, c, 1] * gradients[e, a, 1])
                for i in range(3):
                    into[nodes[e, a], i] += along * U[e, i, c]


@njit(cache=True)
def _blocks(U, Vt, gradients, area, stiffness, change):
    """The Hessian's blocks of a curvature `stiffness` (m,) but for `change` (m, 3) along the twist and n ⊗ v_i."""
    m, k = gradients.shape[:2]
    blocks = np.zeros((m, k, k, 3, 3))
    y, twist = np.empty((k, 2)), np.empty((k, 3))
    for e in range(m):
        for a in range(k):
            y[a, 0] = Vt[e, 0, 0] * gradients[e, a, 0] + Vt[e, 0, 1] * gradients[e, a, 1]
            y[a, 1] = Vt[e, 1, 0] * gradients[e, a, 0] + Vt[e, 1, 1] * gradients[e, a, 1]
            for i in range(3):
                twist[a, i] = U[e, i, 0] * y[a, 1] - U[e, i, 1] * y[a, 0]
        for a in range(k):
            for b in range(k):
                same = area[e] * stiffness[e] * (y[a, 0] * y[b, 0] + y[a, 1] * y[b, 1])
                across = area[e] * (change[e, 1] * y[a, 0] * y[b, 0] + change[e, 2] * y[a, 1] * y[b, 1])
                for i in range(3):
                    blocks[e, a, b, i, i] = same
                    for j in range(3):
                        blocks[e, a, b, i, j] += 0.5 * area[e] * change[e, 0] * twist[a, i] * twist[b, j]
                        blocks[e, a, b, i, j] += across * U[e, i, 2] * U[e, j, 2]
    return blocks


@njit(cache=True)
def _planar_svd(F):
    """U, s, Vᵀ with U's last column across to the first two, by one Jacobi turn of the two columns."""
    m = len(F)
    U, s, Vt = np.empty((m, 3, 3)), np.empty((m, 2)), np.empty((m, 2, 2))
    for e in range(m):
        a = F[e, 0, 0] ** 2 + F[e, 1, 0] ** 2 + F[e, 2, 0] ** 2
        b = F[e, 0, 1] ** 2 + F[e, 1, 1] ** 2 + F[e, 2, 1] ** 2
        g = F[e, 0, 0] * F[e, 0, 1] + F[e, 1, 0] * F[e, 1, 1] + F[e, 2, 0] * F[e, 2, 1]
        turn = 0.5 * np.arctan2(2.0 * g, a - b)  # towards the longer column, which is the first
        c, d = np.cos(turn), np.sin(turn)
        Vt[e, 0, 0], Vt[e, 0, 1], Vt[e, 1, 0], Vt[e, 1, 1] = c, d, -d, c
        for i in range(3):
            U[e, i, 0] = c * F[e, i, 0] + d * F[e, i, 1]
            U[e, i, 1] = c * F[e, i, 1] - d * F[e, i, 0]
        s[e, 0] = _unit_column(U[e], 0, 0.0)
        s[e, 1] = _unit_column(U[e], 1, TINY * s[e, 0])
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            U[e, i, 2] = U[e, j, 0] * U[e, k, 1] - U[e, k, 0] * U[e, j, 1]
    return U, s, Vt


@njit(cache=True)
def _unit_column(U, c, least):
    """Make a column a unit vector, any one across to those before it where it is not longer than `least`; its length.

    The second is made orthogonal to the first: where it is short, rounding has turned it.
    """
    length = np.sqrt(U[0, c] ** 2 + U[1, c] ** 2 + U[2, c] ** 2)
    if length <= least:
        axis = np.argmin(np.abs(U[:, 0])) if c else 0
        for i in range(3):
            U[i, c] = 1.0 if i == axis else 0.0
    if c:
        along = U[0, 0] * U[0, 1] + U[1, 0] * U[1, 1] + U[2, 0] * U[2, 1]
        for i in range(3):
            U[i, 1] -= along * U[i, 0]
    norm = np.sqrt(U[0, c] ** 2 + U[1, c] ** 2 + U[2, c] ** 2)
    for i in range(3):
        U[i, c] /= norm
    return length


def _plane(vertices: Floats, triangles: Ints) -> tuple[Floats, Floats]:
    """Gradients in the planes of triangles of their two reference coordinates, (t, 2, 2) [1/mm], and areas [mm²]."""
    x0, x1, x2 = (vertices[triangles[:, k]] for k in range(3))
    e1, e2 = x1 - x0, x2 - x0
    normal = np.cross(e1, e2)
    along = e1 / np.linalg.norm(e1, axis=1, keepdims=True)
    across = np.cross(normal, along)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    frame = np.stack([along, across], axis=1)
    inverse = np.linalg.inv(frame @ np.stack([e1, e2], axis=2))
    return inverse, 0.5 * np.linalg.norm(normal, axis=1)
