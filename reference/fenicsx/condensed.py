"""A mixed problem's energy of the displacement alone: the pressure is the one that maximises it, held back by a spring.

With Π(u, p) of `mixed_densities`, E(u) = max over p of Π(u, p) - (p - p₀)² / (2 kappa): for J = 1 the augmented
Lagrangian of Hestenes and Powell with multiplier p₀ (Bertsekas 1982, "Constrained Optimization and Lagrange Multiplier
Methods", Chapter 2), for other laws their own energy with a bulk modulus cut down to what Newton's method can follow.
E's minimiser is the problem's own once p₀ is its pressure, whatever kappa.
"""

from __future__ import annotations

import numpy as np

from ...lhm.mesh import Floats
from .dolfinx_version import PETSc
from .linear import product
from .problem import Problem, State
from .saddle import PENALTY, PressureSolver, SaddleMatrix
from .shared import dot, norm

SETTLED = 1e-10  # of the pressure's norm, below which a correction is rounding or of no account
CORRECTIONS = 30


class Condensed:
    """Energy, gradient and Hessian of E over the displacement's dofs, as `Newton` asks for them.

    `centre` is p₀ [kPa], a vector (n_p,), and `matrix` the saddle point's, whose springs are kappa's.
    """

    def __init__(self, problem: Problem):
        self.problem, self.comm, self.matrix = problem, problem.comm, SaddleMatrix(problem)
        self.centre: Floats = np.zeros(self.matrix.pressures)
        self._pressures = PressureSolver(self.matrix)

    @property
    def energy_scale(self) -> float:
        """See Problem."""
        return self.problem.energy_scale

    def begin(self, centre: Floats | None):
        """Begin with the first kappa and, if given, another p₀ [kPa], a vector."""
        self.matrix.springs = 1.0 / PENALTY
        if centre is not None:
            self.centre = np.array(centre)

    def harden(self, times: float):
        """Multiply kappa."""
        self.matrix.springs /= times

    def at(self, u: Floats, share: float = 1.0) -> CondensedState:
        """The energy at a displacement [mm], a field (n, 3), and a share of loads; infinite where a law has none."""
        p = np.array(self.centre)
        static = self._placed(u, p, share)
        self.matrix.assemble(static, springs=True)
        self._pressures.take(self.matrix.D)
        for _ in range(CORRECTIONS):
            away = static.strain() - self.stretched(p)
            if not np.isfinite(norm(self.comm, away)):
                break
            correction = self._pressures.solve(away)
            p = p + correction
            static = self._placed(u, p, share)
            if not norm(self.comm, correction) > SETTLED * norm(self.comm, p):
                break
        return CondensedState(self, static, p, springs=True)

    def beside(self, u: Floats, p: Floats, share: float = 1.0) -> CondensedState:
        """The problem itself, without springs, at a displacement, a field, and a pressure [kPa], a vector: p₀ anew."""
        self.centre = np.array(p)
        return CondensedState(self, self._placed(u, p, share), p, springs=False)

    def moved(self, state: CondensedState, step: Floats) -> CondensedState:
        """The energy after a step of all dofs [mm], a vector (3 owned,)."""
        return self.at(state.u + self.problem.numbering.nodes.spread(step.reshape(-1, 3)), state.share)

    def stretched(self, p: Floats) -> Floats:
        """What the springs hold back [mm³], a vector: the volumes by which a minimiser is not the problem's own."""
        return self.matrix.springs * product(self.matrix.mass, p - self.centre)

    def _placed(self, u: Floats, p: Floats, share: float) -> State:
        return self.problem.at(u, self.problem.pressures.spread(p), share)


class CondensedState:
    """Energy, gradient and Hessian at one displacement `u`, a field (n, 3), and pressure `p`, a vector (n_p,)."""

    def __init__(self, owner: Condensed, static: State, p: Floats, *, springs: bool):
        self._owner, self._static, self._springs = owner, static, springs
        self.u, self.p, self.share = static.u, p, static.share
        self.energy = static.energy
        if springs:
            self.energy -= 0.5 * dot(owner.comm, p - owner.centre, owner.stretched(p))
        self.energy = self.energy if np.isfinite(self.energy) else np.inf

    def gradient(self) -> Floats:
        """The energy's gradient [mN], a vector (owned, 3), held components included."""
        return self._static.gradient()

    def strain(self) -> Floats:
        """Π's derivative by the pressure [mm³], a vector (n_p,)."""
        return self._static.strain()

    def hessian(self) -> PETSc.Mat:
        """Π's second derivative by the displacement [mN/mm], and all blocks of the owner's matrix."""
        self._owner.matrix.assemble(self._static, springs=self._springs)
        return self._static.hessian()

    def softened_hessian(self, kept: float) -> PETSc.Mat:
        """The same with negative eigenvalues of points' tangents multiplied by `kept`."""
        self._owner.matrix.assemble(self._static, springs=self._springs)
        return self._static.softened_hessian(kept)
