"""Laws as parameters: moduli at rest, what they refuse, and which scenes and solvers take them."""

import numpy as np
import pytest

from softdeca.reference import Scene, SceneError, terms
from softdeca.reference.materials import (
    Corotated,
    Guccione,
    Incompressible,
    IsochoricNeoHookean,
    NeoHookean,
    StableNeoHookean,
    StVenantKirchhoff,
    tissues,
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


def test_fibres_are_unit_vectors_one_per_tet():
    law = Guccione(2.0, 8.0, 2.0, 4.0, [[2.0, 0, 0], [0, 3.0, 4.0]], kappa=10.0)
    assert law.fibres == pytest.approx(np.array([[1.0, 0, 0], [0, 0.6, 0.8]]))
    assert law == Guccione(2.0, 8.0, 2.0, 4.0, law.fibres, kappa=10.0)
    assert law != Guccione(2.0, 8.0, 2.0, 4.0, [1.0, 0, 0], kappa=10.0)
    Scene(CORNERS, TETS, [terms.Hyperelastic(law)])
    for material in (law, Incompressible(law)):
        with pytest.raises(SceneError, match="2 fibres for 1 tets"):
            Scene(CORNERS, TETS, [terms.Hyperelastic(material, tets=[0])])


@pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
def test_a_law_on_no_tets_changes_nothing(solver):
    law, nowhere = terms.Hyperelastic(StableNeoHookean(1.0, 5.0)), terms.Hyperelastic(tissues.FACE, tets=[])
    scene = Scene(CORNERS, TETS, [law, nowhere, terms.Fixed([0, 1, 2])])
    solution = solve_by(solver, scene, start=1.1 * CORNERS, tolerance=1e-10)
    assert solution.positions == pytest.approx(CORNERS, abs=1e-9)
