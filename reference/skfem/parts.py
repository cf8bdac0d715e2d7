"""The parts of a scene's energy over scikit-fem's degrees of freedom: tets, membranes, springs, dead loads.

Every part has `value(x)` [µJ], `gradient(x)` [mN], shape (size,), and `hessian(x, treat)` [mN/mm], where `treat` is
applied to each element's tangent (project_spd, or nothing). x holds positions [mm] by degree of freedom.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from skfem import Basis, BilinearForm, ElementTetP1, ElementVector, LinearForm, MeshTet

from ...lhm.mesh import Floats, Ints
from .. import materials, terms
from ..scene import Scene
from .invariants import IsochoricPolynomial, StableNeoHookean, StVenantKirchhoff
from .laws import Corotated, Law, NeoHookean, Strain, Volume
from .membrane import Membrane, rest_gradients

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


class Discretisation:
    """Linear tets over a scene's mesh; `dofs` (n, 3) is where scikit-fem numbers the components of each vertex.

    scikit-fem does not count vertices behind the last one of a tet: their `dofs` follow after its own.
    """

    def __init__(self, scene: Scene):
        points, corners = (np.ascontiguousarray(array.T) for array in (scene.vertices, scene.tets))
        self.basis = Basis(MeshTet(points, corners), ElementVector(ElementTetP1()), intorder=1)
        self.size = 3 * len(scene.vertices)
        behind = np.arange(self.basis.N, self.size).reshape(-1, 3)
        self.dofs: Ints = np.concatenate([self.basis.nodal_dofs.T, behind])

    def flat(self, values: Floats) -> Floats:
        """Values per vertex, shape (n, 3), by degree of freedom."""
        result = np.empty(self.size, dtype=np.asarray(values).dtype)
        result[self.dofs] = values
        return result


@LinearForm
def _virtual_work(v, w):
    return np.einsum("ij...,ij...", w["stress"], v.grad)


@BilinearForm
def _stiffness(u, v, w):
    return np.einsum("ijkl...,ij...,kl...", w["tangent"], v.grad, u.grad)


class Tets:
    """All tet terms together, so that the tangents are projected once per tet and not once per term."""

    def __init__(self, scene: Scene, at: Discretisation):
        self._basis = at.basis
        self._size = at.size
        self._volumes = at.basis.dx[:, 0]
        self._laws: list[tuple[Law, Ints]] = []
        for term in scene.terms:
            if isinstance(term, (terms.Hyperelastic, terms.Strain, terms.Volume)):
                tets = scene.tets_of(term)
                self._laws.append((_law(term, len(tets)), tets))

    def _deformation_gradients(self, x: Floats) -> Floats:
        return self._basis.interpolate(x[: self._basis.N]).grad[..., 0].transpose(2, 0, 1)

    def value(self, x: Floats) -> float:
        """See Part."""
        F = self._deformation_gradients(x)
        return sum(float(self._volumes[tets] @ law.psi(F[tets])) for law, tets in self._laws)

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        F = self._deformation_gradients(x)
        P = np.zeros_like(F)
        for law, tets in self._laws:
            P[tets] += law.stress(F[tets])
        forces = _virtual_work.assemble(self._basis, stress=P.transpose(1, 2, 0)[..., None])
        return np.pad(forces, (0, self._size - len(forces)))

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part."""
        F = self._deformation_gradients(x)
        tangent = np.zeros((len(F), 3, 3, 3, 3))
        for law, tets in self._laws:
            tangent[tets] += law.tangent(F[tets])
        # scikit-fem has the elements and the quadrature points last.
        tangent = np.ascontiguousarray(treat(tangent).transpose(1, 2, 3, 4, 0))[..., None]
        matrix = _stiffness.assemble(self._basis, tangent=tangent).tocsr()
        matrix.resize(self._size, self._size)
        return matrix


MATERIALS: dict[type[materials.Material], Callable[[Any], Law]] = {
    materials.NeoHookean: lambda m: NeoHookean(m.mu, m.lmbda),
    materials.StableNeoHookean: lambda m: StableNeoHookean(m.mu, m.lmbda),
    materials.Corotated: lambda m: Corotated(m.mu, m.lmbda),
    materials.StVenantKirchhoff: lambda m: StVenantKirchhoff(m.mu, m.lmbda),
    materials.IsochoricNeoHookean: lambda m: IsochoricPolynomial(m.mu / 2, 0.0, 0.0, m.kappa, m.volumetric),
    materials.MooneyRivlin: lambda m: IsochoricPolynomial(m.C10, m.C01, m.C20, m.kappa, materials.Volumetric.QUADRATIC),
}


def _law(term, count: int) -> Law:
    if isinstance(term, terms.Hyperelastic):
        return MATERIALS[type(term.material)](term.material)
    if isinstance(term, terms.Strain):
        return Strain(_per_item(term.stiffness, count), _per_item(term.limit, count))
    return Volume(_per_item(term.stiffness, count), _per_item(term.target, count))


def _per_item(value, count: int) -> Floats:
    return np.broadcast_to(value, (count,)).astype(np.float64)


class Membranes:
    """One SurfaceStrain term."""

    def __init__(self, scene: Scene, term: terms.SurfaceStrain, at: Discretisation):
        count = len(term.triangles)
        self._law = Membrane(_per_item(term.stiffness, count), _per_item(term.growth, count))
        _, self._areas = rest_gradients(scene.vertices, term.triangles)
        self._gradients, _ = rest_gradients(scene.vertices if term.rest is None else term.rest, term.triangles)
        self._dofs = at.dofs[term.triangles]
        self._size = at.size

    def _deformation_gradients(self, x: Floats) -> Floats:
        return np.einsum("mci,mca->mia", x[self._dofs], self._gradients)

    def value(self, x: Floats) -> float:
        """See Part."""
        return float(self._areas @ self._law.psi(self._deformation_gradients(x)))

    def gradient(self, x: Floats) -> Floats:
        """See Part."""
        P = self._law.stress(self._deformation_gradients(x))
        forces = np.einsum("m,mia,mca->mci", self._areas, P, self._gradients)
        gradient = np.zeros(self._size)
        np.add.at(gradient, self._dofs, forces)
        return gradient

    def hessian(self, x: Floats, treat: Treatment) -> csr_matrix:
        """See Part."""
        tangent = treat(self._law.tangent(self._deformation_gradients(x)))
        weighted = self._areas[:, None, None] * self._gradients
        blocks = np.einsum("mca,miakb,mdb->mcidk", weighted, tangent, self._gradients, optimize=True)
        rows = np.broadcast_to(self._dofs[:, :, :, None, None], blocks.shape)
        columns = np.broadcast_to(self._dofs[:, None, None, :, :], blocks.shape)
        shape = (self._size, self._size)
        return coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=shape).tocsr()


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
        self._forces = at.flat(scene.loads())
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
