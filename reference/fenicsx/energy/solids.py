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
from ...materials import Corotated, Incompressible, Material
from ...scene import Scene
from ...terms import Hyperelastic, Strain, Volume
from ...terms import Solid as SolidTerm
from .. import dolfinx_version as seam
from ..mesh.numbering import Numbering
from .assembly import Stiffness
from .hyperelastic import MixedForms, check_mixed
from .kernels import Kernel
from .law_code import FUNCTIONS, Law
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
            psi = material.mixed_density(*invariants(elastic), p._pressure, p, FUNCTIONS)
        else:
            psi = material.density(*invariants(elastic), p, FUNCTIONS)
        return p._growth * psi if grows else psi

    return Law(values, density, has_pressure=mixed)


def invariants(s: Sequence[Any]) -> tuple[Any, Any, Any]:
    """Return I1, I2 and J of three stretches."""
    a, b, c = (x * x for x in s)
    return a + b + c, a * b + b * c + c * a, s[0] * s[1] * s[2]


@dataclass(frozen=True, eq=False)
class Solid:
    """A term whose values per tet, if any, are those of the cells (k,) that it acts on here.

    A hyperelastic law that is `mixed` has a pressure.
    """

    term: SolidTerm
    cells: Ints
    mixed: bool

    @classmethod
    def from_term(cls, scene: Scene, term: SolidTerm, numbering: Numbering, *, mixed: bool) -> Solid:
        """The part of a scene's term on the cells of this process."""
        mixed = mixed and isinstance(term, Hyperelastic)
        cells = numbering.cell[scene.tets_of(term)]
        mine = cells >= 0
        if mine.all():
            return cls(term, cells, mixed)
        changes: dict[str, object] = {"tets": scene.tets_of(term)[mine]}
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
    """What a scene's solids have in common: kernels, and the quadrature of all their cells.

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
        self.kernels = [Kernel(numbering, cells, degree, laws, pressure_dofs) for cells, laws in self._laws(solids)]
        cells = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(solid.cells for solid in solids)]))
        self.cells, self.quadrature = cells, Quadrature(numbering, cells, degree)

    def set(self, scene: Scene):
        """Take a scene's numbers."""
        for kernel, (_, laws) in zip(self.kernels, self._laws(self._solids(scene)), strict=True):
            kernel.set(laws)

    def _solids(self, scene: Scene) -> list[Solid]:
        mixed = self._pressure is not None
        return [Solid.from_term(scene, term, self._order, mixed=mixed) for term in scene.of(SolidTerm)]

    def _laws(self, solids: list[Solid]) -> list[tuple[Ints, list[Law]]]:
        """The laws of kernels by their cells: one with a pressure has its own, others on the same cells share one."""
        groups: list[tuple[Ints, list[Law]]] = []
        for solid in solids:
            for cells, laws in groups:
                if not (solid.mixed or laws[0].has_pressure) and np.array_equal(cells, solid.cells):
                    laws.append(solid.law)
                    break
            else:
                groups.append((solid.cells, [solid.law]))
        return groups

    def points(self, cells: Ints) -> Ints:
        """The quadrature points of cells (k,), counted within Quadrature, shape (k q,)."""
        q = self.quadrature.per_cell
        return (np.searchsorted(self.cells, cells)[:, None] * q + np.arange(q)).ravel()

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
        gradient, unused = np.zeros_like(self._u), np.zeros_like(self._u)
        pairs = ((kernel, unused if kernel.has_pressure else gradient) for kernel in self._solids.kernels)
        return sum(kernel.add_energy(self._u, into) for kernel, into in pairs), gradient

    def energy(self) -> float:
        """Energy [µJ] of this process' cells; infinite where a law does not hold."""
        self.place()
        energy = self._by_kernels[0]
        return energy if np.isfinite(energy) else np.inf

    def add_gradient(self, into: Floats):
        """Add the gradient [mN] of this process' cells to a field (n, 3)."""
        self.place()
        into += self._by_kernels[1]
        # Kernels' rounding would tip Rivlin's cube off its branch at the limit point, where forms' does not.
        for forms in self._solids.mixed_forms:
            seam.add_vector(forms.gradient, into.reshape(-1))

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
        """F and P [kPa] at the points of this rank, shape (k q, 3, 3), of all laws together."""
        solids = self._solids
        self.place()
        F = solids.quadrature.deformation_gradient(self._u)
        P = np.zeros_like(F)
        for kernel in solids.kernels:
            P[solids.points(kernel.cells)] += kernel.stress(self._u)
        return F, P
