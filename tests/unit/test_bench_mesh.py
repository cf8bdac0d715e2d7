"""The study of the mesh: limits of a known order, a small head's meshes, and gates that a wrong reference fails."""

import json
from pathlib import Path

import numpy as np
import pytest

from softdeca.benchmarks.harness import Row
from softdeca.benchmarks.studies.measures import limit_of_three, limit_of_two
from softdeca.benchmarks.studies.mesh.limits import SPLIT, compare_finer_meshes
from softdeca.benchmarks.studies.mesh.study import (
    ACCEPTED,
    FINER,
    MeshError,
)


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


def row(case, method, *lines):
    return Row(case, method, "done", "", {"rows": list(lines)}, 1.0, None, 0.0, "")


def passed(rows):
    return [gate["passed"] for gate in MeshError().gates(rows)]


def test_every_mesh_is_solved_and_the_finest_is_nearest(spheres):
    head = spheres(1)
    own, two, four, split = compare_finer_meshes(head, head.skin.vertices * [1.05, 1.0, 1.0])["rows"]
    finer = row("wider", FINER, own, two, four, split)
    assert passed([finer])[0]
    # Tets split into eight are eight times as many as the head's.
    assert split["tets"] == 8 * own["tets"] and four["tets"] == 4 * own["tets"]
    assert four["across"]["rms"] < two["across"]["rms"] < own["across"]["rms"]
    assert split["along"]["rms"] == pytest.approx(0.5 * two["along"]["rms"])
    assert own["rms"] <= own["across"]["rms"] + two["along"]["rms"] + 1e-12
    split["energy"] = 1e9
    assert not passed([finer])[0]


def test_the_head_of_the_level_below_fails_and_ours_passes_with_little_to_spare():
    """The coarser head's mean error was .0405 mm for a full smile; the answers of the default head are on file."""
    results = Path(__file__).parents[2] / "benchmarks" / "results" / "mesh.json"
    rows = [Row(**row) for row in json.loads(results.read_text())["rows"] if row["method"] == FINER]
    _, ours = MeshError().gates(rows)
    assert ours["passed"] and ours["answer"] and ACCEPTED < 1.25 * ours["value"]
    smile = next(row for row in rows if row.case == "mouthSmileLeft+mouthSmileRight")
    own, *finer = smile.values["rows"]
    assert passed([row(smile.case, FINER, own | {"mean": 0.0405}, *finer)]) == [True, False]
    # A solve that stops at once has a higher energy than the coarse mesh's answer.
    assert finer[-1]["what"] == SPLIT
    finer[-1] |= {"energy": 1.1 * own["energy"]}
    assert passed([row(smile.case, FINER, own, *finer)]) == [False, True]
