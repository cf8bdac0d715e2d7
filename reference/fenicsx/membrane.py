"""SurfaceStrain on triangles of the scene's vertices: energy, gradient and Hessian blocks, exact for linear triangles.

F (3x2) maps a triangle's rest plane to space, F = U diag(s) Vᵀ with s₁ ≥ s₂ ≥ 0. psi = w/2 ‖F - cR‖², c = √growth,
has curvature w along stretches and flips, w(1 - 2c/(s₁+s₂)) along the twist, and w(1 - c/s_i) for n ⊗ v_i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.mesh import Floats, Ints
from ..terms import SurfaceStrain

FLAT = 1e-8  # stretch below which a triangle's directions are not defined, and its curvature not finite


@dataclass(frozen=True, eq=False)
class Membrane:
    """Triangles (m, 3) in the solver's vertex order, shape gradients (m, 3, 2) [1/mm], area [mm²], w [mN/mm], c."""

    triangles: Ints
    gradients: Floats
    area: Floats
    stiffness: Floats
    stretch: Floats

    @classmethod
    def of(cls, term: SurfaceStrain, vertices: Floats, order: Ints) -> Membrane:
        """The term on rest vertices [mm], shape (n, 3), in the scene's order; `order` numbers them for the solver."""
        x0, x1, x2 = (vertices[term.triangles[:, k]] for k in range(3))
        e1, e2 = x1 - x0, x2 - x0
        normal = np.cross(e1, e2)
        along = e1 / np.linalg.norm(e1, axis=1, keepdims=True)
        across = np.cross(normal, along)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        frame = np.stack([along, across], axis=1)
        rest = frame @ np.stack([e1, e2], axis=2)
        inverse = np.linalg.inv(rest)
        gradients = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
        m = len(term.triangles)
        return cls(
            order[term.triangles],
            gradients,
            0.5 * np.linalg.norm(normal, axis=1),
            np.broadcast_to(term.stiffness, m),
            np.sqrt(np.broadcast_to(term.growth, m)),
        )

    def _svd(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        F = x[self.triangles].transpose(0, 2, 1) @ self.gradients
        return np.linalg.svd(F, full_matrices=True)

    def energy(self, x: Floats) -> float:
        """Energy [µJ] at vertices x [mm], shape (n, 3)."""
        _, s, _ = self._svd(x)
        away = s - self.stretch[:, None]
        return float(0.5 * np.sum(self.area * self.stiffness * np.sum(away**2, axis=1)))

    def add_gradient(self, x: Floats, into: Floats):
        """Add the energy's gradient [mN] to an array (n, 3)."""
        U, s, Vt = self._svd(x)
        P = (U[:, :, :2] * (self.stiffness[:, None] * (s - self.stretch[:, None]))[:, None, :]) @ Vt
        force = self.area[:, None, None] * self.gradients @ P.transpose(0, 2, 1)
        for c in range(3):
            into[:, c] += np.bincount(self.triangles.ravel(), force[:, :, c].ravel(), minlength=len(into))

    def hessian(self, x: Floats, kept: float) -> Floats:
        """The Hessian's blocks [mN/mm], shape (m, 3, 3, 3, 3): vertex, vertex, component, component.

        Negative curvature is multiplied by `kept`: 1 for the exact Hessian, 0 for its projection.
        """
        U, s, Vt = self._svd(x)
        w, c = self.stiffness, self.stretch
        u, n, v = U[:, :, :2], U[:, :, 2], Vt.transpose(0, 2, 1)
        twist = w * (1.0 - 2.0 * c / np.maximum(s.sum(axis=1), FLAT))
        bend = w[:, None] * (1.0 - c[:, None] / np.maximum(s, FLAT))
        vectors = np.empty((len(s), 3, 3, 2))
        vectors[:, 0] = (u[:, :, :1] * v[:, None, :, 1] - u[:, :, 1:] * v[:, None, :, 0]) / np.sqrt(2.0)
        vectors[:, 1] = n[:, :, None] * v[:, None, :, 0]
        vectors[:, 2] = n[:, :, None] * v[:, None, :, 1]
        curvature = np.column_stack([twist, bend])
        change = np.maximum(curvature, kept * curvature) - w[:, None]
        B = vectors.reshape(len(s), 9, 2) @ self.gradients.transpose(0, 2, 1)  # mode and component, vertex
        B = B.reshape(len(s), 3, 9)
        blocks = (B * (self.area[:, None] * change)[:, :, None]).transpose(0, 2, 1) @ B
        blocks = blocks.reshape(-1, 3, 3, 3, 3).transpose(0, 2, 4, 1, 3)
        isotropic = (self.area * w)[:, None, None] * self.gradients @ self.gradients.transpose(0, 2, 1)
        return blocks + isotropic[..., None, None] * np.eye(3)
