"""newton's SolverSemiImplicit: symplectic Euler on Smith et al.'s stable neo-Hookean energy, on warp's CPU kernels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from . import newton_model
from .protocol import ArenaProblem, Clock

TITLE = "Newton semi-implicit"
PACKAGES, DTYPE, TAKES = newton_model.PACKAGES, newton_model.DTYPE, newton_model.TAKES
LAW = "stable neo-Hookean"
TOLERANCE = 1.0
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "16 substeps (default)": {"substeps": 16},
    "128 substeps": {"substeps": 128},
}


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """March to rest; the package's moduli are 4/3 mu and lmbda + 5/6 mu of Lamé's (Smith et al. 2018, §3.4)."""

    def make(newton, model):
        return newton.solvers.SolverSemiImplicit(model, enable_tri_contact=False)

    newton_model.march(
        problem, settings, clock, moduli=lambda mu, lmbda: (4.0 / 3.0 * mu, lmbda + 5.0 / 6.0 * mu), make=make
    )
