"""The equations of equilibrium of displacement and, in a mixed problem, pressure: their residual and its derivative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ..dolfinx_version import PETSc
from ..linear.problem import DiscreteProblem, Evaluation
from ..linear.saddle import SaddleMatrix
from ..mesh.parallel import norm


@dataclass(frozen=True, eq=False)
class Point:
    """Displacement and pressure, a vector, their residual at a share of the loads, and the problem's state there.

    `finite` is whether the laws hold everywhere.
    """

    z: Floats
    residual: Floats
    state: Evaluation
    finite: bool

    @property
    def share(self) -> float:
        """The share of the loads."""
        return self.state.share


class Equilibrium:
    """Residual and derivative of a problem's equations, vectors of forces [mN] first, then volumes [mm³].

    Dead loads and follower pressures are scaled by a share in [0, 1]; the derivative is symmetric without the latter.
    `held` are displacements of this process that keep their place, flat and sorted, and the pressures that no law has.
    A mixed problem may lend its `saddle` matrix.
    """

    def __init__(self, problem: DiscreteProblem, held: Ints, saddle: SaddleMatrix | None = None):
        self._problem, self.comm, self.symmetric = problem, problem.comm, problem.symmetric
        self.displacements = 3 * problem.numbering.nodes.owned
        self.count = self.displacements + problem.pressures.owned
        self.held = np.concatenate([held, self.displacements + problem.idle_pressures()])
        self._per_volume = 0.0
        self._saddle = SaddleMatrix(problem) if saddle is None and problem.mixed else saddle

    def at(self, z: Floats, share: float) -> Point:
        """The equations at displacement and pressure z (count,) and a share of the loads."""
        state = self._problem.at(*self.fields(z), share)
        residual = np.concatenate([state.gradient().ravel(), state.strain()])
        return Point(z, residual, state, bool(np.isfinite(state.energy + norm(self.comm, residual))))

    def vector(self, u: Floats, p: Floats | None) -> Floats:
        """The vector of a displacement, a field, and a pressure, a field or a vector, or none."""
        m, count = self.displacements, self.count
        return np.concatenate([u.ravel()[:m], np.zeros(count - m) if p is None else p[: count - m]])

    def fields(self, z: Floats) -> tuple[Floats, Floats]:
        """The displacement (n, 3) and the pressure (n_p,) of a vector z (count,), as fields."""
        problem, m = self._problem, self.displacements
        return problem.numbering.nodes.spread(z[:m].reshape(-1, 3)), problem.pressures.spread(z[m:])

    def derivative(self, point: Point) -> PETSc.Mat:
        """The residual's derivative; the next call makes it anew in the same matrix."""
        hessian = point.state.hessian()
        if self._saddle is None:
            return hessian
        self._saddle.assemble(point.state, springs=False)
        return self._saddle.whole()

    def norm(self, residual: Floats) -> float:
        """The norm of a residual, a vector [mN]; volumes count by the stiffness of `scale_volumes`."""
        weighted = np.array(residual)
        weighted[self.displacements :] *= self._per_volume
        return norm(self.comm, weighted)

    def scale_volumes(self, derivative: PETSc.Mat):
        """Measure volumes by the force that a mean node's displacement would cause [mN/mm³]."""
        if self._problem.mixed:
            self._per_volume = self._problem.force_per_volume(derivative.getDiagonal().array_r[: self.displacements])
