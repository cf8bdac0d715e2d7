"""The energies of surfaces: SurfaceStrain from invariants, and Bending by quaternions.

Neither a singular value decomposition nor a rotation matrix is formed.

SurfaceStrain: with F = [a b] (3 x 2), I = ‖F‖² and the area ratio J = |a x b|, the stretches satisfy s_1² + s_2² = I
and s_1 s_2 = J, so s_1 + s_2 = sqrt(I + 2 J) and ‖F - r R‖² = I - 2 r sqrt(I + 2 J) + 2 r² with r = sqrt(growth)
(SoftDECA Eq. 11).

Bending: at an inner vertex, l = Σ a_j e_j and S = Σ w_j e_j E_jᵀ are linear in the positions (e_j edges, E_j at rest).
With Horn's symmetric K(M) (4 x 4), q·K(M) q = R(q) : M for the rotation R(q) of a unit quaternion q; so the rotation
nearest to S is the eigenvector q of K(S) with the largest eigenvalue λ, and with b = Σ a_j E_j

    s/2 |l - R b|² = s/2 (|l|² + |b|²) - s f,   f(l, S) = q·T q,   T = K(l bᵀ).

With P the pseudo-inverse of λ - K(S), q moves by P dK q. The energy's twelve variables at a vertex are B x with a
constant sparse B, so that gradient and Hessian are Bᵀ φ' and Bᵀ φ'' B. φ'' is made by differences, as is a membrane's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import bsr_matrix, coo_matrix, csr_matrix, kron

from ...lhm.base.mesh import Floats, Ints
from .. import terms
from ..scene import Scene
from .discretisation import Discretisation, rest_gradients
from .solids import Treatment

SMALL = 1e-12
STEP = 1e-6  # of differences: of stretches, and of variables of the order of one
GAP = 1e-9  # of the largest eigenvalue: below it a ring does not determine its rotation


class Membranes:
    """One SurfaceStrain term."""

    def __init__(self, scene: Scene, term: terms.SurfaceStrain, discretisation: Discretisation):
        self._elements = discretisation.triangles(term.name, term.triangles, term.rest)
        self._law = Membrane(self._elements.at_points(term.stiffness), self._elements.at_points(term.growth))

    @classmethod
    def from_scene(cls, scene: Scene, discretisation: Discretisation) -> list[Membranes]:
        """See Part."""
        return [cls(scene, term, discretisation) for term in scene.of(terms.SurfaceStrain)]

    def value(self, x: Floats) -> float:
        """See Part."""
        return self._elements.integral(self._law.psi(self._elements.deformation_gradients(x)))

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        return self._elements.forces(self._law.stress(self._elements.deformation_gradients(x)))

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part."""
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


def _horn() -> Floats:
    """K of each unit matrix, shape (3, 3, 4, 4)."""
    K = np.zeros((3, 3, 4, 4))
    for i in range(3):
        K[i, i, 0, 0] = 1
        for c in range(3):
            K[i, i, c + 1, c + 1] = 1 if c == i else -1
        j, k = (i + 1) % 3, (i + 2) % 3
        K[k, j, 0, i + 1] = K[k, j, i + 1, 0] = 1
        K[j, k, 0, i + 1] = K[j, k, i + 1, 0] = -1
        K[j, k, j + 1, k + 1] = K[j, k, k + 1, j + 1] = 1
        K[k, j, j + 1, k + 1] = K[k, j, k + 1, j + 1] = 1
    return K


HORN = _horn()


class Bends:
    """One Bending term."""

    def __init__(self, scene: Scene, term: terms.Bending, discretisation: Discretisation):
        X = scene.vertices if term.rest is None else term.rest
        n, triangles = len(X), term.triangles
        gradients, areas = rest_gradients(X, triangles)
        third = np.repeat(areas / 3, 3)
        area = np.bincount(triangles.ravel(), third, minlength=n)
        stiffness = np.repeat(np.broadcast_to(term.stiffness, len(triangles)), 3)
        inner = _inner(triangles, n)
        # Its mean over the area around a vertex, times that area.
        self._weight = np.bincount(triangles.ravel(), third * stiffness, minlength=n)[inner]
        ring, i, j, w = _edges(gradients, areas, triangles, inner, n)
        E, own = X[j] - X[i], area[inner][ring]
        pull = np.maximum(w, 0)
        spread = np.bincount(ring, pull * np.sum(E**2, axis=1), minlength=len(inner))
        # S in units of l, so that no curvature dwarfs the others when an element's tangent is made semidefinite.
        pull = pull / (spread * np.sqrt(area[inner]))[ring]
        coefficients = np.column_stack([w / own, pull[:, None] * E])
        self._rest = np.zeros((len(inner), 3))
        np.add.at(self._rest, ring, coefficients[:, :1] * E)
        rows = 4 * ring[:, None] + np.arange(4)
        edge = coo_matrix((coefficients.ravel(), (rows.ravel(), np.repeat(j, 4))), (4 * len(inner), n))
        edge -= coo_matrix((coefficients.ravel(), (rows.ravel(), np.repeat(i, 4))), (4 * len(inner), n))
        place = coo_matrix(
            (np.ones(3 * n), (np.arange(3 * n), discretisation.vertex_dofs.ravel())), (3 * n, discretisation.size)
        )
        self._variables: csr_matrix = (kron(edge, np.eye(3)) @ place).tocsr()

    @classmethod
    def from_scene(cls, scene: Scene, discretisation: Discretisation) -> list[Bends]:
        """See Part."""
        return [cls(scene, term, discretisation) for term in scene.of(terms.Bending)]

    def _evaluate(self, variables: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """T and P (m, 4, 4); K q for K of each unit of S (m, 9, 4); and q (m, 4)."""
        K = np.einsum("mjc,cjab->mab", variables[:, 1:], HORN)
        T = np.einsum("mc,mj,cjab->mab", variables[:, 0], self._rest, HORN, optimize=True)
        values, vectors = np.linalg.eigh(K)
        gaps = np.maximum(values[:, 3:] - values[:, :3], GAP * np.abs(values).max(axis=1, keepdims=True))
        others = vectors[:, :, :3]
        P = (others / gaps[:, None, :]) @ others.transpose(0, 2, 1)
        q = vectors[:, :, 3]
        Kq = np.einsum("cjab,mb->mjca", HORN, q).reshape(len(q), 9, 4)
        return T, P, Kq, q

    def _place(self, x: Floats) -> Floats:
        """The variables l and S at each vertex, shape (m, 4, 3)."""
        return (self._variables @ x).reshape(-1, 4, 3)

    def _slope(self, variables: Floats) -> Floats:
        """The derivative of the energy per weight by the variables, shape (m, 4, 3)."""
        T, P, Kq, q = self._evaluate(variables)
        s = np.einsum("mab,mbc,mc->ma", P, T, q, optimize=True)
        by_l = variables[:, 0] - np.einsum("mj,mjca,ma->mc", self._rest, Kq.reshape(-1, 3, 3, 4), q, optimize=True)
        by_S = -2 * np.einsum("mva,ma->mv", Kq, s)
        return np.concatenate([by_l, by_S], axis=1).reshape(-1, 4, 3)

    def value(self, x: Floats) -> float:
        """See Part."""
        variables = self._place(x)
        T, _, _, q = self._evaluate(variables)
        turned = np.einsum("ma,mab,mb->m", q, T, q)
        return float(self._weight @ (np.sum(variables[:, 0] ** 2 + self._rest**2, axis=1) / 2 - turned))

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        return self._variables.T @ (self._weight[:, None, None] * self._slope(self._place(x))).ravel()

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part; the tangent treated is that of a vertex' twelve variables."""
        tangent = treat(differentiate(self._slope, self._place(x))).reshape(-1, 12, 12) * self._weight[:, None, None]
        m = len(tangent)
        blocks = bsr_matrix((tangent, np.arange(m), np.arange(m + 1)), (12 * m, 12 * m))
        return (self._variables.T @ (blocks @ self._variables)).tocsr()


def _inner(triangles: Ints, n: int) -> Ints:
    """Vertices of triangles (m, 3) that no edge with one triangle alone ends at."""
    i, j = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    count = coo_matrix((np.ones(2 * len(i)), (np.concatenate([i, j]), np.concatenate([j, i]))), (n, n)).tocsr()
    border = np.diff((count == 1).tocsr().indptr) > 0
    return np.setdiff1d(triangles, np.flatnonzero(border))


def _edges(gradients: Floats, areas: Floats, triangles: Ints, inner: Ints, n: int) -> tuple[Ints, Ints, Ints, Floats]:
    """Edges from inner vertices: number among those, both ends, and weight; all of shape (k,).

    The weight (cot a + cot b)/2 is minus the entry of the surface's stiffness matrix for linear shape functions.
    """
    entries = areas[:, None, None] * (gradients @ gradients.transpose(0, 2, 1))
    rows, columns = np.repeat(triangles, 3, axis=1).ravel(), np.tile(triangles, (1, 3)).ravel()
    stiffness = coo_matrix((entries.ravel(), (rows, columns)), (n, n)).tocsr()[inner].tocoo()
    i = inner[stiffness.row]
    off = i != stiffness.col
    return stiffness.row[off], i[off], stiffness.col[off], -stiffness.data[off]
