"""newton's SolverXPBD: constraints I1 = 3 and J = 1 with compliances, an energy without shear stiffness at rest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from . import newton_model
from .protocol import ArenaProblem, Clock

TITLE = "Newton XPBD"
PACKAGES, DTYPE, TAKES = newton_model.PACKAGES, newton_model.DTYPE, newton_model.TAKES
LAW = ""
TOLERANCE = float("inf")
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "10 iterations, 5 substeps (default)": {"iterations": 10, "substeps": 5},
    "20 iterations, relaxation 0.05": {"iterations": 20, "substeps": 5, "relaxation": 0.05},
}


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """March to rest; the package's moduli are taken as Lamé's, which they are not."""

    def make(newton, model):
        relaxation = settings.get("relaxation", 0.9)
        return newton.solvers.SolverXPBD(model, iterations=settings["iterations"], soft_body_relaxation=relaxation)

    if not problem.lmbda.all():
        problem.refuse("it leaves out tets without k_lambda, as of Poisson's ratio 0")
    newton_model.march(problem, settings, clock, moduli=lambda mu, lmbda: (mu, lmbda), make=make)
