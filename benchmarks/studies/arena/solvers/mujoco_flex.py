"""MuJoCo's flex, St. Venant-Kirchhoff in float64: dynamics that kinetic damping brings to rest.

Held vertices that stay belong to the world. Those that move belong to a heavy body per motion, which is put in place
before each step. Loads are forces on the bodies of free vertices, springs those of their joints. Masses are a tissue's
and do not matter at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .protocol import ArenaProblem, Clock
from .rest import RAMP, KineticDamping, ramp

TITLE = "MuJoCo flex"
PACKAGES = ("mujoco==4.0.0",)
LAW = "St. Venant-Kirchhoff"
DTYPE = "float64"
TOLERANCE = 0.01
TAKES = ("springs",)
SETTINGS: Mapping[str, Mapping[str, Any]] = {"2 ms (default)": {"step_s": 0.002}, "20 ms": {"step_s": 0.02}}
DENSITY = 1.04e-6
"""[kg/mm³]"""
METRE = 1e-3
"""[m/mm]"""
AXES = ("1 0 0", "0 1 0", "0 0 1")


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """Step until the budget is spent."""
    import mujoco

    clock.end("imports")
    centre = problem.vertices.mean(axis=0)
    motions, group = np.unique((problem.places - problem.vertices[problem.held]) * METRE, axis=0, return_inverse=True)
    pushed = np.flatnonzero(motions.any(axis=1))
    masses = problem.nodal_volumes() * DENSITY
    model = mujoco.MjModel.from_xml_string(_write(problem, settings, centre, masses, motions, group.ravel(), pushed))
    data = mujoco.MjData(model)
    free, heavy = problem.free, 3 * len(pushed)
    bodies = model.flex_vertbodyid
    data.xfrc_applied[bodies[free], :3] = problem.forces[free] * METRE
    data.qpos[heavy:] = ((problem.start - problem.vertices)[free] * METRE).ravel()
    steps = RAMP if problem.starts_at_rest else 1
    rest = KineticDamping(masses[free])
    clock.end("set-up")
    step, going = 0, True
    while going:
        for _ in range(2):
            data.qpos[:heavy] = (motions[pushed] * ramp(step, steps)).ravel()
            data.qvel[:heavy] = 0.0
            mujoco.mj_step(model, data)
            step += 1
            if rest.stops(data.qvel[heavy:].reshape(-1, 3)):
                data.qvel[:] = 0.0
        data.qpos[:heavy] = (motions[pushed] * ramp(step - 1, steps)).ravel()
        mujoco.mj_kinematics(model, data)
        mujoco.mj_flex(model, data)
        going = clock.see(data.flexvert_xpos / METRE + centre, step)


def _write(problem, settings, centre, masses, motions, group, pushed) -> str:
    """The model as MuJoCo's XML."""
    mu, lmbda = problem.one_material()
    young, poisson = mu * (3 * lmbda + 2 * mu) / (lmbda + mu) / METRE, lmbda / (2 * (lmbda + mu))
    places, free = (problem.vertices - centre) * METRE, problem.free
    slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in AXES)
    owner = np.array([f"v{k}" for k in range(len(places))], dtype=object)
    owner[problem.held] = [f"held{k}" if motions[k].any() else "world" for k in group]
    heavy = '<inertial pos="0 0 0" mass="1e6" diaginertia="1 1 1"/>'
    bodies = "".join(f'<body name="held{k}">{heavy}{slides}</body>' for k in pushed)
    bodies += "".join(
        f'<body name="v{k}" pos="{_numbers(places[k])}"><inertial pos="0 0 0" mass="{masses[k]:.9g}" '
        f'diaginertia="1e-12 1e-12 1e-12"/>{_spring(problem, k) if problem.springs[k] else slides}</body>'
        for k in np.flatnonzero(free)
    )
    own = np.where(free[:, None], 0.0, places)
    return (
        f'<mujoco><option gravity="0 0 0" timestep="{settings["step_s"]}" integrator="discrete">'
        '<flag contact="disable"/></option><size memory="4G"/>'
        f'<worldbody>{bodies}</worldbody><deformable><flex name="flesh" dim="3" radius="0.0001" '
        f'body="{" ".join(owner)}" vertex="{_numbers(own)}" element="{" ".join(map(str, problem.tets.ravel()))}">'
        f'<contact selfcollide="none"/><elasticity young="{young}" poisson="{poisson}" damping="0"/></flex>'
        "</deformable></mujoco>"
    )


def _spring(problem, k: int) -> str:
    """The joints of a vertex by what it is drawn to; mN/mm are N/m."""
    away = (problem.drawn_to[k] - problem.vertices[k]) * METRE
    return "".join(
        f'<joint type="slide" axis="{axis}" stiffness="{problem.springs[k]:.12g}" springref="{goal:.12g}"/>'
        for axis, goal in zip(AXES, away, strict=True)
    )


def _numbers(values) -> str:
    return " ".join(f"{value:.12g}" for value in np.ravel(values))
