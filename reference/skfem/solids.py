"""The energies of tets, written apart from the other solvers' so that one checks the other.

Every law has `psi(F)` [kPa], shape (m,); `stress(F)`, the first Piola-Kirchhoff stress [kPa], shape (m, 3, 3); and
`tangent(F)` = dP/dF [kPa], shape (m, 3, 3, 3, 3), for deformation gradients F of shape (m, 3, 3).

The sets of SoftDECA Eq. 10 depend on the singular values alone, so the nearest matrix to F = U diag(sigma) Vᵀ is
U diag(s) Vᵀ with s the nearest stretches to sigma. The SVD is signed (U and V rotations; the sign of det F on the
smallest singular value), so that an inverted tet is led back the short way.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.sparse import csr_matrix

from ...lhm.base.mesh import Floats, Ints
from .. import materials, terms
from ..materials import Corotated, EnergyLaw
from ..scene import Scene
from .discretisation import Discretisation, Elements

LAWS = tuple(law for law in materials.LAWS if issubclass(law, (EnergyLaw, Corotated)))
"""The laws of Hyperelastic that this solver models."""
IDENTITY = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))
LEVI_CIVITA = np.zeros((3, 3, 3))
LEVI_CIVITA[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
LEVI_CIVITA[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1.0
Treatment = Callable[[Floats], Floats]
"""A treatment of the tangents at points before they are assembled: `project_spd`, or none."""


class Tissue:
    """All energies of tissue on some elements together, so that tangents are projected once per point, not per term."""

    def __init__(self, elements: Elements, laws: Sequence[tuple[Law, Ints]]):
        self.elements, self._laws = elements, laws

    @classmethod
    def from_scene(cls, scene: Scene, discretisation: Discretisation) -> list[Tissue]:
        """Make those of tets, and where the scene has prisms those of their mean F and of what their tets are off."""
        solids, tets = scene.of(terms.Solid), discretisation.tets
        alone = [term for term in solids if not term.on_prisms]
        parts = [cls(tets, [_law_at_points(term, tets, scene.tets_of(term)) for term in alone])]
        if len(scene.prisms):
            row = np.zeros(len(scene.tets), dtype=np.int64)
            row[scene.prisms[:, 0]] = np.arange(len(scene.prisms))
            mean, off = discretisation.prisms(scene.prisms, scene.prism_cells.vertices)
            for elements, holds in ((mean, False), (off, True)):
                there = [term for term in solids if term.on_prisms and isinstance(term, terms.Hourglass) == holds]
                parts.append(cls(elements, [_law_at_points(term, elements, row[term.tets[:, 0]]) for term in there]))
        return parts

    def value(self, x: Floats) -> float:
        F = self.elements.deformation_gradients(x)
        psi = np.zeros(len(F))
        for law, points in self._laws:
            psi[points] += law.psi(F[points])
        return self.elements.integral(psi)

    def gradient(self, x: Floats) -> Floats:
        return self.elements.forces(self.stress(x)[1])

    def stress(self, x: Floats) -> tuple[Floats, Floats]:
        """F and P [kPa] at the points, shape (m q, 3, 3), where the energy is finite."""
        F = self.elements.deformation_gradients(x)
        P = np.zeros_like(F)
        for law, points in self._laws:
            P[points] += law.stress(F[points])
        return F, P

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        F = self.elements.deformation_gradients(x)
        tangent = np.zeros((len(F), 3, 3, 3, 3))
        for law, points in self._laws:
            tangent[points] += law.tangent(F[points])
        return self.elements.stiffness(treat(tangent))


def _law_at_points(term, elements: Elements, rows: Ints) -> tuple[Law, Ints]:
    """A term's law on some elements (k,), and their points."""
    return _law(term, len(rows), elements.weights.shape[1]), elements.points(rows)


def _law(term, tets: int, points: int) -> Law:
    """A term's law with parameters per point, of which each tet has `points`."""

    def at_points(values) -> Floats:
        return np.repeat(np.broadcast_to(values, (tets,)).astype(np.float64), points)

    if isinstance(term, terms.Volume):
        return Volume(at_points(term.stiffness), at_points(term.target))
    if isinstance(term, terms.Hourglass):
        return Quadratic(at_points(term.stiffness))
    if isinstance(term, terms.Strain):
        return Strain(at_points(term.stiffness), at_points(term.limit))
    growth = at_points(term.growth)
    law: Law = ByRotation(term.material) if isinstance(term.material, Corotated) else ByInvariants(term.material)
    return law if np.all(growth == 1.0) else Grown(law, growth)


class Law(Protocol):
    """A density with its two derivatives; see the module."""

    def psi(self, F: Floats) -> Floats:
        """Energy per rest volume [kPa], shape (m,); infinite where the law does not hold."""
        ...

    def stress(self, F: Floats) -> Floats:
        """dpsi/dF [kPa], shape (m, 3, 3)."""
        ...

    def tangent(self, F: Floats) -> Floats:
        """dP/dF [kPa], shape (m, 3, 3, 3, 3)."""
        ...


DIFFERENCE = 1e-5
"""Step in an invariant, relative in J where psi holds for J > 0 alone; the Hessian by it is good to 1e-9."""


@dataclass(frozen=True)
class ByInvariants:
    """A law of I1, I2 and J, by the chain rule; these are polynomials of F, with derivatives everywhere."""

    law: EnergyLaw

    def psi(self, F: Floats) -> Floats:
        return self.law.energy(_invariants(F))

    def stress(self, F: Floats) -> Floats:
        """See Law; F must have finite energy."""
        return np.einsum("am,maij->mij", self.law.slopes(_invariants(F)), _gradients(F))

    def tangent(self, F: Floats) -> Floats:
        """See Law; F must have finite energy."""
        invariants = _invariants(F)
        gradient = self.law.slopes(invariants)[:, :, None, None, None, None]
        tangent = _chain(_gradients(F), self._hessian(invariants))
        tangent += 2 * gradient[0] * IDENTITY
        tangent += np.einsum("ika,jlb,mab->mijkl", LEVI_CIVITA, LEVI_CIVITA, gradient[2, :, 0, 0] * F, optimize=True)
        if gradient[1].any():
            eye, FT = np.eye(3), F.transpose(0, 2, 1)
            of_I2 = 4 * np.einsum("mij,mkl->mijkl", F, F) + 2 * invariants[0, :, None, None, None, None] * IDENTITY
            of_I2 -= 2 * np.einsum("ik,mjl->mijkl", eye, FT @ F) + 2 * np.einsum("mil,mkj->mijkl", F, F)
            of_I2 -= 2 * np.einsum("mik,jl->mijkl", F @ FT, eye)
            tangent += gradient[1] * of_I2
        return tangent

    def _hessian(self, invariants: Floats) -> Floats:
        """Psi's second derivatives by invariants (3, m), shape (m, 3, 3), by differences of the first."""
        sizes = np.full_like(invariants, DIFFERENCE)
        if not self.law.finite_inverted:
            sizes[2] *= invariants[2]
        columns = []
        for size, axis in zip(sizes, np.eye(3), strict=True):
            step = axis[:, None] * size
            change = self.law.slopes(invariants + step) - self.law.slopes(invariants - step)
            columns.append(change / (2 * size))
        hessian = np.stack(columns, axis=-1).transpose(1, 0, 2)
        return (hessian + hessian.transpose(0, 2, 1)) / 2


def _chain(by_F: Floats, hessian: Floats) -> Floats:
    """Give the tangent's part from a Hessian (m, k, k) by k quantities and their derivatives by F (m, k, 3, 3)."""
    flat = by_F.reshape(*by_F.shape[:2], 9)
    return (flat.transpose(0, 2, 1) @ (hessian @ flat)).reshape(-1, 3, 3, 3, 3)


def _invariants(F: Floats) -> Floats:
    """Give I1, I2 and J, shape (3, m)."""
    C = F.transpose(0, 2, 1) @ F
    I1 = np.trace(C, axis1=1, axis2=2)
    return np.stack([I1, (I1**2 - np.einsum("mij,mij->m", C, C)) / 2, np.linalg.det(F)])


def _gradients(F: Floats) -> Floats:
    """The derivatives of (I1, I2, J) by F, shape (m, 3, 3, 3); that of J are cofactors, also where F is singular."""
    I1 = np.einsum("mij,mij->m", F, F)[:, None, None]
    cofactors = np.stack([np.cross(F[:, 1], F[:, 2]), np.cross(F[:, 2], F[:, 0]), np.cross(F[:, 0], F[:, 1])], axis=1)
    return np.stack([2 * F, 2 * I1 * F - 2 * F @ F.transpose(0, 2, 1) @ F, cofactors], axis=1)


@dataclass(frozen=True)
class ByRotation:
    """A law as a function of d = ‖F - R‖² and t = R : F - 3, R the rotation nearest to F, by the chain rule."""

    law: Corotated

    def _differentiate_by_rotation(self, F: Floats, R: Floats) -> tuple[Floats, Floats, Floats]:
        return self.law.by_rotation(np.sum((F - R) ** 2, axis=(1, 2)), np.einsum("mij,mij->m", R, F) - 3)

    def psi(self, F: Floats) -> Floats:
        U, _, Vt = signed_svd(F)
        return self._differentiate_by_rotation(F, U @ Vt)[0]

    def stress(self, F: Floats) -> Floats:
        """See Law; d changes by 2 (F - R), t by R."""
        U, _, Vt = signed_svd(F)
        R = U @ Vt
        return np.einsum("ma,maij->mij", self._differentiate_by_rotation(F, R)[1], np.stack([2 * (F - R), R], axis=1))

    def tangent(self, F: Floats) -> Floats:
        """See Law; R's derivative is that of the projection onto rotations."""
        U, sigma, Vt = signed_svd(F)
        R = U @ Vt
        _, gradient, hessian = self._differentiate_by_rotation(F, R)
        turning = projection_derivative(U, sigma, Vt, np.ones_like(sigma), np.zeros_like(F))
        by_d, by_t = (gradient[:, a, None, None, None, None] for a in range(2))
        tangent = _chain(np.stack([2 * (F - R), R], axis=1), hessian)
        tangent += 2 * by_d * IDENTITY
        tangent += (by_t - 2 * by_d) * turning
        return tangent


@dataclass(frozen=True, eq=False)
class Distance(ABC):
    """stiffness/2 times F's squared distance to a set of matrices (SoftDECA Eq. 10); stiffness [kPa], shape (m,)."""

    stiffness: Floats

    @abstractmethod
    def nearest(self, sigma: Floats) -> tuple[Floats, Floats]:
        """The nearest stretches in the set, shape (m, 3), and their Jacobian by sigma, shape (m, 3, 3)."""

    def psi(self, F: Floats) -> Floats:
        _, sigma, _ = signed_svd(F)
        return self.stiffness / 2 * np.sum((sigma - self.nearest(sigma)[0]) ** 2, axis=1)

    def stress(self, F: Floats) -> Floats:
        U, sigma, Vt = signed_svd(F)
        excess = sigma - self.nearest(sigma)[0]
        return self.stiffness[:, None, None] * (U * excess[:, None, :]) @ Vt

    def tangent(self, F: Floats) -> Floats:
        """See Law; the derivative that holds on the side of a kink where F is."""
        U, sigma, Vt = signed_svd(F)
        derivative = projection_derivative(U, sigma, Vt, *self.nearest(sigma))
        return self.stiffness[:, None, None, None, None] * (IDENTITY - derivative)


@dataclass(frozen=True, eq=False)
class Strain(Distance):
    """To the matrices with stretches in [1/limit, limit]; limit = 1 gives stiffness/2 ‖F - R‖². limit of shape (m,)."""

    limit: Floats

    def nearest(self, sigma: Floats) -> tuple[Floats, Floats]:
        low, high = 1 / self.limit[:, None], self.limit[:, None]
        slope = np.eye(3) * ((sigma > low) & (sigma < high))[:, None, :]
        return np.clip(sigma, low, high), slope


@dataclass(frozen=True, eq=False)
class Volume(Distance):
    """To the matrices of determinant `target`, shape (m,)."""

    target: Floats

    def nearest(self, sigma: Floats) -> tuple[Floats, Floats]:
        return nearest_of_determinant(sigma, self.target)


@dataclass(frozen=True, eq=False)
class Quadratic:
    """stiffness/2 ‖F‖², of an F that is zero at rest; stiffness [kPa], shape (m,)."""

    stiffness: Floats

    def psi(self, F: Floats) -> Floats:
        return self.stiffness / 2 * np.sum(F**2, axis=(1, 2))

    def stress(self, F: Floats) -> Floats:
        return self.stiffness[:, None, None] * F

    def tangent(self, F: Floats) -> Floats:
        return self.stiffness[:, None, None, None, None] * IDENTITY


@dataclass(frozen=True, eq=False)
class Grown:
    """growth psi(F growth^(-1/3)) of another law (Rodriguez, Hoger, McCulloch 1994); growth, shape (m,)."""

    law: Law
    growth: Floats

    def _elastic(self, F: Floats) -> Floats:
        return F * self._slope[:, None, None]

    @property
    def _slope(self) -> Floats:
        return self.growth ** (-1 / 3)

    def psi(self, F: Floats) -> Floats:
        return self.growth * self.law.psi(self._elastic(F))

    def stress(self, F: Floats) -> Floats:
        return (self.growth * self._slope)[:, None, None] * self.law.stress(self._elastic(F))

    def tangent(self, F: Floats) -> Floats:
        return (self.growth * self._slope**2)[:, None, None, None, None] * self.law.tangent(self._elastic(F))


def project_spd(tangent: Floats) -> Floats:
    """The nearest positive semi-definite tangents in the Frobenius norm, of the same shape (m, 3, k, 3, k)."""
    size = tangent.shape[1] * tangent.shape[2]
    values, vectors = np.linalg.eigh(tangent.reshape(-1, size, size))
    bad = values[:, 0] < 0
    projected = tangent.reshape(-1, size, size).copy()
    projected[bad] = (vectors[bad] * np.maximum(values[bad], 0)[:, None, :]) @ vectors[bad].transpose(0, 2, 1)
    return projected.reshape(tangent.shape)


SMALL = 1e-9
TINY = 1e-300
ROOT_ITERATIONS = 80


def signed_svd(F: Floats) -> tuple[Floats, Floats, Floats]:
    """U, sigma (m, 3) and Vᵀ with F = U diag(sigma) Vᵀ, det U = det V = 1 and sigma_1 >= sigma_2 >= |sigma_3|."""
    U, sigma, Vt = np.linalg.svd(F)
    sign_U, sign_V = np.sign(np.linalg.det(U)), np.sign(np.linalg.det(Vt))
    U[:, :, 2] *= sign_U[:, None]
    Vt[:, 2, :] *= sign_V[:, None]
    sigma[:, 2] *= sign_U * sign_V
    return U, sigma, Vt


def nearest_of_determinant(sigma: Floats, target: Floats) -> tuple[Floats, Floats]:
    """The nearest stretches with product `target`, shape (m, 3), and their Jacobian by sigma, shape (m, 3, 3).

    Stationarity of |s - sigma|²/2 - c ln(s_1 s_2 s_3 / target) reads s_i (s_i - sigma_i) = c for every i. The two
    larger s_i are the larger roots; the smallest one parametrises the curve: c = s_3 (s_3 - sigma_3). What is left is
    one equation for s_3. It has one root where the product is to grow, and may have several where it is to shrink.
    """
    grow = np.prod(sigma, axis=1) <= target
    grow |= sigma[:, 2] <= 0
    edge = np.maximum(sigma[:, 2], 0)
    s3 = np.empty(len(sigma))
    s3[grow] = _root(sigma[grow], target[grow], edge[grow], edge[grow] + np.cbrt(target[grow]))
    s3[~grow] = _nearest_root(sigma[~grow], target[~grow])
    s = _project_on_curve(sigma, s3)
    return s, _slope(sigma, s)


def projection_derivative(U: Floats, sigma: Floats, Vt: Floats, nearest: Floats, slope: Floats) -> Floats:
    """The derivative by F of U diag(nearest(sigma)) Vᵀ, shape (m, 3, 3, 3, 3).

    In the frame of U and V the diagonal moves by `slope`; of each off-diagonal pair, the symmetric part is scaled by
    (s_i - s_j)/(sigma_i - sigma_j) and the antisymmetric part, a rotation, by (s_i + s_j)/(sigma_i + sigma_j).
    """
    D = np.zeros((len(sigma), 3, 3, 3, 3))
    for i in range(3):
        for j in range(3):
            D[:, i, i, j, j] = slope[:, i, j]
    for i, j in ((0, 1), (1, 2), (0, 2)):
        gap = sigma[:, i] - sigma[:, j]
        near = gap < SMALL * (1 + sigma[:, 0])
        # Where two stretches meet, the quotient becomes the derivative along their difference.
        limit = (slope[:, i, i] - slope[:, i, j] - slope[:, j, i] + slope[:, j, j]) / 2
        symmetric = np.where(near, limit, (nearest[:, i] - nearest[:, j]) / np.where(near, 1, gap))
        rotation = (nearest[:, i] + nearest[:, j]) / np.maximum(sigma[:, i] + sigma[:, j], SMALL)
        D[:, i, j, i, j] = D[:, j, i, j, i] = (symmetric + rotation) / 2
        D[:, i, j, j, i] = D[:, j, i, i, j] = (symmetric - rotation) / 2
    Q = np.einsum("mip,mqj->mijpq", U, Vt).reshape(-1, 9, 9)
    return (Q @ D.reshape(-1, 9, 9) @ Q.transpose(0, 2, 1)).reshape(-1, 3, 3, 3, 3)


def _project_on_curve(sigma: Floats, s3: Floats) -> Floats:
    """The stationary stretches whose smallest is s3, shape (m, 3)."""
    c = s3 * (s3 - sigma[:, 2])
    root = np.sqrt(np.maximum(sigma[:, :2] ** 2 + 4 * c[:, None], 0))
    return np.column_stack([(sigma[:, :2] + root) / 2, s3])


def _root(sigma: Floats, target: Floats, low: Floats, high: Floats) -> Floats:
    """The root s3 of the product's excess in [low, high], where it is <= 0 and >= 0, to the last digits.

    Newton's method, and bisection where a step leaves the bracket or is more than half of the one before.
    """
    low, high = low.copy(), high.copy()
    s3 = (low + high) / 2
    step = high - low
    for _ in range(ROOT_ITERATIONS):
        s = _project_on_curve(sigma, s3)
        product = np.prod(s, axis=1)
        below = product < target
        low[below], high[~below] = s3[below], s3[~below]
        # d ln s_i / d s_3 on the curve, from s_i (s_i - sigma_i) = s_3 (s_3 - sigma_3).
        split = s[:, :2] * (2 * s[:, :2] - sigma[:, :2])
        growth = 1 / s3 + (2 * s3 - sigma[:, 2]) * np.sum(1 / np.maximum(split, TINY), axis=1)
        newton = (target - product) / np.where(growth > 0, product * growth, TINY)
        settled = np.abs(newton) <= 1e-14 * s3
        inside = (s3 + newton > low) & (s3 + newton < high) & (np.abs(newton) <= np.abs(step) / 2)
        step = np.where(settled, 0.0, np.where(inside, newton, (low + high) / 2 - s3))
        if settled.all():
            return s3 + newton
        s3 = s3 + step
    return s3


def _nearest_root(sigma: Floats, target: Floats) -> Floats:
    """Choose the smallest or the largest root in (0, sigma_3): the one whose stretches are nearer to sigma."""
    if not len(sigma):
        return np.zeros(0)
    fractions = np.linspace(0, 1, 33)
    excess = np.stack([np.prod(_project_on_curve(sigma, f * sigma[:, 2]), axis=1) - target for f in fractions])
    first = np.argmax(excess > 0, axis=0)
    last = len(fractions) - 1 - np.argmax(excess[::-1] <= 0, axis=0)
    roots = []
    for lower in (first - 1, last):
        low, high = fractions[lower] * sigma[:, 2], fractions[lower + 1] * sigma[:, 2]
        roots.append(_root(sigma, target, low, high))
    distance = [np.sum((_project_on_curve(sigma, root) - sigma) ** 2, axis=1) for root in roots]
    return np.where(distance[0] < distance[1], roots[0], roots[1])


def _slope(sigma: Floats, s: Floats) -> Floats:
    """ds/dsigma, shape (m, 3, 3), by differentiating the Karush-Kuhn-Tucker system of the projection.

    With a multiplier nu, s - sigma + nu (s_2 s_3, s_1 s_3, s_1 s_2) = 0 and s_1 s_2 s_3 = target.
    """
    cofactor = np.stack([s[:, 1] * s[:, 2], s[:, 0] * s[:, 2], s[:, 0] * s[:, 1]], axis=1)
    nu = np.einsum("mi,mi->m", sigma - s, cofactor) / np.einsum("mi,mi->m", cofactor, cofactor)
    K = np.zeros((len(s), 4, 4))
    K[:, :3, :3] = np.eye(3)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        K[:, i, j] = K[:, j, i] = nu * s[:, k]
    K[:, :3, 3] = K[:, 3, :3] = cofactor
    # Where two nearest points merge, as at F = 2 I for the target 1, the system is singular.
    return np.linalg.pinv(K, rcond=1e-12, hermitian=True)[:, :3, :3]
