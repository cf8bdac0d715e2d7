"""Laws as parameters: moduli at rest, what they refuse, and which scenes and solvers take them."""

import numpy as np
import pytest

from softdeca.reference import Scene, terms
from softdeca.reference.materials import (
    Corotated,
    IsochoricNeoHookean,
    NeoHookean,
    StableNeoHookean,
    StVenantKirchhoff,
)

from .by_solver import solve_by

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
TETS = [[0, 1, 2, 3], [1, 2, 3, 4]]
FROM_YOUNG = [NeoHookean, StableNeoHookean, Corotated, StVenantKirchhoff, IsochoricNeoHookean]


@pytest.mark.parametrize("law", FROM_YOUNG)
def test_young_and_poisson_give_lame(law):
    """E = mu (3 lmbda + 2 mu) / (lmbda + mu) and nu = lmbda / (2 (lmbda + mu))."""
    mu, lmbda = law.from_young(15.0, 0.45).lame
    assert mu * (3 * lmbda + 2 * mu) / (lmbda + mu) == pytest.approx(15.0)
    assert lmbda / (2 * (lmbda + mu)) == pytest.approx(0.45)


@pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
def test_a_law_on_no_tets_changes_nothing(solver):
    law = terms.Hyperelastic(StableNeoHookean(1.0, 5.0))
    nowhere = terms.Hyperelastic(NeoHookean(2.5, 25.0), tets=[])
    scene = Scene(CORNERS, TETS, [law, nowhere, terms.Fixed([0, 1, 2])])
    solution = solve_by(solver, scene, start=1.1 * CORNERS, tolerance=1e-10)
    assert solution.positions == pytest.approx(CORNERS, abs=1e-9)
