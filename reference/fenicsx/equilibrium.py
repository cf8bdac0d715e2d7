"""The equations of equilibrium of displacement and pressure at a share of the loads: residual and its derivative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from ...lhm.mesh import Floats, Ints
from .assembly import added_up, allocated
from .direct import csr_arrays
from .dolfinx_version import PETSc
from .follower import FollowerPressure
from .problem import Problem, State
from .shared import largest, norm
from .unknowns import Unknowns


@dataclass(frozen=True, eq=False)
class Point:
    """Displacement and pressure, a vector (see `unknowns`), their residual at a share of the loads, the energy [µJ].

    `finite` is whether the laws hold everywhere.
    """

    z: Floats
    share: float
    residual: Floats
    energy: float
    state: State
    finite: bool


class Equilibrium:
    """Residual and derivative of a problem's equations, vectors of forces [mN] first, then volumes [mm³].

    Dead loads and follower pressures are scaled by a share in [0, 1]; the derivative is symmetric without the latter.
    `held` are unknowns of this process that keep their place, flat and sorted; `displacements` are its forces.
    """

    def __init__(self, problem: Problem, held: Ints, pressures: list[FollowerPressure]):
        self._problem, self._pressures = problem, pressures
        self._loads = problem.loads
        self.unknowns, self.comm = Unknowns(problem), problem.comm
        self.displacements, self.count = self.unknowns.displacements, self.unknowns.count
        self.held = np.concatenate([held, self.unknowns.idle_pressures()])
        self.free = np.setdiff1d(np.arange(self.count), self.held)
        self.free_pressures = problem.comm.allreduce(int((self.free >= self.displacements).sum()))
        self.symmetric = None if pressures else True
        self._per_volume = 0.0
        self._matrix: PETSc.Mat | None = None

    def at(self, z: Floats, share: float) -> Point:
        """The equations at displacement and pressure z (count,) and a share of the loads."""
        problem = self._problem
        u = self.place(z, share)
        state = problem.at(u)
        forces, volumes = np.zeros_like(u), np.zeros(len(self.unknowns.of_pressures))
        energy = 0.0
        for pressure in self._pressures:
            if share > 0.0:
                pressure.add_gradient(problem.numbering.X + u, forces)
                energy += share * pressure.energy(problem.numbering.X + u)
        forces *= share
        for forms in problem.mixed_forms:
            forms.add_by_pressure(volumes)
        residual = self.unknowns.summed(forces, volumes)
        residual[: self.displacements] += state.gradient().ravel()
        total = state.energy + self.comm.allreduce(energy)
        return Point(z, share, residual, total, state, bool(np.isfinite(total + norm(self.comm, residual))))

    def place(self, z: Floats, share: float) -> Floats:
        """Give the problem a share of the loads, and the pressure of z (count,); its displacement, a field (n, 3)."""
        self._problem.loads = share * self._loads
        u, p = self.unknowns.field(z)
        if self._problem.pressure is not None:
            self._problem.pressure.x.array[:] = p
        return u

    def derivative(self, point: Point) -> PETSc.Mat:
        """The residual's derivative over all processes' unknowns; the next call makes it anew in the same matrix."""
        local = self._local(point)
        if self._matrix is None:
            if self.comm.size > 1:
                self._matrix = allocated(self.unknowns.shared, *csr_arrays(local)[:2])
            else:
                self._matrix = PETSc.Mat().createAIJ(local.shape, csr=csr_arrays(local), comm=self.comm)
            self._matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        if self.comm.size > 1:
            return added_up(self._matrix, *csr_arrays(local))
        self._matrix.setValuesCSR(*csr_arrays(local))
        self._matrix.assemble()
        return self._matrix

    def _local(self, point: Point) -> csr_matrix:
        """The part of this process' elements, over the unknowns that it knows of."""
        u = self.place(point.z, point.share)
        by_u, by_p = self.unknowns.of_displacements, self.unknowns.of_pressures
        point.state.hessian()
        rows, columns, values = self._problem.stiffness.entries()
        parts = [(by_u[rows], by_u[columns], values)]
        for forms in self._problem.mixed_forms:
            (rows, columns, values), (p_rows, p_columns, p_values) = forms.entries()
            rows, columns = by_u[rows], by_p[columns]
            parts += [(rows, columns, values), (columns, rows, values), (by_p[p_rows], by_p[p_columns], p_values)]
        for pressure in self._pressures:
            k = 3 * pressure.nodes.shape[1]
            dofs = by_u[(3 * pressure.nodes[:, :, None] + np.arange(3)).reshape(len(pressure.nodes), k)]
            tangent = point.share * pressure.tangent(self._problem.numbering.X + u)
            blocks = tangent.transpose(0, 1, 3, 2, 4).reshape(-1)
            parts.append((np.repeat(dofs, k, axis=1).ravel(), np.tile(dofs, (1, k)).ravel(), blocks))
        rows, columns, values = (np.concatenate([part[i] for part in parts]) for i in range(3))
        return coo_matrix((values, (rows, columns)), shape=(self.unknowns.shared.count,) * 2).tocsr()

    def by_share(self, point: Point) -> Floats:
        """The residual's derivative by the share of the loads, a vector."""
        forces = np.zeros_like(point.state.u)
        for pressure in self._pressures:
            pressure.add_gradient(self._problem.numbering.X + point.state.u, forces)
        result = self.unknowns.summed(forces, np.zeros(len(self.unknowns.of_pressures)))
        result[: self.displacements] -= self._loads.ravel()
        return result

    def irregular(self) -> Floats:
        """Displacements of no regularity, a vector, that depend on places alone and not on who owns them."""
        X = self._problem.numbering.X[: self.displacements // 3]
        waves = np.array([[3.1, -17.3, 29.9], [11.7, 23.3, -5.9], [-31.1, 7.7, 19.3]]) / largest(self.comm, X)
        return np.concatenate([np.sin(X @ waves).ravel(), np.zeros(self.count - self.displacements)])

    def norm(self, residual: Floats) -> float:
        """The norm of a residual, a vector [mN]; volumes count by the stiffness of `scale_volumes`."""
        weighted = np.array(residual)
        weighted[self.displacements :] *= self._per_volume
        return norm(self.comm, weighted)

    def scale_volumes(self, derivative: PETSc.Mat):
        """Measure volumes by the force that a mean node's displacement would cause [mN/mm³]."""
        if self.free_pressures:
            cells = self._problem.numbering.cell_volumes
            diagonal = derivative.getDiagonal().array_r[: self.displacements]
            sums = self.comm.allreduce(np.array([diagonal.sum(), len(diagonal), cells.sum(), len(cells)]))
            self._per_volume = float(sums[0] / sums[1] / np.cbrt(sums[2] / sums[3]) ** 2)
