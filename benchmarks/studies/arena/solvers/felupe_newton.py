"""FElupe: Newton on the neo-Hookean law, with a sparse direct solver or with conjugate gradients under pyamg's AMG."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .protocol import ArenaProblem, Clock, Floats, SpentError

TITLE = "FElupe"
PACKAGES = ("felupe==11.3.0", "pyamg==5.4.1")
LAW = "neo-Hookean"
DTYPE = "float64"
TOLERANCE = 1e-4
TAKES = ("springs",)
SETTINGS: Mapping[str, Mapping[str, Any]] = {
    "direct (default)": {"linear": "direct"},
    "pyamg": {"linear": "amg"},
    "pyamg, 4 steps": {"linear": "amg", "steps": 4},
}


def run(problem: ArenaProblem, settings: Mapping[str, Any], clock: Clock) -> None:
    """Solve in so many steps of load and motion."""
    import felupe
    import pyamg
    from scipy.sparse.linalg import cg, spsolve

    clock.end("imports")
    steps = settings.get("steps", 1)
    X = problem.vertices
    field = felupe.FieldContainer([felupe.Field(felupe.RegionTetra(felupe.Mesh(X, problem.tets, "tetra")), dim=3)])
    field[0].values[:] = problem.start - X
    # Moduli per tet fail beyond 8,192 tets, which the package takes chunk by chunk.
    mu, lmbda = problem.one_material() if problem.is_uniform else (problem.mu, problem.lmbda)
    solid = felupe.SolidBody(felupe.NeoHookeCompressible(mu=mu, lmbda=lmbda), field)
    dead = felupe.PointLoad(field, np.arange(len(X)), values=problem.forces)
    items = [solid, dead, *([_make_springs(felupe, field, problem)] if problem.springs.any() else [])]
    fixed = np.zeros(X.shape, dtype=bool)
    fixed[problem.held] = True
    held, free = np.flatnonzero(fixed.ravel()), np.flatnonzero(~fixed.ravel())
    begin, goal = problem.start - X, np.zeros(X.shape)
    goal[problem.held] = problem.places - X[problem.held]
    modes = _rigid_motions(X)[free]
    solves = 0

    def solve_linear(matrix, right):
        nonlocal solves
        solves += 1
        if settings["linear"] == "direct":
            return spsolve(matrix, right)
        levels = pyamg.smoothed_aggregation_solver(matrix.tocsr(), B=modes, max_coarse=500)
        return cg(matrix, right, rtol=1e-6, M=levels.aspreconditioner(), maxiter=500)[0]

    def see(dx, x, iteration, xnorm, fnorm, success):
        if not clock.see(X + field[0].values, solves):
            raise SpentError

    clock.end("set-up")
    clock.see(X + field[0].values, 0)
    for step in range(steps):
        share = (step + 1) / steps
        dead.update(problem.forces * share)
        felupe.newtonrhapson(
            items=items,
            dof0=held,
            dof1=free,
            ext0=((1 - share) * begin + share * goal).ravel()[held],
            solver=solve_linear,
            tol=1e-9,
            maxiter=30,
            verbose=0,
            callback=see,
        )
    clock.see(X + field[0].values, solves)


def _make_springs(felupe: Any, field: Any, problem: ArenaProblem) -> Any:
    """Make an item of the package's protocol, since its own springs have one stiffness for all."""
    from scipy.sparse import csr_matrix, diags

    class Springs:
        stiffness = np.repeat(problem.springs, 3)
        goal = problem.drawn_to - problem.vertices

        def __init__(self):
            self.field, self.results = field, felupe.mechanics.Results(stress=False, elasticity=False)
            self.assemble = felupe.mechanics.Assemble(vector=self.pull, matrix=self.give_matrix)

        def pull(self, field=None, parallel=False):
            force = self.stiffness * (self.field[0].values - self.goal).ravel()
            return csr_matrix(force[:, None])

        def give_matrix(self, field=None, parallel=False):
            return diags(self.stiffness).tocsr()

    return Springs()


def _rigid_motions(X: Floats) -> Floats:
    """The six small rigid motions of vertices (n, 3), shape (3 n, 6)."""
    modes = np.zeros((len(X), 3, 6))
    x, y, z = (X - X.mean(axis=0)).T
    modes[:, range(3), range(3)] = 1.0
    modes[:, 1, 3], modes[:, 2, 3] = -z, y
    modes[:, 0, 4], modes[:, 2, 4] = z, -x
    modes[:, 0, 5], modes[:, 1, 5] = -y, x
    return modes.reshape(-1, 6)
