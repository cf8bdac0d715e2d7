"""How far the solvers are apart on one face: differences by hand, gates on rows by hand, and the study of a sphere."""

from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from softdeca.benchmarks.harness import run
from softdeca.benchmarks.harness.first_screen import SKIN
from softdeca.benchmarks.studies.agreement import solved
from softdeca.benchmarks.studies.agreement.study import (
    ALL_SOLVERS,
    BESIDE,
    FEWER_SOLVERS,
    FIT,
    HEAD,
    TURNED,
    solve_case,
)
from softdeca.benchmarks.studies.measures import difference, distances
from softdeca.surrogate.methods import (
    BLENDSHAPES,
    CARRIED,
    DERIVATIVES,
    FENICSX,
    FENICSX_NEO_HOOKEAN,
    PD,
    SETTLED,
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
