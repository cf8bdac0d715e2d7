"""Every hard case by projective dynamics, and by Newton where it is quick; the case "hard" of a study runs all."""

import json
from dataclasses import replace

import numpy as np
import pytest

from softdeca.reference import MissingDependencyError, Reason, SceneError, problems
from softdeca.reference.problems import laws_on_elements, recovery

SLOW = {"skfem": ("x5", "x10", "random", "crushed", "twisted")}
FEW_SEEDS = [f"seed {seed}," for seed in range(2, recovery.SEEDS)]
CASES = [
    (case, *way)
    for case in problems.HARD
    for way in case.ways
    if not any(word in case.name for word in SLOW.get(way[0], ()))
    and (way[0] == "projective" or not any(seed in case.name for seed in FEW_SEEDS))
    and not (way[1] == "P2" and "from rest x10" in case.name)
]
COLLAPSED = ("flattened to a line", "flattened to a point")
# Of every law on every element: what takes a second or two. Mixed elements may end anywhere from a collapse.
QUICK_LAWS = [
    (case, *way)
    for case in problems.LAWS_ON_ELEMENTS
    for way in case.ways
    if case.source[:2] in ("H1", "H2", "H3", "H9")
    and (way[1] != "P2" or "Stable" in case.name)
    and not (way[1] == "P2P1" and case.name.startswith(COLLAPSED) and case.right == laws_on_elements.ANYTHING)
    or "50 %" in case.name
    and way[1] == "P1"
    or "nu = 0.4999," in case.name
]


@pytest.mark.parametrize(
    ("case", "solver", "element"), [*CASES, *QUICK_LAWS], ids=lambda value: getattr(value, "name", value)
)
def test_hard_case(case, solver, element):
    try:
        outcome = problems.run_hard(case, solver, element)
    except MissingDependencyError as missing:
        pytest.skip(str(missing))
    assert outcome.passed, f"{outcome.outcome}: {outcome.error:.2e} of {outcome.bound:.0e}, {outcome.criterion}"


def named(name):
    return next(case for case in problems.HARD if case.name.startswith(name))


def test_an_outcome_says_what_went_wrong():
    """An error above the bound is missed; a solve that did not converge says why; a solver must be the case's."""
    strict = replace(named("bar stretched x2, Strain + 10"), bound=1e-9)
    assert problems.run_hard(strict, "projective").outcome == "missed"

    def impatient(attempt):
        attempt.stopped = Reason.MAX_ITERATIONS
        return 0.0

    assert problems.run_hard(replace(strict, error=impatient), "projective").outcome == "MAX_ITERATIONS"
    with pytest.raises(SceneError, match="is not for solver 'skfem'"):
        problems.run_hard(named("random start, seed 0, Strain"), "skfem")
    names = [case.name for case in problems.HARD]
    assert len(set(names)) == len(names)


def test_recovery_is_judged_by_shape_and_by_every_tet():
    """A turned block is at rest; one vertex off by 1e-4 is not, and its tets are below .9999."""
    scene = recovery.standing_block()
    solution = problems.problem.Attempt("skfem").solve(problems.problem.Attempt("skfem").prepare(scene))
    turned = replace(solution, positions=solution.positions @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]) + 3.0)
    assert recovery.away_from_rest(scene, turned) < 1e-14
    bent = solution.positions.copy()
    bent[-1] += 1e-4
    assert 1e-5 < recovery.away_from_rest(scene, replace(solution, positions=bent)) < np.inf
    assert recovery.away_from_rest(scene, replace(solution, volume_ratio=solution.volume_ratio * 0.99)) == np.inf


def test_bench_hard_prints_a_row_per_case_and_solver(command, tmp_path):
    solvers, out = ("--solver", "projective", "--solver", "skfem"), ("--out", tmp_path)
    ended = command("bench", "hard", "of stiffness 1:1e+06", *solvers, *out)
    assert ended.status == 0
    assert sum("layers of stiffness 1:1e+06" in line for line in ended.out.splitlines()) == 2
    assert "outcome passed" in ended.out and "iterations" in ended.out
    rows = json.loads(command("bench", "hard", "free fall", *solvers[:2], *out, "--json").out)["rows"]
    assert [row["values"]["outcome"] for row in rows] == ["passed"]
    assert rows[0]["values"]["error"] <= rows[0]["values"]["bound"]
    refused = command("bench", "hard", "nothing of the kind", *out)
    assert refused.status != 0 and "no case and method matches" in refused.errors[-1]
