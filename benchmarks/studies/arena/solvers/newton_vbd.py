"""newton's SolverVBD: vertex block descent on Smith et al.'s energy without its logarithm, on warp's CPU kernels.

The model is in metres, in float32. Coordinates are centred, since float32 resolves 1e-7 of one. Loads are forces on
particles, never the package's masses. Springs go to particles that stand still.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .protocol import ArenaProblem, Clock
from .rest import RAMP, KineticDamping, ramp

TITLE = "Newton VBD"
PACKAGES = ("newton==1.8.0", "warp-lang==1.19.0")
LAW = "stable neo-Hookean without logarithm"
DTYPE = "float32"
TOLERANCE = 1.0
TAKES = ("springs",)
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "10 iterations, 5 substeps (default)": {"iterations": 10, "substeps": 5},
    "20 iterations, 1 substep": {"iterations": 20, "substeps": 1},
    "20 iterations, 20 substeps": {"iterations": 20, "substeps": 20},
}
DENSITY = 1.04e-6
"""[kg/mm³]; it does not matter at rest."""
METRE = 1e-3
"""[m/mm]"""


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """March to rest until the budget is spent; the package's moduli are Lamé's."""
    import warp

    config: Any = warp.config
    config.quiet = True
    import newton

    clock.end("imports")
    centre = problem.vertices.mean(axis=0)
    masses = problem.nodal_volumes() * DENSITY
    model = _build(newton, warp, problem, centre, masses)
    solver = newton.solvers.SolverVBD(
        model,
        iterations=settings["iterations"],
        particle_enable_self_contact=False,
        particle_enable_tile_solve=False,
    )
    state, ahead, control = model.state(), model.state(), model.control()
    forces = np.zeros((model.particle_count, 3), dtype=np.float32)
    forces[: len(problem.vertices)] = problem.forces * METRE
    forces[problem.held] = 0.0
    clock.end("set-up")
    substeps = settings["substeps"]
    step_s = 1.0 / 60.0 / substeps
    solver.step(state, ahead, control, None, step_s)
    clock.end("compilation")
    state, ahead = model.state(), model.state()
    count, drawn = len(problem.vertices), np.flatnonzero(problem.springs)
    begin = np.concatenate([problem.start, problem.drawn_to[drawn]])
    for each in (state, ahead):
        each.particle_q.assign(((begin - centre) * METRE).astype(np.float32))
    moving = bool(problem.moves.any())
    rest, frame, going = KineticDamping(np.where(problem.free, masses, 0.0)), 0, True
    while going:
        if moving and frame < RAMP:
            share = ramp(frame, RAMP)
            positions = state.particle_q.numpy()
            positions[problem.held] = (problem.places - (1.0 - share) * problem.moves - centre) * METRE
            for each in (state, ahead):
                each.particle_q.assign(positions)
        for _ in range(substeps):
            state.particle_f.assign(forces)
            solver.step(state, ahead, control, None, step_s)
            state, ahead = ahead, state
            if rest.stops(state.particle_qd.numpy()[:count]):
                state.particle_qd.zero_()
        frame += 1
        going = clock.see(state.particle_q.numpy()[:count] / METRE + centre, frame * substeps)


def _build(newton, warp, problem: ArenaProblem, centre, masses):
    builder = newton.ModelBuilder(up_axis=newton.Axis.Z)
    builder.add_soft_mesh(
        pos=(0.0, 0.0, 0.0),
        rot=warp.quat_identity(),
        scale=1.0,
        vel=(0.0, 0.0, 0.0),
        vertices=[warp.vec3(*place) for place in (problem.vertices - centre) * METRE],
        indices=problem.tets.ravel().tolist(),
        density=DENSITY / METRE**3,
        k_mu=problem.mu / METRE,
        k_lambda=problem.lmbda / METRE,
        k_damp=0.0,
        add_surface_mesh_edges=False,
        particle_radius=0.0,
    )
    held = set(problem.held.tolist())
    builder.particle_mass = [0.0 if k in held else float(mass) for k, mass in enumerate(masses)]
    for k in np.flatnonzero(problem.springs):
        place = warp.vec3(*((problem.drawn_to[k] - centre) * METRE))
        anchor = builder.add_particle(pos=place, vel=(0.0, 0.0, 0.0), mass=0.0, radius=0.0)
        builder.add_spring(int(k), anchor, ke=float(problem.springs[k]), kd=0.0, control=0.0)  # mN/mm are N/m
        builder.spring_rest_length[-1] = 0.0
    builder.color()
    model = builder.finalize(device="cpu")
    model.set_gravity((0.0, 0.0, 0.0))
    return model
