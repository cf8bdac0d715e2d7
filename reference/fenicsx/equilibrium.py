"""The equations of equilibrium of displacement and pressure at a share of the loads: residual and its derivative."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from ...lhm.mesh import Floats, Ints
from .follower import FollowerPressure
from .mixed_forms import matrix_entries
from .problem import Problem, State


@dataclass(frozen=True, eq=False)
class Point:
    """Displacement and pressure (3n + n_p,), their residual at a share of the loads, and the energy [µJ]."""

    z: Floats
    share: float
    residual: Floats
    energy: float
    state: State

    @property
    def finite(self) -> bool:
        """Whether the laws hold everywhere."""
        return bool(np.isfinite(self.energy) and np.isfinite(self.residual).all())


class Equilibrium:
    """Residual (3n + n_p,) and derivative of a problem's equations, forces [mN] first, then volumes [mm³].

    Dead loads and follower pressures are scaled by a share in [0, 1]; the derivative is symmetric without the latter.
    `held` are unknowns that keep their place, flat and sorted; `displacements` is 3n.
    """

    def __init__(self, problem: Problem, held: Ints, pressures: list[FollowerPressure]):
        self._problem, self._pressures = problem, pressures
        self._loads = problem.loads
        self.displacements = 3 * len(problem.numbering.X)
        self.count = self.displacements
        if problem.pressure is not None:
            idle = np.ones(len(problem.pressure.x.array), dtype=bool)
            for forms in problem.mixed_forms:
                idle[problem.pressure_dofs[forms.cells].ravel()] = False
            self.count += len(idle)
            held = np.concatenate([held, self.displacements + np.flatnonzero(idle)])
        self.held = held
        self.free = np.setdiff1d(np.arange(self.count), held)
        self.free_pressures = int((self.free >= self.displacements).sum())
        self.symmetric = None if pressures else True
        self._per_volume = 0.0

    def at(self, z: Floats, share: float) -> Point:
        """The equations at displacement and pressure z (3n + n_p,) and a share of the loads."""
        problem = self._problem
        self.place(z, share)
        state = problem.at(z[: self.displacements].reshape(-1, 3))
        residual = np.zeros(self.count)
        residual[: self.displacements] = state.gradient().ravel()
        forces = residual[: self.displacements].reshape(-1, 3)
        x = problem.numbering.X + state.u
        energy = state.energy
        for pressure in self._pressures:
            if share > 0.0:
                follower = np.zeros_like(forces)
                pressure.add_gradient(x, follower)
                forces += share * follower
                energy += share * pressure.energy(x)
        for forms in problem.mixed_forms:
            forms.add_by_pressure(residual[self.displacements :])
        return Point(z, share, residual, energy, state)

    def place(self, z: Floats, share: float):
        """Give the problem a share of the loads, and the pressure of z (3n + n_p,)."""
        self._problem.loads = share * self._loads
        if self._problem.pressure is not None:
            self._problem.pressure.x.array[:] = z[self.displacements :]

    def derivative(self, point: Point) -> csr_matrix:
        """The residual's derivative, shape (3n + n_p, 3n + n_p)."""
        self.place(point.z, point.share)
        m = self.displacements
        parts = [matrix_entries(point.state.hessian())]
        for forms in self._problem.mixed_forms:
            (rows, columns, values), (p_rows, p_columns, p_values) = forms.entries()
            parts += [(rows, m + columns, values), (m + columns, rows, values), (m + p_rows, m + p_columns, p_values)]
        x = self._problem.numbering.X + point.state.u
        for pressure in self._pressures:
            dofs = (3 * pressure.nodes[:, :, None] + np.arange(3)).reshape(len(pressure.nodes), -1)
            k = dofs.shape[1]
            blocks = point.share * pressure.tangent(x).transpose(0, 1, 3, 2, 4).reshape(-1)
            parts.append((np.repeat(dofs, k, axis=1).ravel(), np.tile(dofs, (1, k)).ravel(), blocks))
        rows, columns, values = (np.concatenate([part[i] for part in parts]) for i in range(3))
        return coo_matrix((values, (rows, columns)), shape=(self.count, self.count)).tocsr()

    def by_share(self, point: Point) -> Floats:
        """The residual's derivative by the share of the loads, shape (3n + n_p,)."""
        result = np.zeros(self.count)
        forces = result[: self.displacements].reshape(-1, 3)
        forces -= self._loads
        for pressure in self._pressures:
            pressure.add_gradient(self._problem.numbering.X + point.state.u, forces)
        return result

    def norm(self, free_residual: Floats) -> float:
        """The norm of the residual of the free unknowns [mN]; volumes count by the stiffness of `scale_volumes`."""
        forces = len(free_residual) - self.free_pressures
        return float(
            np.hypot(np.linalg.norm(free_residual[:forces]), self._per_volume * np.linalg.norm(free_residual[forces:]))
        )

    def scale_volumes(self, derivative: csr_matrix):
        """Measure volumes by the force that a mean node's displacement would cause [mN/mm³]."""
        if self.free_pressures:
            nodes = self._problem.numbering
            stiffness = derivative.diagonal()[: self.displacements].mean()
            size = np.cbrt(nodes.cell_volumes.mean())
            self._per_volume = float(stiffness / size**2)
