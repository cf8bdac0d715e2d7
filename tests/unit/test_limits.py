"""Where every solver begins and when it stops: tolerances relative and absolute, solutions before, what may vary."""

import pytest

from softdeca.reference import Scene, prepare, terms
from softdeca.reference.problems.meshes import box, vertices_at

SOLVERS = ("projective", "fenicsx", "skfem")


@pytest.fixture(params=SOLVERS)
def solver(request):
    if request.param == "fenicsx":
        pytest.importorskip("dolfinx")
    return request.param


def drawn(by=0.3):
    """A block on its base whose top springs draw aside."""
    X, tets = box((3, 3, 3))
    low, high = vertices_at(X, 2, 0.0), vertices_at(X, 2, 1.0)
    springs = terms.Target(high, X[high] + [by, 0.0, 0.1], 2.0)
    return Scene(X, tets, (terms.Strain(5.0), terms.Volume(10.0), terms.Fixed(low), springs))


def test_an_absolute_tolerance_asks_the_same_wherever_a_solve_starts(solver):
    prepared = prepare(drawn(), solver=solver)
    norms = prepared.solve(tolerance=1e-10).history.gradient_norm
    asked = 1e-5 * norms[0]
    from_rest = prepared.solve(absolute=asked)
    assert from_rest.converged and from_rest.history.gradient_norm[-1] <= asked < from_rest.history.gradient_norm[-2]
    near = prepared.solve(start=from_rest.positions, absolute=asked)
    assert near.converged and near.iterations == 0
    relative = prepared.solve(start=from_rest.positions, tolerance=1e-5)
    assert relative.iterations > 0
