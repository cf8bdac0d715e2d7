"""newton's SolverVBD: vertex block descent on Smith et al.'s energy without its logarithm, on warp's CPU kernels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from . import newton_model
from .protocol import ArenaProblem, Clock

TITLE = "Newton VBD"
PACKAGES, DTYPE, TAKES = newton_model.PACKAGES, newton_model.DTYPE, newton_model.TAKES
LAW = "stable neo-Hookean without logarithm"
TOLERANCE = 1.0
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "10 iterations, 5 substeps (default)": {"iterations": 10, "substeps": 5},
    "20 iterations, 1 substep": {"iterations": 20, "substeps": 1},
    "20 iterations, 20 substeps": {"iterations": 20, "substeps": 20},
}


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """March to rest; the package's moduli are Lamé's."""

    def make(newton, model):
        return newton.solvers.SolverVBD(
            model,
            iterations=settings["iterations"],
            particle_enable_self_contact=False,
            particle_enable_tile_solve=False,
        )

    newton_model.march(problem, settings, clock, moduli=lambda mu, lmbda: (mu, lmbda), make=make)
