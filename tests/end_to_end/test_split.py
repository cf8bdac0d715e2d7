"""softdeca bench split: the parts of a frame's error, and that PD and FEniCSx agree beneath."""

from dataclasses import replace

import pytest

pytest.importorskip("dolfinx")

from softdeca.benchmarks.harness import Row, run
from softdeca.benchmarks.studies.surrogate.split import FINE, PARTS, RIVALS, SHARES, Split, _find_ratios

pytestmark = pytest.mark.usefixtures("measured_here")

EFFECT, TEXT = "softer, 2 g", "mouthPucker"


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The coarsest head, which is the study's own level and the coarse one at once."""
    out = tmp_path_factory.mktemp("split")
    return run(Split(level=1, expressions=(TEXT,), effects=(EFFECT,), refined=(EFFECT,)), out, workers=1), out


def test_the_parts_of_an_error_and_their_check(measured):
    results, out = measured
    assert [(row.case, row.reason) for row in results.rows if row.status == "failed"] == []
    assert "Simulation moves the skin by" in results.words
    text = (out / "index.html").read_text()
    assert "<svg" in text and "measured" in text
    values = results.rows[0].values
    assert values["fenicsx"] < 1e-4 < values["moved"]
    parts = [values[key] for key in list(PARTS)[:3]]
    # A triangle's sides: the whole is at most its parts, and no part more than the others and the whole.
    assert values["total"] <= sum(parts) + 1e-6 and parts[0] <= parts[1] + parts[2] + values["total"] + 1e-6
    assert values["tolerance"] < 0.1 * values["network"]
    # No bone is scaled here, so nothing is carried and that rival leaves all that moves.
    assert values["share_carried"] == pytest.approx(1.0)


def test_quadratic_tets_of_one_level_are_their_own_estimate(measured):
    coarse, fine = measured[0].rows
    assert fine.method == TEXT + FINE
    assert fine.values["mesh"] == fine.values["mesh_coarse"] == coarse.values["mesh_coarse"] > 0.0
    assert fine.values["alike"] == pytest.approx(1.0) and fine.values["refined_index"] == 0.0
    assert fine.values["refined"] == pytest.approx(fine.values["mesh"])
    assert _find_ratios(measured[0].rows) == [1.0]


def test_the_costly_rows_are_tasks_of_their_own_after_all_others():
    tasks = Split(expressions=("mouthPucker", "cheekPuff"), effects=("defaults",), refined=("softer, 2 g",)).tasks()
    assert [(task.case, task.method) for task in tasks] == [
        ("defaults", "mouthPucker"),
        ("defaults", "cheekPuff"),
        ("softer, 2 g", f"mouthPucker{FINE}"),
    ]


def frame(effect, text, **values):
    return Row(effect, text, "done", "", values, 1.0, None, 0.0, "")


def test_a_rows_part_of_the_mesh_is_estimated_between_the_ratios_measured():
    study = Split()
    own = {"moved": 1.0, "network": 0.1, "tolerance": 0.0, "law": 0.0, "total": 0.1, "share": 0.1, "fenicsx": 0.0}
    shares = {f"share_{key}": 1.0 for key in RIVALS}
    fine = {"mesh_max": 1.0, "alike": 1.0, "refined": 0.1, "refined_index": 0.1}
    rows = [
        frame("defaults", "a", **own, **shares, mesh_coarse=0.2),
        frame("defaults", "b", **own, **shares, mesh_coarse=0.4),
        frame("defaults", f"a{FINE}", mesh=0.1, mesh_coarse=0.2, **fine),
        frame("softer, 2 g", f"a{FINE}", mesh=0.3, mesh_coarse=1.0, **fine),
    ]
    lines = study.tables(rows)[0].rows
    # Ratios .5 and .3: the second row lies between .12 and .2, and is taken in the middle.
    assert lines[0][2:5] == (0.2, 0.1, "measured")
    assert lines[1][4] == "estimated" and lines[1][2:4] == pytest.approx((0.4, 0.16))
    assert lines[1][5:] == pytest.approx((0.12, 0.2))
    # Their mean coarse part is .3: .12 mm, from .09 to .15.
    assert "0.120 mm (12.0 %; between 0.090 and 0.150; measured in 2 of the rows" in study.words(rows)


@pytest.mark.parametrize("rival", RIVALS)
def test_no_rival_without_learning_passes_for_the_network(measured, rival):
    """The coarsest head's rival in the network's place, for the effect measured and with the mean that it is of."""
    (row, _), study = measured[0].rows, Split()
    share = row.values[f"share_{rival}"]
    planted = replace(row, values=row.values | {"share": share, "network": row.values["moved"] * share})
    gates = {gate["what"]: gate for gate in study.gates([planted])}
    assert not gates[f"network's share of |T - carried(S)|, {EFFECT}, mean"]["passed"], share
    own = replace(row, values=row.values | {"share": 0.85 * SHARES[EFFECT]})
    assert all(gate["passed"] for gate in study.gates([own]) if "share" in gate["what"])
