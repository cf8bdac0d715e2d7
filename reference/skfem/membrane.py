"""The energy of triangles with stress and tangent, from invariants: no singular values, no rotation is formed.

With F = [a b] (3 x 2), I = ‖F‖² and the area ratio J = |a x b|, the stretches satisfy s_1² + s_2² = I and s_1 s_2 = J,
so s_1 + s_2 = sqrt(I + 2 J) and ‖F - r R‖² = I - 2 r sqrt(I + 2 J) + 2 r² with r = sqrt(growth) (SoftDECA Eq. 11).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats, Ints

SMALL = 1e-12


@dataclass(frozen=True, eq=False)
class Membrane:
    """stiffness/2 ‖F - sqrt(growth) R‖² per rest area; stiffness [mN/mm] and growth, shape (m,)."""

    stiffness: Floats
    growth: Floats

    def psi(self, F: Floats) -> Floats:
        """Energy per rest area [mN/mm], shape (m,), of F of shape (m, 3, 2)."""
        ratio = np.sqrt(self.growth)
        squares, area, _ = _invariants(F)
        return self.stiffness / 2 * (squares - 2 * ratio * np.sqrt(squares + 2 * area) + 2 * self.growth)

    def stress(self, F: Floats) -> Floats:
        """dpsi/dF [mN/mm], shape (m, 3, 2)."""
        squares, area, normal = _invariants(F)
        factor = np.sqrt(self.growth) / np.maximum(np.sqrt(squares + 2 * area), SMALL)
        return self.stiffness[:, None, None] * (F - factor[:, None, None] * (F + _area_gradient(F, normal)))

    def tangent(self, F: Floats) -> Floats:
        """dP/dF [mN/mm], shape (m, 3, 2, 3, 2)."""
        squares, area, normal = _invariants(F)
        total = np.maximum(np.sqrt(squares + 2 * area), SMALL)
        direction = (F + _area_gradient(F, normal)) / total[:, None, None]
        identity = np.einsum("ik,ab->iakb", np.eye(3), np.eye(2))
        curvature = identity + _area_hessian(F, area, normal) - np.einsum("mia,mkb->miakb", direction, direction)
        weight = (np.sqrt(self.growth) / total)[:, None, None, None, None]
        return self.stiffness[:, None, None, None, None] * (identity - weight * curvature)


def rest_gradients(X: Floats, triangles: Ints) -> tuple[Floats, Floats]:
    """Gradients G (m, 3 corners, 2) [1/mm] of the shape functions in each triangle's plane, and areas [mm²], (m,).

    F = sum over corners of x_corner ⊗ G_corner.
    """
    origin, first, second = (X[triangles[:, k]] for k in range(3))
    edges = np.stack([first - origin, second - origin], axis=2)
    # A QR factorisation gives the two edges in an orthonormal frame of the plane.
    in_plane = np.linalg.qr(edges)[1]
    inverse = np.linalg.inv(in_plane)
    return np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1), abs(np.linalg.det(in_plane)) / 2


def _invariants(F: Floats) -> tuple[Floats, Floats, Floats]:
    """‖F‖², the area ratio and the unit normal; a triangle flattened to a line has no normal: zero."""
    cross = np.cross(F[:, :, 0], F[:, :, 1])
    area = np.linalg.norm(cross, axis=1)
    return np.einsum("mia,mia->m", F, F), area, cross / np.maximum(area, SMALL)[:, None]


def _area_gradient(F: Floats, normal: Floats) -> Floats:
    return np.stack([np.cross(F[:, :, 1], normal), np.cross(normal, F[:, :, 0])], axis=2)


def _area_hessian(F: Floats, area: Floats, normal: Floats) -> Floats:
    """Second derivative of J = |a x b|: of n . (a x b) by a and b, plus the turning of the normal n."""
    gradient = _cross_derivative(F)
    projector = np.eye(3) - np.einsum("mp,mq->mpq", normal, normal)
    turning = np.einsum("mpia,mpq,mqkb->miakb", gradient, projector, gradient, optimize=True)
    hessian = turning / np.maximum(area, SMALL)[:, None, None, None, None]
    mixed = np.einsum("pik,mp->mik", _levi_civita(), normal)
    hessian[:, :, 0, :, 1] += mixed
    hessian[:, :, 1, :, 0] -= mixed
    return hessian


def _cross_derivative(F: Floats) -> Floats:
    """d(a x b)_p/dF_ia, shape (m, 3, 3, 2)."""
    by_first = np.einsum("pij,mj->mpi", _levi_civita(), F[:, :, 1])
    by_second = np.einsum("pji,mj->mpi", _levi_civita(), F[:, :, 0])
    return np.stack([by_first, by_second], axis=3)


def _levi_civita() -> Floats:
    symbol = np.zeros((3, 3, 3))
    symbol[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1
    symbol[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1
    return symbol
