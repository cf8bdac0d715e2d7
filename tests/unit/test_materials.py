"""Laws as parameters: moduli at rest, what they refuse, and which scenes and solvers take them."""

import numpy as np
import pytest

from softdeca.reference import Scene, SceneError, materials, terms
from softdeca.reference.materials import (
    Corotated,
    Guccione,
    Incompressible,
    IsochoricNeoHookean,
    MooneyRivlin,
    NeoHookean,
    StableNeoHookean,
    StVenantKirchhoff,
    tissues,
)

from .by_solver import prepare_by, solve_by

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
TETS = [[0, 1, 2, 3], [1, 2, 3, 4]]
FROM_YOUNG = [NeoHookean, StableNeoHookean, Corotated, StVenantKirchhoff, IsochoricNeoHookean]


@pytest.mark.parametrize("law", FROM_YOUNG)
def test_young_and_poisson_give_lame(law):
    """E = mu (3 lmbda + 2 mu) / (lmbda + mu) and nu = lmbda / (2 (lmbda + mu))."""
    mu, lmbda = law.from_young(15.0, 0.45).lame
    assert mu * (3 * lmbda + 2 * mu) / (lmbda + mu) == pytest.approx(15.0)
    assert lmbda / (2 * (lmbda + mu)) == pytest.approx(0.45)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: IsochoricNeoHookean(1.0, 1.0, "ln J"), r"volumetric must be 'kappa/2 \(J-1\)\^2' or .*, got 'ln J'"),
        (lambda: MooneyRivlin(0.0, 0.0, 1.0), "C10 \\+ C01 must be positive"),
        (lambda: Guccione(2.0, 8.0, 2.0, 4.0), r"Guccione: needs fibres of shape \(3,\) or \(m, 3\), got shape \(0,\)"),
        (lambda: Guccione(2.0, 8.0, 2.0, 4.0, [1.0, 0.0]), r"needs fibres .* got shape \(2,\)"),
        (lambda: Guccione(2.0, 8.0, 2.0, 4.0, [[1.0, 0, 0], [0, 0, 0]]), r"not zero \(number 1\)"),
        (lambda: Incompressible(Incompressible(NeoHookean(1.0, 1.0))), "got Incompressible"),
        (lambda: terms.Hyperelastic(MooneyRivlin(1.0, 0.5)), "MooneyRivlin without kappa must be made Incompressible"),
    ],
)
def test_parameters_out_of_range_are_named(make, message):
    with pytest.raises(SceneError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


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


@pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
def test_linear_tets_refuse_incompressible_laws_by_name(solver):
    scene = Scene(CORNERS, TETS, [terms.Hyperelastic(Incompressible(materials.NeoHookean(1.0, 1.0)))])
    with pytest.raises(SceneError, match=f"solver '{solver}' cannot model Incompressible"):
        prepare_by(solver, scene)
