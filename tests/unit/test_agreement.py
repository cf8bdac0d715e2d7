"""How far the solvers are apart on one face: differences by hand, gates on rows by hand, and the study of a sphere."""

import copy
import json
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from softdeca.benchmarks.harness import Row, run
from softdeca.benchmarks.harness.first_screen import ALL_VERTICES, SKIN
from softdeca.benchmarks.studies.agreement import solved
from softdeca.benchmarks.studies.agreement.solved import TRUTHS
from softdeca.benchmarks.studies.agreement.study import (
    ALL_SOLVERS,
    BESIDE,
    FEWER_SOLVERS,
    FIT,
    HEAD,
    TURNED,
    Agreement,
    solve_case,
)
from softdeca.benchmarks.studies.measures import difference, distances
from softdeca.surrogate.methods import (
    BLENDSHAPES,
    CARRIED,
    DERIVATIVES,
    FENICSX,
    FENICSX_NEO_HOOKEAN,
    NETWORK,
    PD,
    PD_PLAIN,
    SETTLED,
    SKFEM,
    SKFEM_NEO_HOOKEAN,
)

pytestmark = pytest.mark.usefixtures("measured_here")


def test_difference_is_that_of_two_points_by_hand():
    rest = np.zeros((2, 3))
    found = difference(np.array([[3.0, 4.0, 0.0], [10.0, 0, 0]]), np.array([[0.0, 0, 0], [10.0, 0, 0]]), rest)
    assert (found.mean, found.max, found.relative) == (2.5, 5.0, 0.5)
    assert found.rms == pytest.approx(np.sqrt(12.5)) and found.p95 == pytest.approx(4.75)
    only_second = difference(np.ones((2, 3)), np.array([[1.0, 1, 1], [1, 1, 3]]), rest, np.array([False, True]))
    assert only_second.max == 2.0 and only_second.relative == pytest.approx(2 / np.sqrt(11))
    assert distances(rest, rest + [0, 0, 2]).tolist() == [2.0, 2.0]


def test_difference_where_nothing_moves_is_all_or_nothing():
    rest = np.zeros((2, 3))
    assert difference(rest, rest, rest).relative == 0.0
    assert difference(rest + 1e-3, rest, rest).relative == 1.0


def line(truth, over, relative=1e-10, mean=0.1):
    return {"to": truth, "over": over, "mean": mean, "rms": 0.1, "p95": 0.2, "max": 0.3, "relative": relative}


def solved_row(method, **more):
    compared = [line(TRUTHS[method], ALL_VERTICES), line(TRUTHS[method], SKIN)]
    values = {"compared": compared, "done": True, "iterations": 2, "without_targets": False} | more
    return Row("jawOpen", method, "done", "", values, 1.0, None, 0.0, "")


@pytest.fixture
def rows():
    pd = {"to_001_mm": 10, "least_ratio": 0.12, "lips_mm": [0.2, 0.9, 1.5], "energy_rise": 0.0}
    return [
        solved_row(FENICSX, another_minimum_mm=None),
        solved_row(PD, to_other_start_mm=1e-8, change_max_mm=2.0, shown="Figure 7", **pd),
        solved_row(PD_PLAIN, to_001_mm=100),
        solved_row(SKFEM),
        solved_row(FENICSX_NEO_HOOKEAN),
        solved_row(SKFEM_NEO_HOOKEAN),
        Row("jawOpen", NETWORK, "done", "", {"compared": [line(PD, SKIN)]}, 1.0, None, 0.0, ""),
        Row("jawOpen", SETTLED, "done", "", {"compared": [line(PD, SKIN, mean=0.2)]}, 1.0, None, 0.0, ""),
    ]


def edited(rows, method, key, value):
    found = copy.deepcopy(rows)
    values = next(row.values for row in found if row.method == method)
    if key in ("relative", "mean"):
        values["compared"][0][key] = value
    else:
        values[key] = value
    return found


def test_all_gates_are_passed_by_good_rows(rows):
    found = Agreement().gates(rows)
    assert len(found) == 8 and all(gate["passed"] for gate in found)
    assert sum(gate["answer"] for gate in found) == 7
    assert next(gate for gate in found if gate["what"].startswith("accelerated"))["value"] == 0.1
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize(
    ("method", "key", "value", "missed", "answer"),
    [
        (PD, "relative", 1.1e-6, "PD to FEniCSx", True),
        (SKFEM, "relative", 1.1e-8, "PD's energy", True),
        (SKFEM_NEO_HOOKEAN, "relative", 1.1e-8, "neo-Hookean", True),
        (PD, "least_ratio", -0.01, "smallest volume ratio", True),
        (PD, "least_ratio", 0.0, "smallest volume ratio", True),
        (PD, "energy_rise", 1e-9, "energy rises", True),
        (PD, "to_other_start_mm", 0.02, "another start", True),
        (SKFEM, "done", False, "did not reach what was asked", True),
        (PD, "to_001_mm", 21, "accelerated PD's iterations", False),
        (PD, "to_001_mm", None, "accelerated PD's iterations", False),
        (PD_PLAIN, "to_001_mm", None, "accelerated PD's iterations", False),
    ],
)
def test_a_miss_is_a_miss(rows, method, key, value, missed, answer):
    found = [gate for gate in Agreement().gates(edited(rows, method, key, value)) if not gate["passed"]]
    assert len(found) == 1 and missed in found[0]["what"] and found[0]["answer"] is answer


@pytest.fixture
def sphere(monkeypatch):
    pytest.importorskip("dolfinx")
    monkeypatch.syspath_prepend(Path(__file__).parents[1])
    import sphere_studies

    solve_case.cache_clear()
    return sphere_studies.SphereAgreement(level=1, cases=("jawOpen", "rest-3-g", "rest-volume", "jaw-by-bone"))


def test_the_study_of_a_sphere(sphere, tmp_path):
    results = run(sphere, tmp_path)
    assert [(row.case, row.reason) for row in results.rows if row.status == "failed"] == []
    rivals = (DERIVATIVES, SETTLED, CARRIED, BLENDSHAPES)
    methods = dict.fromkeys(("jawOpen", "rest-3-g", "rest-volume"), (*ALL_SOLVERS, *rivals, BESIDE))
    methods["jaw-by-bone"] = (*FEWER_SOLVERS, BESIDE)
    asked = [(HEAD, FIT), *((case, method) for case, by in methods.items() for method in by), (TURNED, BESIDE)]
    assert [(row.case, row.method) for row in results.rows] == asked
    assert results.passed and len(results.gates) == 8 and "in all 4 cases" in results.words
    text = unescape((tmp_path / "index.html").read_text())
    assert text.count("<iframe") == 1 and "three.js" in text and text.count('<div class="panels">') == 5
    blends = next(row for row in results.rows if row.method == BLENDSHAPES).values["compared"]
    assert [(each["to"], each["over"]) for each in blends] == [(PD, SKIN), (FENICSX_NEO_HOOKEAN, SKIN)]
    # Where p is the default nothing settles, and doing nothing leaves all of the motion.
    assert blends[0]["share"] == pytest.approx(1.0, rel=1e-3)


def test_an_effect_of_a_sphere(sphere, tmp_path):
    results = run(replace(sphere, level=3, cases=("bells-palsy", "collisions")), tmp_path)
    assert [(row.case, row.reason) for row in results.rows if row.status == "failed"] == []
    assert results.passed and "Of 2 effects bells-palsy changes its expression most" in results.words
    pictures = [row.values for row in results.rows if row.method == BESIDE and row.case != TURNED]
    assert [len(each) for each in pictures] == [4, 5]


def test_where_fenicsx_ends_in_another_minimum_it_is_started_at_the_answer_it_checks(sphere, monkeypatch):
    prepare, starts = solved.prepare, []

    class Elsewhere:
        def __init__(self, prepared):
            self.prepared = prepared

        def solve(self, **asked):
            starts.append(asked["start"])
            solution = self.prepared.solve(**asked)
            return solution if len(starts) > 1 else replace(solution, positions=solution.positions + [0, 0.5, 0])

    def prepare_elsewhere(scene, **how):
        prepared = prepare(scene, **how)
        return Elsewhere(prepared) if how.get("solver") == "fenicsx" else prepared

    monkeypatch.setattr(solved, "prepare", prepare_elsewhere)
    case = solve_case(sphere, "rest-3-g")
    told, (everything, _) = case.tell_solve(FENICSX), case.compare(FENICSX, PD)
    assert np.array_equal(starts[1], case.answer(PD).solution.positions) and len(starts) == 2
    assert told["another_minimum_mm"] == pytest.approx(0.5, rel=1e-3) and told["start"] == "PD's answer"
    assert everything["relative"] < 1e-6
