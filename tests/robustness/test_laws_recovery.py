"""Hard starts of laws that no hard case poses: those that hold for every F come back to rest, the others say no.

Every law on FEniCSx and the corotated one on scikit-fem are in `problems.HARD` and `problems.LAWS_ON_ELEMENTS`.
"""

import numpy as np
import pytest

from softdeca.reference import MissingDependencyError, Reason, Scene, materials, solve, terms
from softdeca.reference.problems import meshes

X, TETS = meshes.block(4)
BASE = X[:, 2] == 0
STABLE = materials.StableNeoHookean.from_young(10.0, 0.45)
SCALES = {"plane": [1.0, 1, 0], "line": [1.0, 0, 0], "mirror": [1.0, 1, -1], "pushed through": [1.0, 1, -0.3]}


def recover(law, start, solver):
    scene = Scene(X, TETS, [terms.Hyperelastic(law), terms.Fixed(BASE)])
    try:
        return solve(scene, solver=solver, start=np.where(BASE[:, None], X, start), tolerance=1e-10, max_iterations=300)
    except MissingDependencyError as missing:
        pytest.skip(str(missing))


@pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
@pytest.mark.parametrize("name", SCALES)
def test_a_collapsed_or_inverted_block_of_the_stable_law_comes_back(name, solver):
    solution = recover(STABLE, X * SCALES[name], solver)
    assert solution.converged, solution.reason
    assert np.abs(solution.positions - X).max() < 1e-6
    assert solution.volume_ratio.min() > 0.999


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
