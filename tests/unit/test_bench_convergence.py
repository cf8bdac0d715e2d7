"""Mesh convergence: Richardson's formulas on answers of a known order, and the study on a small head."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softdeca.benchmarks.harness import Row
from softdeca.benchmarks.studies.measures import limit_of_three, limit_of_two
from softdeca.benchmarks.studies.mesh.convergence import ACCEPTED, Convergence
from softdeca.benchmarks.studies.person import Person


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


class Wider(Person):
    """A sphere whose one expression makes it wider."""

    def shape(self, text):
        return self.head.skin.vertices * [1.05, 1.0, 1.0]


def measured(monkeypatch, head, **options):
    study = Convergence(expressions=("jawOpen",), tolerance=1e-8, **options)
    monkeypatch.setattr(Convergence, "person", lambda self: Wider(None, None, head))
    (task,) = study.tasks()
    return study, Row(task.case, task.method, "done", "", study.measure(task), 1.0, None, 0.0, "")


def test_every_mesh_is_solved_and_the_finest_is_nearest(spheres, monkeypatch):
    study, row = measured(monkeypatch, spheres(1))
    found = row.values
    assert len(found["solves"]) == 4 and all(solve["converged"] for solve in found["solves"])
    assert [gate["passed"] for gate in study.gates([row])[:2]] == [True, True]
    # Tets split into eight are eight times as many as the head's.
    counts = {(solve["surface"], solve["sub_layers"]): solve["tets"] for solve in found["solves"]}
    assert counts[1, 2] == 8 * counts[0, 1] and counts[0, 4] == 4 * counts[0, 1]
    assert found["across"]["4"]["rms"] < found["across"]["2"]["rms"] < found["across"]["1"]["rms"]
    assert found["along"]["1"]["rms"] == pytest.approx(0.5 * found["along"]["0"]["rms"])
    assert found["rms"] <= found["across"]["1"]["rms"] + found["along"]["0"]["rms"] + 1e-12
    next(solve for solve in found["solves"] if solve["surface"] == 1)["energy"] = 1e9
    rises = study.gates([row])[1]
    assert rises["value"] == 1 and not rises["passed"]


def test_the_head_of_the_level_below_fails_and_ours_passes_with_little_to_spare():
    """The coarser head's mean error was .0405 mm for a full smile; the answers of the default head are on file."""
    results = Path(__file__).parents[2] / "benchmarks" / "results" / "convergence.json"
    rows = [Row(**row) for row in json.loads(results.read_text())["rows"]]
    ours = Convergence().gates(rows)[2]
    assert ours["passed"] and ours["answer"] and ACCEPTED < 1.25 * ours["value"]
    smile = next(row for row in rows if row.case == "mouthSmileLeft+mouthSmileRight")
    coarser = replace(smile, values=smile.values | {"mean": 0.0405})
    assert not Convergence().gates([coarser])[2]["passed"]
    # A solve that stops at once has a higher energy than the coarse mesh's answer, and has not converged.
    solves = [dict(solve) for solve in smile.values["solves"]]
    solves[-1] |= {"energy": 1.1 * solves[0]["energy"], "converged": False}
    stopped = Convergence().gates([replace(smile, values=smile.values | {"solves": solves})])
    assert [gate["passed"] for gate in stopped] == [False, False, True]


def test_quadratic_tets_are_a_second_opinion(spheres, monkeypatch):
    pytest.importorskip("dolfinx", reason="FEniCSx is not installed")
    _, row = measured(monkeypatch, spheres(1), quadratic=True)
    solves = row.values["solves"]
    assert solves[-1]["element"] == "P2" and solves[-1]["converged"]
    # Quadratic displacements of the same mesh hold the linear ones, and its springs are the same.
    assert solves[-1]["energy"] < solves[0]["energy"]
    assert 0.0 < row.values["quadratic_to_own"]["rms"] < row.values["moved_mm"]
