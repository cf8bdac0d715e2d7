"""The strategy "continuation": the equations of equilibrium, along the path on which load and motion grow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...lhm.mesh import Floats
from ..restraint import drifts
from ..solution import Reason
from .equilibrium import Equilibrium, Point
from .load_path import LoadPath
from .problem import Problem
from .run import Attempt, Run

MAX_ITERATIONS = 1000

Descent = Callable[[Floats, Floats, float], tuple[Floats, Floats, Reason, int]]
"""Minimises a problem's energy at a share of its loads from displacement, a field (n, 3), and pressure, a vector, to
both; why it stopped; iterations."""


class Balance:
    """A run's load path on a problem; `descent` is asked where a part of the body may have snapped."""

    def __init__(self, run: Run, problem: Problem, descent: Descent | None = None):
        self._run, self._problem, self._descent = run, problem, descent
        scene, numbering = run.scene, run.numbering
        held = (run.held | problem.unsupported[:, None])[: numbering.nodes.owned]
        self._equations = Equilibrium(problem, np.flatnonzero(held))
        self._assemblies = problem.assemblies
        self._path = LoadPath(
            self._equations,
            self._unknowns(run.u),
            self._unknowns(run.goal),
            run.threshold,
            self._report,
            run.record.left(MAX_ITERATIONS),
            drifts=drifts(scene),
            descend=None if descent is None else self._descend,
        )

    def _unknowns(self, u: Floats) -> Floats:
        z = np.zeros(self._equations.count)
        z[: self._equations.displacements] = u.ravel()[: self._equations.displacements]
        return z

    def _report(self, point: Point, norm: float) -> bool:
        return self._run.tell(point.state.u, point.state.energy, norm)

    def _descend(self, z: Floats, share: float) -> tuple[Floats, Reason, int]:
        assert self._descent is not None
        m = self._equations.displacements
        u, p, reason, made = self._descent(self._equations.fields(z)[0], z[m:], share)
        return np.concatenate([u.ravel()[:m], p]), reason, made

    def attempt(self) -> Attempt:
        """Follow the load path to its end."""
        point, reason = self._path.run()
        record = self._run.record
        record.add(
            self._path.iterations,
            linear_solves=self._path.factored,
            assemblies=self._problem.assemblies - self._assemblies,
        )
        record.detail["load_share"] = self._path.share  # type: ignore[assignment]
        pressure = point.state.p if self._problem.mixed else None
        return Attempt(reason, self._run.numbering, point.state.u, pressure, point.state.energy)
