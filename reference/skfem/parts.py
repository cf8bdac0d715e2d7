"""The parts of a scene's energy over scikit-fem's degrees of freedom: tets, membranes, springs, dead loads.

Every part has `value(x)` [µJ], `gradient(x)` [mN], shape (size,), and `hessian(x, treat)` [mN/mm], where `treat` is
applied to the tangent at each point (project_spd, or nothing). x holds positions [mm] by degree of freedom.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from scipy.sparse import csr_matrix, diags

from ...lhm.base.mesh import Floats, Ints
from .. import materials, terms
from ..scene import Scene
from .discretisation import Discretisation
from .invariants import Brought, IsochoricPolynomial, StableNeoHookean, StVenantKirchhoff
from .laws import Corotated, Grown, Law, NeoHookean, Strain, Volume
from .membrane import Membrane

Treatment = Callable[[Floats], Floats]


class Part(Protocol):
    """One part of the energy; see the module."""

    def value(self, x: Floats) -> float:
        """Energy [µJ]; infinite where a law does not hold."""
        ...

    def gradient(self, x: Floats) -> Floats:
        """Gradient [mN], shape (size,), where the energy is finite."""
        ...

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """Hessian [mN/mm], shape (size, size), where the energy is finite."""
        ...


class Tets:
    """All tet terms together, so that the tangents are projected once per point and not once per term."""

    def __init__(self, scene: Scene, at: Discretisation):
        self._elements = at.tets
        self._laws: list[tuple[Law, Ints]] = []
        for term in scene.terms:
            if isinstance(term, (terms.Hyperelastic, terms.Strain, terms.Volume)):
                tets = scene.tets_of(term)
                self._laws.append((_law(term, len(tets), at.tets.weights.shape[1]), at.tets.points(tets)))

    def value(self, x: Floats) -> float:
        """See Part."""
        F = self._elements.deformation_gradients(x)
        psi = np.zeros(len(F))
        for law, points in self._laws:
            psi[points] += law.psi(F[points])
        return self._elements.integral(psi)

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        return self._elements.forces(self.stress(x)[1])

    def stress(self, x: Floats) -> tuple[Floats, Floats]:
        """F and P [kPa] at the points, shape (m q, 3, 3), where the energy is finite."""
        F = self._elements.deformation_gradients(x)
        P = np.zeros_like(F)
        for law, points in self._laws:
            P[points] += law.stress(F[points])
        return F, P

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part."""
        F = self._elements.deformation_gradients(x)
        tangent = np.zeros((len(F), 3, 3, 3, 3))
        for law, points in self._laws:
            tangent[points] += law.tangent(F[points])
        return self._elements.stiffness(treat(tangent))


MATERIALS: dict[type[materials.Material], Callable[[Any], Law]] = {
    materials.NeoHookean: lambda m: NeoHookean(m.mu, m.lmbda),
    materials.StableNeoHookean: lambda m: StableNeoHookean(m.mu, m.lmbda),
    materials.Corotated: lambda m: Corotated(m.mu, m.lmbda),
    materials.StVenantKirchhoff: lambda m: StVenantKirchhoff(m.mu, m.lmbda),
    materials.IsochoricNeoHookean: lambda m: IsochoricPolynomial(m.mu / 2, 0.0, 0.0, m.kappa, m.volumetric),
    materials.MooneyRivlin: lambda m: IsochoricPolynomial(m.C10, m.C01, m.C20, m.kappa, materials.Volumetric.QUADRATIC),
}


def _law(term, tets: int, points: int) -> Law:
    """A term's law with parameters per point, of which each tet has `points`."""

    def at_points(values) -> Floats:
        return np.repeat(_per_item(values, tets), points)

    if isinstance(term, terms.Volume):
        return Volume(at_points(term.stiffness), at_points(term.target))
    growth, law = at_points(term.growth), _at_rest(term, at_points)
    if np.all(growth == 1.0):
        return law
    return Grown(law, growth, growth if isinstance(term, terms.Hyperelastic) else growth ** (2 / 3))


def _at_rest(term, at_points: Callable[..., Floats]) -> Law:
    """The law of a Hyperelastic or Strain that has not grown."""
    if isinstance(term, terms.Hyperelastic):
        law = term.material
        return Brought(law) if isinstance(law, materials.EnergyLaw) else MATERIALS[type(law)](law)
    return Strain(at_points(term.stiffness), at_points(term.limit))


def _per_item(value, count: int) -> Floats:
    return np.broadcast_to(value, (count,)).astype(np.float64)


class Membranes:
    """One SurfaceStrain term."""

    def __init__(self, scene: Scene, term: terms.SurfaceStrain, at: Discretisation):
        self._elements = at.triangles(term.name, term.triangles, term.rest)
        self._law = Membrane(self._elements.at_points(term.stiffness), self._elements.at_points(term.growth))

    def value(self, x: Floats) -> float:
        """See Part."""
        return self._elements.integral(self._law.psi(self._elements.deformation_gradients(x)))

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        return self._elements.forces(self._law.stress(self._elements.deformation_gradients(x)))

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part."""
        return self._elements.stiffness(treat(self._law.tangent(self._elements.deformation_gradients(x))))


class Springs:
    """Springs that pull vertices (k,) to positions [mm], shape (k, 3), with stiffness [mN/mm], one or (k,)."""

    def __init__(self, vertices: Ints, positions: Floats, stiffness, at: Discretisation):
        self._dofs = at.dofs[vertices]
        self._positions = positions
        self._stiffness = np.zeros(at.size)
        self._stiffness[self._dofs] = _per_item(stiffness, len(vertices))[:, None]

    def _stretch(self, x: Floats) -> Floats:
        stretch = np.zeros(len(x))
        stretch[self._dofs] = x[self._dofs] - self._positions
        return stretch

    def value(self, x: Floats) -> float:
        """See Part."""
        return 0.5 * float(self._stiffness @ self._stretch(x) ** 2)

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        return self._stiffness * self._stretch(x)

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part; a spring's tangent is positive and needs no treatment."""
        return diags(self._stiffness, format="csr")


class DeadLoads:
    """The potential of all Gravity and Traction terms, zero at rest."""

    def __init__(self, scene: Scene, at: Discretisation):
        self._forces = np.zeros(at.size)
        for term in scene.of(terms.Gravity):
            tets = scene.tets_of(term)
            force = np.zeros(scene.tets.shape[:1])
            force[tets] = term.density
            self._forces += at.tets.loads(force[:, None] * term.acceleration)
        for term in scene.of(terms.Traction):
            faces = at.triangles(term.name, term.triangles)
            self._forces += faces.loads(np.broadcast_to(term.vector, (len(term.triangles), 3)))
        self._rest = at.flat(scene.vertices)

    def value(self, x: Floats) -> float:
        """See Part."""
        return -float(self._forces @ (x - self._rest))

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        return -self._forces

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part; a dead load has none."""
        return csr_matrix((len(x), len(x)))
