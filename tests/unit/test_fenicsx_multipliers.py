"""Mixed elements by descent: derivatives of the condensed energy, agreement with the load path, crushed starts."""

import numpy as np
import pytest

pytest.importorskip("dolfinx")


from softdeca.reference import Reason, Scene, materials, solve, terms
from softdeca.reference.clock import Seconds
from softdeca.reference.fenicsx.linear.problem import DiscreteProblem
from softdeca.reference.fenicsx.mesh.numbering import Numbering
from softdeca.reference.fenicsx.policy import FenicsxPolicy
from softdeca.reference.fenicsx.prepared import as_compressible
from softdeca.reference.fenicsx.run import Record, Run
from softdeca.reference.fenicsx.strategies.multipliers import Condensed, MultiplierDescent
from softdeca.reference.problems import meshes
from softdeca.reference.solution import Limits

NEO_HOOKEAN = materials.NeoHookean(2.0, 5.0)
LAWS = {
    "incompressible": materials.Incompressible(NEO_HOOKEAN),
    "nu = .499": materials.NeoHookean.from_young(1.0, 0.499),
    "logarithmic volume": materials.IsochoricNeoHookean(1.0, 50.0, "kappa/4 (J^2-1-2 ln J)"),
}
each_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)


def sheared(law, by=0.4, cells=(2, 2, 2)):
    """A block whose upper face is pushed aside."""
    X, tets = meshes.box(cells)
    ends = [meshes.vertices_at(X, 2, end) for end in (0.0, 1.0)]
    goal = np.concatenate([X[ends[0]], X[ends[1]] + [by, 0.0, 0.0]])
    return Scene(X, tets, [terms.Hyperelastic(law), terms.Fixed(np.concatenate(ends), goal)])


def descend(scene, *, start=None, tolerance=1e-9, max_iterations=None, on_iteration=None, linear_solver="cg"):
    problem = DiscreteProblem(scene, Numbering(scene, 2), mixed=True)
    condensed = Condensed(problem)
    begin = scene.vertices if start is None else start
    run = Run(scene, problem.numbering, begin, Limits(tolerance), Record(max_iterations, on_iteration))
    descent = MultiplierDescent(run, condensed, linear_solver=linear_solver)
    return run.solution(descent.attempt(), Seconds(0.0, 0.0))


@each_law
def test_the_condensed_energy_has_its_gradient(law):
    """Central differences of the maximum over pressures; the gradient is taken at the maximiser alone."""
    scene = sheared(law)
    problem = DiscreteProblem(scene, Numbering(scene, 2), mixed=True)
    condensed = Condensed(problem)
    rng = np.random.default_rng(0)
    condensed.centre = rng.normal(size=problem.pressures.count)
    u, d = 0.01 * rng.normal(size=(2, *problem.numbering.X.shape))
    h = 1e-3
    change = (condensed.at(u + h * d).energy - condensed.at(u - h * d).energy) / (2 * h)
    assert np.sum(condensed.at(u).gradient() * d) == pytest.approx(change, rel=1e-6)


def test_targets_that_crush_elements_are_reached_by_descent():
    """Springs that would turn a surface over: the law is infinite where a point inverts, so corners alone do."""
    X, tets = meshes.box((4, 2, 2))
    base, top = (meshes.vertices_at(X, 2, end) for end in (0.0, 1.0))
    pulled = np.array(X[top])
    pulled[:, 0] = 1.0 - pulled[:, 0]
    springs = terms.Target(top, pulled, 5.0)
    scene = Scene(X, tets, [terms.Hyperelastic(LAWS["incompressible"]), terms.Fixed(base), springs])
    solution = descend(scene, tolerance=1e-7)
    assert solution.reason is Reason.INVERTED, solution.reason
    assert 0.0 < solution.energy < 0.5 * 5.0 * np.sum((X[top] - pulled) ** 2)


def test_a_large_scene_descends_from_linear_tets():
    """The first iterate is linear tets' answer, the last one a small scene's."""
    scene = sheared(LAWS["incompressible"])
    options = {"solver": "fenicsx", "element": "P2P1", "tolerance": 1e-9}
    path = solve(scene, **options)
    seen, policy = [], FenicsxPolicy(large=len(scene.tets))
    large = solve(scene, policy=policy, on_iteration=lambda i, x, e, g: seen.append(np.array(x)), **options)
    softer = as_compressible(scene)
    assert [term.material for term in softer.of(terms.Hyperelastic)] == [materials.NeoHookean(2.0, 20.0)]
    near = solve(softer, solver="fenicsx", element="P1", tolerance=1e-9)
    assert np.abs(seen[0] - near.positions).max() < 1e-3 < np.abs(seen[0] - scene.vertices).max()
    assert large.converged and np.abs(large.positions - path.positions).max() < 1e-7


def test_descent_stops_where_it_is_told():
    scene = sheared(LAWS["incompressible"])
    assert descend(scene, max_iterations=1).reason is Reason.MAX_ITERATIONS
    assert descend(scene, on_iteration=lambda i, x, e, g: i == 2).reason is Reason.INTERRUPTED
    inverted = np.array(scene.vertices)
    inverted[:, 0] *= -1.0
    assert descend(scene, start=inverted).reason is Reason.NOT_FINITE
