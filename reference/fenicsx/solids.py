"""The energies of tets: laws by singular values at quadrature points, and laws by UFL's forms, all together.

Singular values s (m, 3) come ordered as `principal.signed_svd` orders them. Hyperelastic laws by singular values are in
`materials`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numba import njit

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Ints
from ..materials import Incompressible
from ..materials.material import HasDensity, HasStretches
from ..scene import Scene
from ..terms import Hyperelastic, Strain, Volume
from ..terms import Solid as SolidTerm
from . import dolfinx_version as seam
from . import principal
from .assembly import Stiffness
from .hyperelastic import HyperelasticForms, check_mixed
from .nearest import nearest_derivative, nearest_with_determinant
from .numbering import Numbering
from .quadrature import DEGREES, Quadrature

Law = tuple[Ints, HasStretches]
"""A law and the quadrature points, counted within Quadrature, that it acts on."""


def check_solids(scene: Scene, element: str):
    """Raise SceneError for energies of tets that an element cannot model."""
    for term in scene.of(Hyperelastic):
        if element == "P2P1":
            check_mixed(term.material)
        elif isinstance(term.material, Incompressible):
            raise SceneError(f"solver 'fenicsx' cannot model Incompressible by element {element!r}; 'P2P1' models it")
    if element == "P2P1" and scene.of(Volume):
        raise SceneError("element 'P2P1' cannot model Volume by a pressure; element 'P2' models it")
    if element == "P2P1" and not scene.of(Hyperelastic):
        raise SceneError("element 'P2P1' needs a Hyperelastic term for its pressure; element 'P2' does without")


@dataclass(frozen=True, eq=False)
class StrainLaw:
    """stiffness/2 times the squared distance of s to [1/limit, limit] growth^(1/3).

    stiffness [kPa], limit and growth are (m,).
    """

    stiffness: Floats
    limit: Floats
    growth: Floats

    def by_stretches(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """See HasStretches; at a limit above 1 the curvature is that of the free side."""
        limit, stiffness = self.limit[:, None], self.stiffness[:, None]
        size = np.cbrt(self.growth)[:, None]
        beyond = s - np.clip(s, size / limit, size * limit)
        h = np.zeros((len(s), 3, 3))
        h[:, range(3), range(3)] = stiffness * ((beyond != 0.0) | (limit == 1.0))
        return 0.5 * self.stiffness * np.sum(beyond**2, axis=1), stiffness * beyond, h


@dataclass(frozen=True, eq=False)
class VolumeLaw:
    """stiffness/2 times the squared distance of F to {det = target}; stiffness [kPa] and target are (m,)."""

    stiffness: Floats
    target: Floats

    def by_stretches(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """See HasStretches; the nearest point's derivative is implicit (see `nearest_derivative`)."""
        t = nearest_with_determinant(s, self.target)
        away = s - t
        h = self.stiffness[:, None, None] * (np.eye(3) - nearest_derivative(s, t))
        return 0.5 * self.stiffness * np.sum(away**2, axis=1), self.stiffness[:, None] * away, h


@dataclass(frozen=True, eq=False)
class Grown:
    """growth psi(s growth^(-1/3)) of another law; growth is (m,)."""

    law: HasStretches
    growth: Floats

    def by_stretches(self, s: Floats) -> tuple[Floats, Floats, Floats]:
        """See HasStretches."""
        size = np.cbrt(self.growth)
        psi, p, h = self.law.by_stretches(s / size[:, None])
        return self.growth * psi, (size**2)[:, None] * p, size[:, None, None] * h


@dataclass(frozen=True, eq=False)
class Solid:
    """A term whose values per tet, if any, are those of the cells (k,) that it acts on here."""

    term: SolidTerm
    cells: Ints

    @classmethod
    def from_term(cls, scene: Scene, term: SolidTerm, order: Numbering) -> Solid:
        """The part of a scene's term on the cells of this process."""
        cells = order.cell[scene.tets_of(term)]
        mine = cells >= 0
        if mine.all():
            return cls(term, cells)
        changes: dict[str, object] = {"tets": scene.tets_of(term)[mine]}
        changes |= {key: value[mine] for key, value in vars(term).items() if _per_tet(value, 1) and key != "tets"}
        if isinstance(term, Hyperelastic):
            law = term.material
            values = {field.name: getattr(law, field.name) for field in fields(law)}
            by_tet = {key: value[mine] for key, value in values.items() if _per_tet(value, 2)}
            changes["material"] = replace(law, **by_tet) if by_tet else law
        return cls(replace(term, **changes), cells[mine])


def _per_tet(value, dimensions: int) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == dimensions


class Solids:
    """What a scene's solids have in common: quadrature, forms, and the present numbers of their laws.

    A law goes by UFL's forms if it has a density, or with a pressure, if one is given; else by its singular values.
    `forms` are the former, `softness` (cells,) [1/kPa] the sum of 1/mu of laws with a pressure.
    """

    def __init__(self, scene: Scene, order: Numbering, pressure):
        self._order, self._pressure = order, pressure
        self._displacement = seam.function(order.space)
        solids = self._solids(scene)
        cells = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(solid.cells for solid in solids)]))
        degree = DEGREES[order.degree]
        self.cells, self.quadrature = cells, Quadrature(order, cells, degree)
        self.forms: list[HyperelasticForms] = []
        self._tensors: list[tuple[Ints, HyperelasticForms]] = []
        self.softness = np.zeros(len(order.cell_dofs))
        for solid in solids:
            term = solid.term
            if not self._is_by_ufl(term):
                continue
            assert isinstance(term, Hyperelastic)
            forms = HyperelasticForms(self._displacement, solid.cells, term.material, degree, term.growth, pressure)
            self.forms.append(forms)
            if pressure is not None:
                self.softness[solid.cells] += 1.0 / term.material.shear_modulus
            if pressure is not None or not isinstance(term.material, HasStretches):
                self._tensors.append((self._points(solid.cells), forms))
        self.set(scene)

    def set(self, scene: Scene):
        """Take a scene's numbers."""
        self._laws: list[Law] = []
        self._stretched: list[Law] = []
        for solid in self._solids(scene):
            term = solid.term
            if not self._is_by_ufl(term):
                self._laws.append(self._law(solid))
            elif self._pressure is None and isinstance(term, Hyperelastic) and isinstance(term.material, HasStretches):
                self._stretched.append(self._law(solid))

    def _solids(self, scene: Scene) -> list[Solid]:
        return [Solid.from_term(scene, term, self._order) for term in scene.of(SolidTerm)]

    def _points(self, cells: Ints) -> Ints:
        """The quadrature points of cells (k,), counted within Quadrature, shape (k q,)."""
        q = self.quadrature.per_cell
        return (np.searchsorted(self.cells, cells)[:, None] * q + np.arange(q)).ravel()

    def _is_by_ufl(self, term: SolidTerm) -> bool:
        by_density = self._pressure is not None or isinstance(getattr(term, "material", None), HasDensity)
        return isinstance(term, Hyperelastic) and by_density

    def _law(self, solid: Solid) -> Law:
        term = solid.term

        def at_points(values: Floats | float) -> Floats:
            per_cell = np.broadcast_to(values, len(solid.cells))
            return np.repeat(per_cell, self.quadrature.per_cell).astype(np.float64)

        points = self._points(solid.cells)
        if isinstance(term, Strain):
            return points, StrainLaw(at_points(term.stiffness), at_points(term.limit), at_points(term.growth))
        if isinstance(term, Volume):
            return points, VolumeLaw(at_points(term.stiffness), at_points(term.target))
        assert isinstance(term, Hyperelastic) and isinstance(term.material, HasStretches)
        return points, term.material if np.all(term.growth == 1.0) else Grown(term.material, at_points(term.growth))

    def at(self, u: Floats, p: Floats) -> SolidState:
        """The solids at a displacement [mm], (n, 3), and a pressure [kPa], (n_p,), if there is one."""
        return SolidState(self, u, p)


class SolidState:
    """Energy, gradient and Hessian of the solids at one displacement and pressure; what they share is computed once."""

    def __init__(self, solids: Solids, u: Floats, p: Floats):
        self._solids, self._u, self._pressure = solids, u, p
        self._frame: tuple[Floats, Floats, Floats] | None = None
        if solids._laws:
            self._psi, self._p, self._h = self._by_stretches(solids._laws)

    def place(self):
        """Have the forms take this displacement and pressure."""
        solids = self._solids
        solids._displacement.x.array[:] = self._u[: solids._order.function_nodes].ravel()
        if solids._pressure is not None:
            solids._pressure.x.array[:] = self._pressure

    def _svd(self) -> tuple[Floats, Floats, Floats]:
        """U, s, V of F at the quadrature points."""
        if self._frame is None:
            self._frame = principal.signed_svd(self._solids.quadrature.deformation_gradient(self._u))
        return self._frame

    def _by_stretches(self, laws: list[Law]) -> tuple[Floats, Floats, Floats]:
        """Sum up psi, its gradient and its Hessian by the singular values at all points."""
        s = self._svd()[1]
        psi, p, h = np.zeros(len(s)), np.zeros((len(s), 3)), np.zeros((len(s), 3, 3))
        for points, law in laws:
            add_at(points, *law.by_stretches(s[points]), psi, p, h)
        return psi, p, h

    def energy(self) -> float:
        """Energy [µJ] of this process' cells; infinite where a law does not hold."""
        self.place()
        energy = float(self._psi @ self._solids.quadrature.volume) if self._solids._laws else 0.0
        return energy + sum(forms.assemble_energy() for forms in self._solids.forms)

    def add_gradient(self, into: Floats):
        """Add the gradient [mN] of this process' cells to a field (n, 3)."""
        self.place()
        if self._solids._laws:
            U, _, V = self._svd()
            self._solids.quadrature.add_gradient(principal.stress(U, V, self._p), into)
        for forms in self._solids.forms:
            forms.add_gradient(into.reshape(-1))

    def add_hessian(self, into: Stiffness, kept: float):
        """Add the Hessian [mN/mm], every negative eigenvalue of every point's tangent multiplied by `kept`."""
        solids = self._solids
        self.place()
        for points, forms in solids._tensors:
            if kept == 1.0:
                seam.add_matrix(forms.tangent, into.local)
            else:
                solids.quadrature.add_tangent(points, forms.softened_tangent(kept), into)
        into.local.assemble()
        if solids._laws or solids._stretched:
            U, s, V = self._svd()
            if solids._stretched:
                _, p, h = self._by_stretches([*solids._laws, *solids._stretched])
            else:
                p, h = self._p, self._h
            solids.quadrature.add_modes(U, V, principal.modes(s, p, h).soften(kept), into)

    def add_strain(self, into: Floats):
        """Add the energy's derivative by the pressure [mm³], if there is one, to a field (n_p,)."""
        self.place()
        for forms in self._solids.forms if self._solids._pressure is not None else ():
            seam.add_vector(forms.by_pressure, into)

    def stresses(self) -> tuple[Floats, Floats]:
        """F and P [kPa] at the points of this rank, shape (k q, 3, 3), of all laws together."""
        solids = self._solids
        self.place()
        F = solids.quadrature.deformation_gradient(self._u)
        P = np.zeros_like(F)
        if solids._laws:
            U, _, V = self._svd()
            P += principal.stress(U, V, self._p)
        for forms in solids.forms:
            P[solids._points(forms.cells)] += forms.point_stress()
        return F, P


@njit(cache=True)
def add_at(points, psi, p, h, into_psi, into_p, into_h):
    """Add what a law gives at some points (m,) to the sums of all laws at all points."""
    for n in range(len(points)):
        at = points[n]
        into_psi[at] += psi[n]
        for i in range(3):
            into_p[at, i] += p[n, i]
            for j in range(3):
                into_h[at, i, j] += h[n, i, j]
