"""Mesh convergence: Richardson's formulas on answers of a known order, and the study on a small head."""

import numpy as np
import pytest

from softdeca.benchmarks.convergence import ConvergenceConfig, convergence_gates, mesh_convergence
from softdeca.benchmarks.convergence_report import errors_plot, page
from softdeca.benchmarks.machine import describe
from softdeca.benchmarks.richardson import limit_of_three, limit_of_two
from softdeca.lhm import InputError


@pytest.mark.parametrize("order", [0.8, 1.0, 1.7, 2.0])
def test_the_limit_of_an_answer_of_one_order_is_exact(order):
    rng = np.random.default_rng(0)
    exact, slope = rng.normal(size=(2, 50, 3))
    coarse, middle, fine = (exact + slope * size**order for size in (1.0, 0.5, 0.25))
    limit = limit_of_three(coarse, middle, fine)
    assert limit.observed == pytest.approx(order) and limit.used == pytest.approx(order)
    assert limit.positions == pytest.approx(exact, abs=1e-12)
    # Roache: 1.25 times the true error of the finest, here the slope's RMS times its size to the order.
    slopes = np.sqrt((slope**2).sum(axis=1).mean())
    assert limit.index == pytest.approx(1.25 * slopes * 0.25**order)
    two = limit_of_two(coarse, middle, order)
    assert two.positions == pytest.approx(exact, abs=1e-12)
    assert two.index == pytest.approx(3.0 * slopes * 0.5**order)


def test_an_order_out_of_range_is_told_and_not_used():
    x = np.zeros((4, 3))
    growing = limit_of_three(x, x + 1.0, x + 3.0)
    assert growing.observed == pytest.approx(-1.0) and growing.used == 0.5
    fast = limit_of_three(x, x + 1.0, x + 1.01)
    assert fast.observed > 6.0 and fast.used == 2.0
    still = limit_of_three(x, x, x)
    assert still.observed is None and still.index == 0.0
    late = limit_of_three(x, x, x + 1.0)
    assert late.observed is None and late.used == 0.5


@pytest.fixture(scope="module")
def small(spheres):
    head = spheres(1)
    rest = head.skin.vertices
    targets = {"wider": rest * [1.05, 1.0, 1.0], "up": rest + [0.0, 0.02, 0.0] * np.abs(rest)}
    return mesh_convergence(head, targets, 1e-8, lambda *_: None)


def test_every_mesh_is_solved_and_the_finest_is_nearest(small):
    assert len(small["solves"]) == 8 and all(row["converged"] for row in small["solves"])
    assert [gate["passed"] for gate in small["gates"][:2]] == [True, True]
    # Tets split into eight are eight times as many as the head's.
    counts = {(row["surface"], row["sub_layers"]): row["tets"] for row in small["solves"]}
    assert counts[1, 2] == 8 * counts[0, 1] and counts[0, 4] == 4 * counts[0, 1]
    for row in small["expressions"]:
        assert row["across"]["4"]["rms"] < row["across"]["2"]["rms"] < row["across"]["1"]["rms"]
        assert row["along"]["1"]["rms"] == pytest.approx(0.5 * row["along"]["0"]["rms"])
        assert row["own_mesh"]["rms"] <= row["across"]["1"]["rms"] + row["along"]["0"]["rms"] + 1e-12


def test_an_energy_that_rises_on_the_finer_mesh_is_a_miss(small):
    rows = [dict(row) for row in small["solves"]]
    finest = next(row for row in rows if row["surface"] == 1)
    finest["energy"] = 1e9
    gates = convergence_gates(small["expressions"], rows)
    assert gates[1]["value"] == 1 and not gates[1]["passed"]


def test_the_page_shows_each_expression(small):
    results = {**small, "title": "small", "machine": describe(), "seconds": 1.0, "tolerance": 1e-8}
    text = page(results)
    assert text.count("<tr><td>wider</td>") >= 4 and "Quadratic tets" not in text
    assert "wider" in errors_plot(small["expressions"])


def test_expressions_that_cannot_be_read_are_told():
    with pytest.raises(InputError, match="grin"):
        ConvergenceConfig(expressions=("grin",))
    with pytest.raises(InputError, match="none"):
        ConvergenceConfig(expressions=())


def test_quadratic_tets_are_a_second_opinion(spheres):
    pytest.importorskip("dolfinx", reason="FEniCSx is not installed")
    head = spheres(1)
    targets = {"wider": head.skin.vertices * [1.05, 1.0, 1.0]}
    study = mesh_convergence(head, targets, 1e-8, lambda *_: None, quadratic=True)
    (row,) = study["expressions"]
    assert study["solves"][-1]["element"] == "P2" and study["solves"][-1]["converged"]
    # Quadratic displacements of the same mesh hold the linear ones, and its springs are the same.
    assert study["solves"][-1]["energy"] < study["solves"][0]["energy"]
    assert 0.0 < row["quadratic_to_own"]["rms"] < row["moved_mm"]


def test_the_command_tells_a_bad_expression_in_a_line(command, tmp_path):
    ended = command("bench", "convergence", "--expression", "grin", "--out", tmp_path / "out")
    assert ended.status != 0 and len(ended.errors) == 1 and "grin" in ended.errors[0]
