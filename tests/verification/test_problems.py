"""Every verification problem through every solver that models it, in each of its ways where those differ."""

import json
import pickle
from dataclasses import asdict, replace

import pytest

from softdeca.reference import SOLVERS, MissingDependencyError, problems, solve

OTHER_WAYS = {
    "projective": [{"method": "plain"}],
    "fenicsx": [{"element": "P2"}, {"linear_solver": "mumps"}],
    "skfem": [{"element": "P2"}],
}
HOMOGENEOUS = ("patch", "NeoHookean nu=.45, uniaxial", "Strain")
CASES = [(problem, solver, {}) for problem in problems.ALL for solver in problem.solvers]
# Not under dead loads, by which quadratic elements buckle in compression.
CASES += [
    (problem, solver, options)
    for problem in problems.ALL
    if problem.name.startswith(HOMOGENEOUS) and "kPa" not in problem.name
    for solver in problem.solvers
    for options in OTHER_WAYS[solver]
]


@pytest.fixture(scope="module", autouse=True)
def solve_once():
    """Problems that ask several quantities of one scene share its answer."""
    answers = {}

    def remember(scene, **options):
        key = pickle.dumps((scene, options))
        if key not in answers:
            answers[key] = solve(scene, **options)
        return answers[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problems.problem, "solve", remember)
        yield


@pytest.mark.parametrize(("problem", "solver", "options"), CASES, ids=lambda value: getattr(value, "name", str(value)))
def test_problem(problem, solver, options):
    posed = replace(problem, options={**problem.options, **options})
    if options.get("element") == "P2":  # of ten times as many nodes, hence some more rounding
        posed = replace(posed, bounds={name: 10 * bound for name, bound in problem.bounds.items()})
    try:
        outcome = problems.run(posed, solver)
    except MissingDependencyError as missing:
        pytest.skip(str(missing))
    assert json.loads(json.dumps(asdict(outcome), allow_nan=False)) == asdict(outcome)
    assert outcome.passed, f"{outcome.value!r} is off by {outcome.error:.2e} of {outcome.bound:.0e}: {outcome.reason}"


def test_names_are_unique_and_solvers_exist():
    names = [problem.name for problem in problems.ALL]
    assert len(set(names)) == len(names)
    assert {solver for problem in problems.ALL for solver in problem.solvers} == set(SOLVERS)


def test_an_error_beyond_the_bound_fails():
    """The outcome judges: the same solution against a wrong reference is off by what the reference is."""
    right = next(problem for problem in problems.ALL if problem.name.startswith("two layers"))
    wrong = problems.run(replace(right, reference=1.01 * right.reference), "skfem")
    assert not wrong.passed
    assert wrong.error == pytest.approx(0.01 / 1.01, rel=1e-6)
