"""Grown tissue, F growth^(-1/3): free growth in closed form, graded growth by all solvers, and what is refused."""

import pytest

from softdeca.reference import Scene, materials, terms
from softdeca.reference.problems import meshes
from softdeca.reference.problems.homogeneous import rollers

from .by_solver import solve_by

GROWTH = 1.3
X, TETS = meshes.unstructured(2)
LAWS = {
    "NeoHookean": materials.NeoHookean.from_young(10.0, 0.45),
    "StableNeoHookean": materials.StableNeoHookean.from_young(10.0, 0.45),
    "Corotated": materials.Corotated.from_young(10.0, 0.45),
    "MooneyRivlin": materials.MooneyRivlin(1.5, 1.0, 50.0, C20=0.7),
    "Incompressible": materials.Incompressible(materials.NeoHookean(3.0, 3.0)),
}


def energies(name, growth):
    """A law's term of so much growth."""
    return [terms.Hyperelastic(LAWS[name], growth=growth)]


WAYS = [(name, solver, {}) for name in LAWS for solver in ("fenicsx", "skfem") if name != "Incompressible"]
WAYS += [(name, "fenicsx", {"element": "P2P1"}) for name in ("NeoHookean", "MooneyRivlin", "Incompressible")]
WAYS += [("NeoHookean", "fenicsx", {"element": "P2"})]


@pytest.mark.parametrize(("name", "solver", "options"), WAYS)
def test_free_growth_costs_nothing(name, solver, options):
    # An incompressible law's forces come from its pressure, nothing at the start and at the end.
    tolerance = 1e-8 if name == "Incompressible" else 1e-11
    scene = Scene(X, TETS, [*energies(name, GROWTH), *rollers(X)])
    answer = solve_by(solver, scene, tolerance=tolerance, **options)
    assert answer.positions == pytest.approx(GROWTH ** (1 / 3) * X, abs=1e-8)
    assert answer.energy == pytest.approx(0.0, abs=1e-12)
    assert answer.volume_ratio == pytest.approx(GROWTH)


def test_grown_tissue_is_as_stiff_as_it_was():
    """A cube that grew by 8 to twice its size, pulled to 1.5 times that, costs 8 times what the small one does."""
    far = meshes.vertices_at(X, 0, 1.0)

    def pulled(growth, size):
        end = terms.Fixed(far, 1.5 * size * X[far], components=(0,))
        scene = Scene(X, TETS, [*energies("NeoHookean", growth), *rollers(X), end])
        return solve_by("skfem", scene, start=size * X * [1.5, 1.0, 1.0]).energy

    assert pulled(8.0, 2.0) == pytest.approx(8.0 * pulled(1.0, 1.0), rel=1e-10)
