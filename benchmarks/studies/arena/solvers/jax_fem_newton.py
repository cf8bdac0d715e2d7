"""JAX-FEM: Newton on the neo-Hookean law by automatic differentiation, in float64 on the CPU.

Its first linear solver is stabilised biconjugate gradients under Jacobi's preconditioner; "direct" is scipy's. The
package has loads on surfaces and in volumes alone, so dead nodal forces are added where it assembles.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .protocol import ArenaProblem, Clock, SpentError

TITLE = "JAX-FEM"
PACKAGES = ("jax-fem==0.0.11", "jax==0.4.35", "jaxlib==0.4.34", "numpy==1.26.4", "gmsh", "meshio", "pyfiglet")
LAW = "neo-Hookean"
DTYPE = "float64"
TOLERANCE = 1e-4
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "iterative (default)": {"linear": "jax_solver"},
    "direct, 8 steps": {"linear": "umfpack_solver", "steps": 8},
    "direct": {"linear": "umfpack_solver"},
}


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """Solve in so many steps of load and motion."""
    import logging

    import jax

    jax.config.update("jax_enable_x64", True)
    from jax_fem import logger
    from jax_fem.generate_mesh import Mesh
    from jax_fem.solver import solver

    logger.setLevel(logging.ERROR)
    clock.end("imports")
    body, share = _make_body(problem, Mesh(problem.vertices, problem.tets, ele_type="TET4"), clock)
    clock.end("set-up")
    body.newton_update([problem.start - problem.vertices])
    clock.end("compilation")
    body.seen = 0
    steps, moved = settings.get("steps", 1), [problem.start - problem.vertices]
    order = np.argsort(problem.held)
    begin, goal = moved[0][problem.held[order]], (problem.places - problem.vertices[problem.held])[order]
    for step in range(steps):
        share[0] = (step + 1) / steps
        body.fes[0].vals_list = list(((1.0 - share[0]) * begin + share[0] * goal).T)
        how = {settings["linear"]: {}, "tol": 1e-8, "rel_tol": 1e-10, "initial_guess": moved}
        moved = solver(body, how)
    clock.see(problem.vertices + np.asarray(moved[0]), body.seen)


def _make_body(problem: ArenaProblem, mesh: Any, clock: Clock) -> tuple[Any, list[float]]:
    """The package's problem, and the share of the load, which may change."""
    import jax.numpy as jnp
    from jax_fem.problem import Problem

    mu, lmbda = problem.one_material()
    held = jnp.zeros(len(problem.vertices), dtype=bool).at[problem.held].set(True)
    share = [1.0]

    class Body(Problem):
        seen: int | None = None

        def get_tensor_map(self):
            def stress(slope):
                F = slope + jnp.eye(3)
                inverse = jnp.linalg.inv(F).T
                return mu * (F - inverse) + lmbda * jnp.log(jnp.linalg.det(F)) * inverse

            return stress

        def newton_update(self, moved):
            balance = super().newton_update(moved)
            if self.seen is not None:
                if not clock.see(problem.vertices + np.asarray(moved[0]), self.seen):
                    raise SpentError
                self.seen += 1
            return [balance[0] - share[0] * problem.forces]

    where = [[lambda point, number: held[number]] * 3, [0, 1, 2], [lambda point: 0.0] * 3]
    return Body(mesh, vec=3, dim=3, ele_type="TET4", dirichlet_bc_info=where), share
