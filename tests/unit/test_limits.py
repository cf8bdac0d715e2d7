"""Where every solver begins and when it stops: tolerances relative and absolute, solutions before, what may vary."""

import dataclasses

import numpy as np
import pytest

from softdeca.reference import Scene, SceneError, prepare, terms
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


def test_terms_say_what_may_vary(solver):
    """Held positions and targets may, stiffnesses may not, whichever solver is asked."""
    prepared = prepare(drawn(), solver=solver)
    moved = prepared.solve(drawn(0.1), tolerance=1e-8)
    assert np.abs(moved.positions - prepare(drawn(0.1), solver=solver).solve(tolerance=1e-8).positions).max() < 1e-5
    scene = drawn()
    stiffer = dataclasses.replace(scene, terms=(terms.Strain(6.0), *scene.terms[1:]))
    with pytest.raises(SceneError, match="Strain.stiffness differs"):
        prepared.solve(stiffer)
    kinds = [kind for kind in vars(terms).values() if isinstance(kind, type) and issubclass(kind, terms.Term)]
    assert len(kinds) > 10 and any(kind.varying for kind in kinds)
    for kind in kinds:
        assert not kind.varying or set(kind.varying) <= {field.name for field in dataclasses.fields(kind)}


def test_a_body_s_rest_has_gone_into_projective_dynamics_matrix():
    X, tets = box((2, 2, 2))
    body = vertices_at(X, 2, 1.0)
    base = (terms.Strain(5.0), terms.Fixed(vertices_at(X, 2, 0.0)))
    scene = Scene(X, tets, (*base, terms.RigidBody(body)))
    larger = Scene(X, tets, (*base, terms.RigidBody(body, rest=X[body] * 1.1)))
    with pytest.raises(SceneError, match="RigidBody.rest differs"):
        prepare(scene).solve(larger)
