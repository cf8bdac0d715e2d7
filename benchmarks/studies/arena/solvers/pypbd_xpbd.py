"""PyPBD: XPBD on St. Venant-Kirchhoff tets, in float64, which kinetic damping brings to rest.

Its bindings set neither gravity nor forces. So velocities before a step have what loads add and less what gravity adds,
and steps are not divided: one is as long as a substep of the package's defaults. Units are mm, kg and s, since it
leaves out tets of too few cubic metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .protocol import ArenaProblem, Clock
from .rest import RAMP, KineticDamping, ramp

TITLE = "PyPBD"
PACKAGES = ("pypbd==2.2.2",)
LAW = "St. Venant-Kirchhoff"
DTYPE = "float64"
TOLERANCE = float("inf")
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "1 iteration, 1 ms (default)": {"iterations": 1},
    "20 iterations, 1 ms": {"iterations": 20},
}
DENSITY = 1.04e-6
"""[kg/mm³]; it does not matter at rest."""
STEP_S, GRAVITY = 1e-3, np.array([0.0, -9.81, 0.0])
"""[s] and, in the units chosen here, [mm/s²]."""
FEM_BY_XPBD = 3
"""The package's number of that method."""


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """Step until the budget is spent."""
    import pypbd

    clock.end("imports")
    mu, lmbda = problem.one_material()
    young, poisson = mu * (3 * lmbda + 2 * mu) / (lmbda + mu), lmbda / (2 * (lmbda + mu))
    simulation = pypbd.Simulation.getCurrent()
    simulation.initDefault()
    model, stepper = simulation.getModel(), simulation.getTimeStep()
    model.addTetModel(list(problem.vertices), problem.tets.ravel().tolist())
    model.addSolidConstraints(model.getTetModels()[0], FEM_BY_XPBD, young, poisson, 1.0, False, False)
    pypbd.TimeManager.getCurrent().setTimeStepSize(STEP_S)
    stepper.setValueUInt(pypbd.TimeStepController.NUM_SUB_STEPS, 1)
    stepper.setValueUInt(pypbd.TimeStepController.MAX_ITERATIONS, settings["iterations"])
    particles, free = model.getParticles(), np.flatnonzero(problem.free)
    masses = problem.nodal_volumes() * DENSITY
    for k in range(len(masses)):
        particles.setMass(k, float(masses[k]) if problem.free[k] else 0.0)
        particles.setPosition(k, problem.start[k])
    kick = STEP_S * (problem.forces[free] / masses[free, None] - GRAVITY)
    moving = problem.held[problem.moves.any(axis=1)]
    goal, begin = np.array(problem.start), problem.start
    goal[problem.held] = problem.places
    rest = KineticDamping(masses[free])
    clock.end("set-up")
    x, velocities = np.array(problem.start), np.zeros((len(free), 3))
    step, going = 0, True
    while going:
        if step < RAMP:
            for k in moving:
                particles.setPosition(k, begin[k] + ramp(step, RAMP) * (goal[k] - begin[k]))
        for k, velocity in zip(free, velocities + kick, strict=True):
            particles.setVelocity(k, velocity)
        stepper.step(model)
        step += 1
        ahead = np.array(particles.getVertices(), dtype=np.float64).reshape(-1, 3)
        velocities = (ahead - x)[free] / STEP_S
        x = ahead
        if rest.stops(velocities):
            velocities = np.zeros(velocities.shape)
        going = clock.see(x, step)
