"""A mixed problem's energy of the displacement alone: the pressure is the one that maximises it, held back by a spring.

With Π(u, p) of `mixed_densities`, E(u) = max over p of Π(u, p) - (p - p₀)² / (2 kappa): for J = 1 the augmented
Lagrangian of Hestenes and Powell with multiplier p₀ (Bertsekas 1982, "Constrained Optimization and Lagrange Multiplier
Methods", Chapter 2), for other laws their own energy with a bulk modulus cut down to what Newton's method can follow.
E's minimiser is the problem's own once p₀ is its pressure, whatever kappa.
"""

from __future__ import annotations

import numpy as np
import ufl
from scipy.sparse import coo_matrix, csr_matrix

from ...lhm.mesh import Floats, Ints
from ..materials import Incompressible, Isotropic, Material
from . import dolfinx_version as seam
from .direct import Factorisation
from .dolfinx_version import PETSc
from .mixed_forms import matrix_entries
from .problem import Problem, State

PENALTY = 30.0
"""kappa by the shear modulus: the error of p₀ falls to a tenth or less per minimisation, in two or three steps each."""
SETTLED = 1e-10  # of the pressure's norm, below which a correction is rounding or of no account
CORRECTIONS = 30

Entries = tuple[Ints, Ints, Floats]


def shear_modulus(material: Material) -> float:
    """The scale [kPa] of a law's resistance to a change of shape."""
    law = material.law if isinstance(material, Incompressible) else material
    return law.lame[0] if isinstance(law, Isotropic) else law.stiffness


class Condensed:
    """Energy, gradient and Hessian of E over the displacement's dofs, as `Newton` asks for them.

    `centre` is p₀ [kPa], shape (n_p,); `used` are the pressures that any law has; `hardening` multiplies kappa. `laws`
    go with the problem's `mixed_forms`.
    """

    def __init__(self, problem: Problem, laws: list[Material]):
        assert problem.pressure is not None
        self.problem, self.comm = problem, problem.comm
        self.count = len(problem.pressure.x.array)
        self.centre: Floats = np.zeros(self.count)
        self.hardening = 1.0
        used = np.zeros(self.count, dtype=bool)
        for forms in problem.mixed_forms:
            used[problem.pressure_dofs[forms.cells].ravel()] = True
        self.used: Ints = np.flatnonzero(used)
        self._springs = self._springs_of(laws)
        self._spring = self._matrix([self._springs])
        self._factors = Factorisation()

    def _springs_of(self, laws: list[Material]) -> Entries:
        """1/kappa [1/kPa] times the mass matrix [mm³]."""
        assert self.problem.pressure is not None
        space = self.problem.pressure.function_space
        p, q = ufl.TrialFunction(space), ufl.TestFunction(space)
        parts = []
        for forms, law in zip(self.problem.mixed_forms, laws, strict=True):
            softness = seam.constant(space.mesh, 1.0 / (PENALTY * shear_modulus(law)))
            form = seam.compile_form(softness * p * q * seam.cell_measure(space.mesh, forms.cells))
            matrix = seam.empty_matrix(form)
            seam.add_matrix(form, matrix)
            matrix.assemble()
            parts.append(matrix_entries(matrix))
            matrix.destroy()
        return _joined(parts)

    def _matrix(self, parts: list[Entries]) -> csr_matrix:
        rows, columns, values = _joined(parts)
        return coo_matrix((values, (rows, columns)), shape=(self.count, self.count)).tocsr()

    @property
    def energy_scale(self) -> float:
        """See Problem."""
        return self.problem.energy_scale

    def place(self, p: Floats):
        """Give the problem's forms a pressure [kPa], shape (n_p,)."""
        assert self.problem.pressure is not None
        self.problem.pressure.x.array[:] = p

    def strain(self) -> Floats:
        """Π's derivative by the pressure [mm³], shape (n_p,), where the problem was last."""
        result = np.zeros(self.count)
        for forms in self.problem.mixed_forms:
            forms.add_by_pressure(result)
        return result

    def compliance(self, *, springs: bool) -> csr_matrix:
        """Minus Π's second derivative by the pressure [mm³/kPa], with or without the springs; one pattern for both."""
        parts = []
        for forms in self.problem.mixed_forms:
            rows, columns, values = forms.entries()[1]
            parts.append((rows, columns, -values))
        rows, columns, values = self._springs
        return self._matrix([*parts, (rows, columns, values / self.hardening if springs else 0.0 * values)])[self.used][
            :, self.used
        ]

    def softness(self) -> csr_matrix:
        """1/kappa [1/kPa] times the mass matrix [mm³] of the used pressures, before any hardening."""
        return self._spring[self.used][:, self.used]

    def coupling(self) -> csr_matrix:
        """Π's derivative by displacement and used pressures [mm²], shape (3n, used)."""
        rows, columns, values = _joined([forms.entries()[0] for forms in self.problem.mixed_forms])
        shape = 3 * len(self.problem.numbering.X), self.count
        return coo_matrix((values, (rows, columns)), shape=shape).tocsr()[:, self.used]

    def at(self, u: Floats) -> CondensedState:
        """The energy at a displacement [mm], shape (n, 3); infinite where the laws do not hold."""
        self.problem.at(u)
        p = np.array(self.centre)
        self.place(p)
        self._factors.factor(self.compliance(springs=True), symmetric=True)
        for _ in range(CORRECTIONS):
            self.place(p)
            away = (self.strain() - self.stretched(p))[self.used]
            if not np.isfinite(away).all():
                break
            correction = self._factors.solve(away)
            p[self.used] += correction
            if np.linalg.norm(correction) <= SETTLED * np.linalg.norm(p):
                break
        self.place(p)
        return CondensedState(self, self.problem.at(u), p)

    def beside(self, u: Floats, p: Floats) -> CondensedState:
        """The state at a displacement [mm] and a pressure [kPa] that need not be its maximiser."""
        self.place(p)
        return CondensedState(self, self.problem.at(u), p)

    def moved(self, state: CondensedState, step: Floats) -> CondensedState:
        """The energy after a step of all dofs [mm], shape (3n,)."""
        return self.at(state.u + step.reshape(state.u.shape))

    def stretched(self, p: Floats) -> Floats:
        """What the springs hold back [mm³], shape (n_p,): the volumes by which a minimiser is not the problem's own."""
        return self._spring @ (p - self.centre) / self.hardening

    def release(self):
        """Free the factors."""
        self._factors.release()


class CondensedState:
    """Energy, gradient and Hessian at one displacement `u` (n, 3) and pressure `p` (n_p,)."""

    def __init__(self, owner: Condensed, static: State, p: Floats):
        self._owner, self._static = owner, static
        self.u, self.p = static.u, p
        away = p - owner.centre
        energy = static.energy - 0.5 * float(away @ owner.stretched(p))
        self.energy = energy if np.isfinite(energy) else np.inf

    def gradient(self) -> Floats:
        """The energy's gradient [mN], shape (n, 3), held components included."""
        self._owner.place(self.p)
        return self._static.gradient()

    def strain(self) -> Floats:
        """Π's derivative by the pressure [mm³], shape (n_p,)."""
        self.gradient()  # which places the displacement
        return self._owner.strain()

    def hessian(self) -> PETSc.Mat:
        """Π's second derivative by the displacement [mN/mm]: the block that `Saddle` completes."""
        self._owner.place(self.p)
        return self._static.hessian()

    def softened_hessian(self, kept: float) -> PETSc.Mat:
        """The same with negative eigenvalues of points' tangents multiplied by `kept`."""
        self._owner.place(self.p)
        return self._static.softened_hessian(kept)


def _joined(parts: list[Entries]) -> Entries:
    rows, columns, values = (np.concatenate([part[i] for part in parts]) for i in range(3))
    return rows, columns, values
