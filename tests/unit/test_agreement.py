"""How far the solvers are apart on one face: differences by hand, gates on rows by hand, and the study of a sphere."""

from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from softdeca.benchmarks.contest import collect_rows
from softdeca.benchmarks.harness import Row, run
from softdeca.benchmarks.studies.agreement.solvers import FENICSX_FROM_PD, OTHER_START
from softdeca.benchmarks.studies.agreement.study import Agreement
from softdeca.benchmarks.studies.measures import difference, distances
from softdeca.surrogate.methods import (
    BLENDSHAPES,
    CARRIED,
    DERIVATIVES,
    FENICSX,
    FENICSX_NEO_HOOKEAN,
    PD,
    SETTLED,
    SKFEM,
    SKFEM_NEO_HOOKEAN,
)

pytestmark = pytest.mark.usefixtures("measured_here")


def test_difference_is_that_of_two_points_by_hand():
    rest = np.zeros((2, 3))
    found = difference(np.array([[3.0, 4.0, 0.0], [10.0, 0, 0]]), np.array([[0.0, 0, 0], [10.0, 0, 0]]), rest)
    assert (found["mean"], found["max"], found["relative"]) == (2.5, 5.0, 0.5)
    assert distances(rest, rest + [0, 0, 2]).tolist() == [2.0, 2.0]


def test_difference_where_nothing_moves_is_all_or_nothing():
    rest = np.zeros((2, 3))
    assert difference(rest, rest, rest)["relative"] == 0.0
    assert difference(rest + 1e-3, rest, rest)["relative"] == 1.0


@pytest.fixture
def sphere(monkeypatch):
    pytest.importorskip("dolfinx")
    monkeypatch.syspath_prepend(Path(__file__).parents[1])
    import sphere_studies

    return sphere_studies.SphereAgreement(level=1, cases=("jawOpen", "rest-3-g", "rest-volume", "jaw-by-bone"))


def test_the_study_of_a_sphere(sphere, tmp_path):
    results = run(sphere, tmp_path)
    assert [(row.case, row.reason) for row in results.rows if row.status == "failed"] == []
    lines = collect_rows(results.rows)
    rivals = (DERIVATIVES, SETTLED, CARRIED, BLENDSHAPES)
    solvers = (PD, FENICSX_FROM_PD, FENICSX_NEO_HOOKEAN, FENICSX)
    methods = dict.fromkeys(
        ("jawOpen", "rest-3-g", "rest-volume"),
        (*solvers, SKFEM, SKFEM_NEO_HOOKEAN, OTHER_START, *rivals),
    )
    methods["jaw-by-bone"] = solvers
    assert [(line["case"], line["method"]) for line in lines] == [
        (case, by) for case in methods for by in methods[case]
    ]
    assert results.passed and len(results.gates) == 7 and "in all 4 cases" in results.words
    text = unescape((tmp_path / "index.html").read_text())
    assert text.count('<div class="panels">') == 4
    blends = next(line for line in lines if line["method"] == BLENDSHAPES)
    # Where p is the default nothing settles, and doing nothing leaves all of the motion.
    assert blends["to"][PD]["share"] == pytest.approx(1.0, rel=1e-3)


def test_an_effect_of_a_sphere(sphere, tmp_path):
    results = run(replace(sphere, level=3, cases=("bells-palsy", "collisions")), tmp_path)
    assert [(row.case, row.reason) for row in results.rows if row.status == "failed"] == []
    assert results.passed and "Of 2 effects bells-palsy changes its expression most" in results.words
    pictures = [[key for key in row.values if key != "rows"] for row in results.rows]
    assert [len(each) for each in pictures] == [4, 5]


def solved_row(method, to):
    """A row of one case, in which a method is so far from each truth, of the largest displacement."""
    inside = {truth: {"inside": {"relative": apart, "max": apart}, "everywhere": apart} for truth, apart in to.items()}
    told = {"least_ratio": 1.0} if method == PD else {}
    return {"case": "grin", "kind": "expressions", "frame": 0, "method": method, "status": "done", "told": told,
            "reason": "", "to": inside}  # fmt: skip


@pytest.mark.parametrize(("from_pd", "passes"), [(1e-9, True), (1e-3, False)])
def test_where_fenicsx_ends_in_another_minimum_its_answer_from_pds_counts(from_pd, passes):
    lines = [solved_row(PD, {}), solved_row(FENICSX, {PD: 0.5}), solved_row(FENICSX_FROM_PD, {PD: from_pd})]
    row = Row("grin", "every method", "done", "", {"rows": lines}, 1.0, None, 0.0, "")
    study = Agreement(cases=("jawOpen",))
    assert study.gates([row])[0]["passed"] == passes
    assert "two minima on grin" in study.words([row])
