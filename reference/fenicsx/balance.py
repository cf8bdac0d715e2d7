"""A solve by the equations of equilibrium: for mixed elements, follower pressure, and where descent gave up."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...lhm.mesh import Floats
from ..restraint import drifts
from ..scene import Scene
from ..solution import OnIteration, Reason, Recorder, Solution, stop_threshold, volume_ratio
from ..terms import Pressure
from .equilibrium import Equilibrium, Point
from .follower import FollowerPressure
from .load_path import LoadPath
from .numbering import Numbering
from .problem import Problem

MAX_ITERATIONS = 1000

Descent = Callable[[Floats, Floats], tuple[Floats, Floats, Reason, int]]
"""Minimises a problem's energy from displacement (n, 3) and pressure (n_p,) to both; why it stopped; iterations."""


class Balance:
    """A scene's load path on a problem, from start [mm], shape (scene vertices, 3).

    `descent` is asked where a part of the body may have snapped.
    """

    def __init__(
        self,
        scene: Scene,
        numbering: Numbering,
        problem: Problem,
        start: Floats,
        tolerance: float,
        max_iterations: int | None,
        on_iteration: OnIteration | None,
        descent: Descent | None = None,
    ):
        self._scene, self._numbering, self._problem = scene, numbering, problem
        self._descent = descent
        held, positions = scene.dirichlet()
        self._held, self._values = held, positions
        self._elsewhere = np.where(held, positions, start)
        nodes = numbering.held(held)
        u = numbering.to_dofs(start) - numbering.X
        goal = np.where(nodes, numbering.to_dofs(positions) - numbering.X, u)
        pressures = [
            FollowerPressure.of(term, numbering.face_dofs(term.name, term.triangles)) for term in scene.of(Pressure)
        ]
        self._equations = Equilibrium(problem, np.flatnonzero(nodes | problem.unsupported[:, None]), pressures)
        self._recorder = Recorder(on_iteration)
        self._assemblies = problem.assemblies
        self._path = LoadPath(
            self._equations,
            self._unknowns(u),
            self._unknowns(goal),
            lambda first: stop_threshold(scene, first, tolerance),
            self._report,
            MAX_ITERATIONS if max_iterations is None else max_iterations,
            drifts=drifts(scene),
            descend=None if descent is None or pressures else self._descend,
        )

    def _unknowns(self, u: Floats) -> Floats:
        z = np.zeros(self._equations.count)
        z[: u.size] = u.ravel()
        return z

    def _positions(self, point: Point) -> Floats:
        return self._numbering.to_scene(self._numbering.X + point.state.u, self._elsewhere)

    def _report(self, point: Point, norm: float) -> bool:
        return self._recorder.record(self._positions(point), point.energy, norm)

    def _descend(self, z: Floats, share: float) -> tuple[Floats, Reason, int]:
        assert self._descent is not None
        m = self._equations.displacements
        self._equations.place(z, share)
        u, p, reason, made = self._descent(z[:m].reshape(-1, 3), z[m:])
        return np.concatenate([u.ravel(), p]), reason, made

    def stable(self, u: Floats) -> bool:
        """Whether the tangent at a displacement of the nodes [mm], shape (n, 3), is positive definite."""
        return self._path.stable_at(self._unknowns(u))

    def run(self) -> Solution:
        """Follow the load path to its end."""
        point, reason = self._path.run()
        self._equations.place(point.z, 1.0)  # the path leaves the share that it ended with
        positions = self._positions(point)
        m = self._equations.displacements
        self.end = point.state.u, point.z[m:] if len(point.z) > m else None
        if reason is Reason.CONVERGED:
            positions[self._held] = self._values[self._held]
        detail: dict[str, float] = {
            "linear_solves": self._path.factored,
            "assemblies": self._problem.assemblies - self._assemblies,
            "load_share": self._path.share,
        }
        return Solution(
            positions,
            reason,
            self._path.iterations,
            point.energy,
            self._recorder.history(),
            volume_ratio(self._scene, positions),
            detail,
        )
