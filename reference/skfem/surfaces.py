"""The energy of surfaces, SurfaceStrain, from invariants: neither singular values nor a rotation are formed.

With F = [a b] (3 x 2), I = ‖F‖² and the area ratio J = |a x b|, the stretches satisfy s_1² + s_2² = I and s_1 s_2 = J,
so s_1 + s_2 = sqrt(I + 2 J) and ‖F - r R‖² = I - 2 r sqrt(I + 2 J) + 2 r² with r = sqrt(growth) (SoftDECA Eq. 11).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ...lhm.base.mesh import Floats
from .. import terms
from ..scene import Scene
from .discretisation import Discretisation
from .solids import Treatment

SMALL = 1e-12
STEP = 1e-6  # of differences of stretches


class Membranes:
    """One SurfaceStrain term."""

    def __init__(self, scene: Scene, term: terms.SurfaceStrain, discretisation: Discretisation):
        self._elements = discretisation.triangles(term.name, term.triangles, term.rest)
        self._law = Membrane(self._elements.at_points(term.stiffness), self._elements.at_points(term.growth))

    @classmethod
    def from_scene(cls, scene: Scene, discretisation: Discretisation) -> list[Membranes]:
        return [cls(scene, term, discretisation) for term in scene.of(terms.SurfaceStrain)]

    def value(self, x: Floats) -> float:
        return self._elements.integral(self._law.psi(self._elements.deformation_gradients(x)))

    def gradient(self, x: Floats) -> Floats:
        return self._elements.forces(self._law.stress(self._elements.deformation_gradients(x)))

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        return self._elements.stiffness(treat(self._law.tangent(self._elements.deformation_gradients(x))))


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
        return differentiate(self.stress, F)


def differentiate(gradient: Callable[[Floats], Floats], at: Floats) -> Floats:
    """The derivative of a gradient, (m, *shape) at places (m, *shape), shape (m, *shape, *shape), by differences.

    The gradient decides the answer, its derivative only the way there: ten digits do.
    """
    m, size = len(at), at[0].size
    tangent = np.empty((m, size, size))
    for k, step in enumerate(STEP * np.eye(size).reshape(size, *at.shape[1:])):
        tangent[:, :, k] = ((gradient(at + step) - gradient(at - step)) / (2 * STEP)).reshape(m, size)
    symmetric = (tangent + tangent.transpose(0, 2, 1)) / 2
    return symmetric.reshape(m, *at.shape[1:], *at.shape[1:])


def _invariants(F: Floats) -> tuple[Floats, Floats, Floats]:
    """‖F‖², the area ratio and the unit normal; a triangle flattened to a line has no normal: zero."""
    cross = np.cross(F[:, :, 0], F[:, :, 1])
    area = np.linalg.norm(cross, axis=1)
    return np.einsum("mia,mia->m", F, F), area, cross / np.maximum(area, SMALL)[:, None]


def _area_gradient(F: Floats, normal: Floats) -> Floats:
    return np.stack([np.cross(F[:, :, 1], normal), np.cross(normal, F[:, :, 0])], axis=2)
