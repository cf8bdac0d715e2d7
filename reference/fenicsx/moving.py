"""One implicit time step as a minimisation: the scene's energy and what inertia and damping add to it.

With d the displacement since the step's beginning the sum is E(u₀ + d) + d·A d / 2 - d·r: A is constant as long as the
time step is, and r is what mass, damper and the forces of the last step ask for. Sums over d, not over u, keep rounding
small where A is large. Of u₀ and r each process has what it owns.
"""

from __future__ import annotations

from ...lhm.mesh import Floats
from .dolfinx_version import PETSc
from .masses import times
from .problem import Problem, State
from .shared import dot


class MovingProblem:
    """A Problem with A (3n, 3n) added; `begin` sets u₀ [mm] and r [mN], vectors (owned, 3).

    `size` [mm] is the sum of the tets' sizes.
    """

    def __init__(self, problem: Problem, added: PETSc.Mat, size: float):
        self.problem, self.added, self.comm = problem, added, problem.comm
        # The energy that A gives to a displacement as large as those that problem's scale is made of.
        spread = float(added.getDiagonal().norm(PETSc.NormType.NORM_1)) / max(added.getSize()[0], 1)
        self._added_scale = spread * size

    def begin(self, u: Floats, r: Floats):
        """Where a step begins."""
        self.origin, self.r = u, r

    @property
    def energy_scale(self) -> float:
        """See Problem."""
        return self.problem.energy_scale + self._added_scale

    def at(self, u: Floats) -> MovingState:
        """The step at its end's displacement [mm], a field (n, 3)."""
        return MovingState(self, self.problem.at(u))

    def moved(self, state: MovingState, step: Floats) -> MovingState:
        """The step after a change of all dofs [mm], a vector (3 owned,)."""
        return self.at(state.u + self.problem.numbering.nodes.spread(step.reshape(-1, 3)))


class MovingState:
    """Energy, gradient and Hessian of a step; `static` is the scene's own part."""

    def __init__(self, owner: MovingProblem, static: State):
        self._owner, self.static, self.u = owner, static, static.u
        d = self.u[: len(owner.origin)] - owner.origin
        self._pull = times(owner.added, d)
        self.energy = static.energy + dot(owner.comm, d, 0.5 * self._pull - owner.r)

    def gradient(self) -> Floats:
        """The gradient [mN], a vector (owned, 3), held components included."""
        return self.static.gradient() + self._pull - self._owner.r

    def hessian(self) -> PETSc.Mat:
        """The exact Hessian [mN/mm], in the problem's matrix."""
        return self._with_added(self.static.hessian())

    def softened_hessian(self, kept: float) -> PETSc.Mat:
        """The Hessian with negative eigenvalues of the scene's part multiplied by `kept`."""
        return self._with_added(self.static.softened_hessian(kept))

    def _with_added(self, matrix: PETSc.Mat) -> PETSc.Mat:
        matrix.axpy(1.0, self._owner.added, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return matrix
