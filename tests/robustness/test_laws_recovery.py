"""Hard starts of hyperelastic laws by Newton: those that hold for every F come back to rest, the others say no."""

import numpy as np
import pytest

from softdeca.reference import MissingDependencyError, Reason, Scene, materials, solve, terms
from softdeca.reference.problems import meshes

X, TETS = meshes.block(4)
BASE = X[:, 2] == 0
STABLE = materials.StableNeoHookean.from_young(10.0, 0.45)
COROTATED = materials.Corotated.from_young(10.0, 0.45)
SCALES = {"plane": [1.0, 1, 0], "line": [1.0, 0, 0], "mirror": [1.0, 1, -1], "pushed through": [1.0, 1, -0.3]}


def recover(law, start, solver):
    scene = Scene(X, TETS, [terms.Hyperelastic(law), terms.Fixed(BASE)])
    try:
        return solve(scene, solver=solver, start=np.where(BASE[:, None], X, start), tolerance=1e-10, max_iterations=300)
    except MissingDependencyError as missing:
        pytest.skip(str(missing))


@pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
@pytest.mark.parametrize("law", [STABLE, COROTATED], ids=lambda law: law.name)
@pytest.mark.parametrize("name", SCALES)
def test_a_collapsed_or_inverted_block_comes_back(name, law, solver):
    solution = recover(law, X * SCALES[name], solver)
    assert solution.converged, solution.reason
    assert np.abs(solution.positions - X).max() < 1e-6
    assert solution.volume_ratio.min() > 0.999


@pytest.mark.parametrize(("solver", "seed"), [("fenicsx", 0), ("fenicsx", 1), ("fenicsx", 2), ("skfem", 0)])
def test_a_corotated_block_comes_back_from_random_positions(solver, seed):
    """H1. A stable neo-Hookean block may stay in another minimum: its Hessian there is positive definite."""
    start = np.random.default_rng(seed).uniform(-1, 1, X.shape)
    solution = recover(COROTATED, start, solver)
    assert solution.converged, solution.reason
    assert np.abs(solution.positions - X).max() < 1e-6


@pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
@pytest.mark.parametrize(
    "law",
    [materials.NeoHookean(1.0, 5.0), materials.IsochoricNeoHookean(1.0, 5.0), materials.tissues.FACE],
    ids=lambda law: law.name,
)
def test_a_law_that_does_not_hold_under_inversion_says_so(law, solver):
    solution = recover(law, X * SCALES["mirror"], solver)
    assert solution.reason is Reason.NOT_FINITE
    assert np.isfinite(solution.positions).all()
