"""sfepy: Newton on its neo-Hookean term, which is isochoric, and its bulk penalty; it stops at its first warped tet."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .protocol import ArenaProblem, Clock, SpentError

TITLE = "sfepy"
PACKAGES = ("sfepy==2026.3", "numpy==1.26.4")
LAW = "isochoric neo-Hookean"
DTYPE = "float64"
TOLERANCE = 1e-4
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "1 step (default)": {"steps": 1},
    "8 steps": {"steps": 8},
}


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """Solve in so many steps of the motion, under the whole load, by a sparse direct solver."""
    from sfepy.base.base import output
    from sfepy.discrete import Problem
    from sfepy.solvers.ls import ScipyDirect
    from sfepy.solvers.nls import Newton

    output.set_output(quiet=True)
    clock.end("imports")
    if not problem.starts_at_rest:
        problem.refuse("its adapter starts from rest alone")
    X, share, count = problem.vertices, [0.0], 0
    equations, conditions = _build(problem, share)
    task = Problem("arena", equations=equations)
    task.set_bcs(ebcs=conditions)

    def see(context, solver, unknowns, iteration, error, first):
        nonlocal count
        count += 1
        moved = equations.variables.make_full_vec(unknowns).reshape(-1, 3)
        if not clock.see(X + moved, count):
            raise SpentError

    task.nls_iter_hook = see
    how = {"i_max": 30, "eps_a": 1e-9, "eps_r": 1e-10, "eps_mode": "or"}
    task.set_solver(Newton(how, lin_solver=ScipyDirect({})))
    clock.end("set-up")
    state: Any = None
    for step in range(settings["steps"]):
        share[0] = (step + 1) / settings["steps"]
        state = task.solve(state0=state, save_results=False)()
    clock.see(X + np.reshape(state, (-1, 3)), count)


def _build(problem: ArenaProblem, share: list[float]):
    """The package's equations, and its held vertices, at a share of their motion that may change."""
    from sfepy.discrete import Equation, Equations, FieldVariable, Function, Functions, Integral, Material
    from sfepy.discrete.conditions import Conditions, EssentialBC
    from sfepy.discrete.fem import FEDomain, Field, Mesh
    from sfepy.terms import Term

    mu, lmbda = problem.one_material()
    X, tets = problem.vertices, problem.tets.astype(np.int32)
    domain = FEDomain("arena", Mesh.from_data("arena", X, None, [tets], [np.zeros(len(tets), np.int32)], ["3_4"]))
    everywhere, nodes = domain.create_region("All", "all"), domain.create_region("Nodes", "all", "vertex")
    order = np.argsort(problem.held)
    choose = Functions([Function("held", lambda places, domain=None: problem.held[order])])
    held = domain.create_region("Held", "vertices by held", "vertex", functions=choose)
    field = Field.from_args("u", np.float64, "vector", everywhere, approx_order=1)
    u = FieldVariable("u", "unknown", field)
    v = FieldVariable("v", "test", field, primary_var_name="u")
    solid = Material("solid", values={"mu": mu, "K": lmbda + 2.0 / 3.0 * mu})
    load = Material("load", values={".val": problem.forces})
    inside, point = Integral("i", order=1), Integral("p", order=0)
    terms = [
        Term.new("dw_tl_he_neohook(solid.mu, v, u)", inside, everywhere, solid=solid, v=v, u=u),
        Term.new("dw_tl_bulk_penalty(solid.K, v, u)", inside, everywhere, solid=solid, v=v, u=u),
        Term.new("dw_point_load(load.val, v)", point, nodes, load=load, v=v),
    ]
    moves = (problem.places - X[problem.held])[order]
    go = Function("go", lambda ts, places, bc=None, problem=None, **more: share[0] * moves)
    return Equations([Equation("balance", terms[0] + terms[1] - terms[2])]), Conditions(
        [EssentialBC("held", held, {"u.all": go})]
    )
