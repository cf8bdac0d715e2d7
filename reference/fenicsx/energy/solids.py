"""The energies of tets, all together, by compiled kernels; by UFL's forms the derivatives of laws with a pressure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from ....lhm.base.errors import SceneError, quote
from ....lhm.base.mesh import Floats, Ints
from ...clock import count_compilation
from ...materials import Corotated, EnergyLaw, Incompressible, Material, MixedLaw
from ...scene import Scene
from ...terms import Hourglass, Hyperelastic, Strain, Volume
from ...terms import Solid as SolidTerm
from .. import dolfinx_version as seam
from ..mesh.numbering import Numbering
from .assembly import Stiffness
from .hyperelastic import MixedForms, check_mixed
from .kernels import Elements, Kernel
from .law_code import FUNCTIONS, Law
from .prisms import Prisms
from .quadrature import DEGREES, Quadrature


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


def strain_law(stiffness: Floats, limit: Floats) -> Law:
    """stiffness/2 times the squared distance of s to [1/limit, limit].

    Both are (k,), stiffness in kPa. At a limit above 1 the curvature at a bound is that of the free side.
    """

    def density(s: Sequence[Any], p: Any) -> Any:
        where = FUNCTIONS.where
        psi = 0.0
        for value in s:
            within = where(p.limit > 1.0, 0.0, value - p.limit)
            outside = where(value < p.low, value - p.low, within)
            psi += p.stiffness / 2 * where(value > p.limit, value - p.limit, outside) ** 2
        return psi

    return Law({"stiffness": stiffness, "limit": limit, "low": 1.0 / limit}, density)


class VolumeLaw(Law):
    """stiffness/2 times the squared distance of F to {det = target}; stiffness [kPa] and target are (k,)."""

    def __init__(self, stiffness: Floats, target: Floats):
        super().__init__({"stiffness": stiffness, "target": target})

    @cached_property
    def code(self) -> str:
        """See Law; the nearest point is found by iteration, which is written by hand."""
        return "  psi = volume_law(s, parameters[0], parameters[1], p, h);"


def hyperelastic_law(material: Material, growth: Floats, *, mixed: bool = False) -> Law:
    """Growth psi(F growth^(-1/3)) of a law; growth is (k,). A mixed one has its mixed density, of a pressure."""
    law = material.law if isinstance(material, Incompressible) else material
    values = {field.name: getattr(law, field.name) for field in fields(law)}
    for name, value in values.items():
        if isinstance(value, (int, float, np.number)):
            values[name] = np.full(len(growth), float(value))
    grows = bool(np.any(growth != 1.0))
    if grows:
        values |= {"_growth": growth, "_size": np.cbrt(growth)}

    def density(s: Sequence[Any], p: Any) -> Any:
        elastic = [x / p._size for x in s] if grows else s
        if isinstance(material, Corotated):
            psi = material.by_stretches(elastic, p)
        elif mixed:
            assert isinstance(material, (MixedLaw, Incompressible))
            psi = material.mixed_density(*invariants(elastic), p._pressure, p, FUNCTIONS)
        else:
            assert isinstance(material, EnergyLaw)
            psi = material.density(*invariants(elastic), p, FUNCTIONS)
        return p._growth * psi if grows else psi

    return Law(values, density, has_pressure=mixed)


def invariants(s: Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return I1, I2 and J of three stretches."""
    a, b, c = (x * x for x in s)
    return a + b + c, a * b + b * c + c * a, s[0] * s[1] * s[2]


@dataclass(frozen=True, eq=False)
class Solid:
    """A term whose values per cell, if any, are those of the cells (k,) here that it acts on: tets, or prisms.

    A hyperelastic law that is `mixed` has a pressure.
    """

    term: SolidTerm
    cells: Ints
    mixed: bool

    @classmethod
    def from_term(cls, scene: Scene, term: SolidTerm, numbering: Numbering, *, mixed: bool) -> Solid:
        """The part of a scene's term on the cells of this process."""
        mixed = mixed and isinstance(term, Hyperelastic)
        tets = scene.tets_of(term)
        cells = numbering.prism[tets[:, 0]] if term.on_prisms else numbering.cell[tets]
        mine = cells >= 0
        if mine.all():
            return cls(term, cells, mixed)
        changes: dict[str, object] = {"tets": tets[mine]}
        for key, value in vars(term).items():
            if key != "tets" and isinstance(value, np.ndarray) and value.ndim == 1:
                changes[key] = value[mine]
        return cls(replace(term, **changes), cells[mine], mixed)

    @cached_property
    def law(self) -> Law:
        """The term's law on its cells."""
        term = self.term

        def per_cell(values: Floats | float) -> Floats:
            return np.broadcast_to(values, len(self.cells)).astype(np.float64)

        if isinstance(term, Strain):
            return strain_law(per_cell(term.stiffness), per_cell(term.limit))
        if isinstance(term, Volume):
            return VolumeLaw(per_cell(term.stiffness), per_cell(term.target))
        assert isinstance(term, Hyperelastic)
        return hyperelastic_law(term.material, per_cell(term.growth), mixed=self.mixed)

    def check_code(self):
        """Write the law's code; SceneError for a density that does what its formula's values cannot."""
        try:
            with count_compilation():
                _ = self.law.code
        except (TypeError, AttributeError) as error:
            assert isinstance(self.term, Hyperelastic)
            name = self.term.material.name
            raise SceneError(f"solver 'fenicsx' cannot model {name}: its density: {quote(str(error), 100)}") from None


class Solids:
    """All solids of a scene: kernels, and the quadrature of all their cells.

    `mixed_forms` are of the laws with a pressure, for their derivatives. `softness` (cells,) [1/kPa] is the sum of 1/mu
    of these laws. `pressure` is a function of linear elements and `pressure_dofs` its nodes by cell, (cells, 4).
    """

    def __init__(self, scene: Scene, numbering: Numbering, pressure, pressure_dofs: Ints | None = None):
        self._order, self._pressure = numbering, pressure
        self._displacement = seam.function(numbering.space)
        self.softness = np.zeros(len(numbering.cell_dofs))
        degree = DEGREES[numbering.degree]
        solids = self._solids(scene)
        self.mixed_forms: list[MixedForms] = []
        for solid in solids:
            solid.check_code()
            if solid.mixed:
                assert isinstance(solid.term, Hyperelastic)
                law, growth = solid.term.material, solid.term.growth
                self.mixed_forms.append(MixedForms(self._displacement, solid.cells, law, degree, growth, pressure))
                self.softness[solid.cells] += 1.0 / law.shear_modulus
        self.prisms = Prisms.from_scene(scene, numbering)
        self._tets_of_prisms = scene.prisms
        self._groups = self._group(solids)
        self.kernels = [self._kernel(group, degree, pressure_dofs) for group in self._groups]
        tets = [scene.tets_of(term).ravel() for term in scene.of(SolidTerm)]
        cells = np.unique(numbering.cell[np.concatenate([np.empty(0, dtype=np.int64), *tets])])
        self.cells = cells[cells >= 0]
        self.quadrature = Quadrature(numbering, self.cells, degree)

    def set(self, scene: Scene):
        """Take a scene's numbers."""
        for kernel, group in zip(self.kernels, self._group(self._solids(scene)), strict=True):
            kernel.set([solid.law for solid in group])

    def _solids(self, scene: Scene) -> list[Solid]:
        mixed = self._pressure is not None
        laws = [term for term in scene.of(SolidTerm) if not isinstance(term, Hourglass)]
        return [Solid.from_term(scene, term, self._order, mixed=mixed) for term in laws]

    def _group(self, solids: list[Solid]) -> list[list[Solid]]:
        """Group the solids of a kernel: one with a pressure has its own, others on the same cells share one."""
        groups: list[list[Solid]] = []
        for solid in solids:
            for group in groups:
                same = group[0].term.on_prisms == solid.term.on_prisms and np.array_equal(group[0].cells, solid.cells)
                if same and not (solid.mixed or group[0].mixed):
                    group.append(solid)
                    break
            else:
                groups.append([solid])
        return groups

    def _kernel(self, group: list[Solid], degree: int, pressure_dofs: Ints | None) -> Kernel:
        cells, laws = group[0].cells, [solid.law for solid in group]
        if group[0].term.on_prisms:
            return Kernel(Elements.from_prisms(self.prisms, cells), laws)
        elements = Elements.from_tets(self._order, cells, degree)
        at_corners = None if pressure_dofs is None or not group[0].mixed else pressure_dofs[cells]
        return Kernel(elements, laws, at_corners)

    def points(self, cells: Ints) -> Ints:
        """The quadrature points of cells (k,), counted within Quadrature, shape (k q,)."""
        q = self.quadrature.per_cell
        return (np.searchsorted(self.cells, cells)[:, None] * q + np.arange(q)).ravel()

    def points_of_prisms(self) -> tuple[Ints, Ints]:
        """The points of this rank's tets that belong to a prism, and which of the scene's prisms that is, (k,) each."""
        cells = self._order.cell[self._tets_of_prisms]
        rows, which = np.nonzero(cells >= 0)
        return self.points(cells[rows, which]), rows

    def of_all_ranks(self, values: Floats) -> Floats:
        """Values by this rank's prisms, (r, 3, 3), as those by the scene's."""
        total = np.zeros((len(self._tets_of_prisms), 3, 3))
        total[self._order.prisms] = values
        return self._order.comm.allreduce(total)

    def at(self, u: Floats, p: Floats) -> SolidState:
        """The solids at a displacement [mm], (n, 3), and a pressure [kPa], (n_p,), if there is one."""
        return SolidState(self, u, p)


class SolidState:
    """Energy, gradient and Hessian of the solids at one displacement and pressure."""

    def __init__(self, solids: Solids, u: Floats, p: Floats):
        self._solids, self._u, self._pressure = solids, np.ascontiguousarray(u), p

    def place(self):
        """Have mixed forms and kernels take this displacement and pressure."""
        solids = self._solids
        solids._displacement.x.array[:] = self._u[: solids._order.function_nodes].ravel()
        if solids._pressure is not None:
            solids._pressure.x.array[:] = self._pressure
            for kernel in solids.kernels:
                kernel.take_pressure(self._pressure)

    @cached_property
    def _by_kernels(self) -> tuple[float, Floats]:
        """The kernels' energy [µJ] and gradient [mN], a field (n, 3), which cost little more than one of them."""
        gradient = np.zeros_like(self._u)
        return sum(kernel.add_energy(self._u, gradient) for kernel in self._solids.kernels), gradient

    def energy(self) -> float:
        """Energy [µJ] of this process' cells; infinite where a law does not hold."""
        self.place()
        energy = self._by_kernels[0]
        return energy if np.isfinite(energy) else np.inf

    def add_gradient(self, into: Floats):
        """Add the gradient [mN] of this process' cells to a field (n, 3)."""
        self.place()
        into += self._by_kernels[1]

    def add_hessian(self, into: Stiffness, kept: float):
        """Add the Hessian [mN/mm], every negative eigenvalue of every point's tangent multiplied by `kept`."""
        self.place()
        for kernel in self._solids.kernels:
            kernel.add_hessian(self._u, kept, into)

    def add_strain(self, into: Floats):
        """Add the energy's derivative by the pressure [mm³], if there is one, to a field (n_p,)."""
        self.place()
        for forms in self._solids.mixed_forms:
            seam.add_vector(forms.by_pressure, into)

    def stresses(self) -> tuple[Floats, Floats]:
        """F and P [kPa] at the points of this rank, shape (k q, 3, 3), of all laws together; a prism's at its tets."""
        solids = self._solids
        self.place()
        F = solids.quadrature.deformation_gradient(self._u)
        P, of_prisms = np.zeros_like(F), np.zeros((len(solids.prisms.nodes), 3, 3))
        for kernel, group in zip(solids.kernels, solids._groups, strict=True):
            if group[0].term.on_prisms:
                of_prisms[group[0].cells] += kernel.stress(self._u)
            else:
                P[solids.points(group[0].cells)] += kernel.stress(self._u)
        points, rows = solids.points_of_prisms()
        F[points] = solids.of_all_ranks(solids.prisms.deformation(self._u))[rows]
        P[points] += solids.of_all_ranks(of_prisms)[rows]
        return F, P
