"""Habits that make a time of FEniCSx unfair, on the smallest blocks."""

import numpy as np
import pytest

from softdeca.benchmarks.harness import Row
from softdeca.benchmarks.studies.scaling.timing import (
    TOLERANCES,
    Timing,
    compare_laws,
    compare_linear_solvers,
    compare_threads,
    compare_tolerances,
)
from softdeca.lhm.base.errors import InputError

pytest.importorskip("dolfinx")


def test_each_habit_costs_what_the_page_says():
    rows = {row["what"]: row for row in compare_linear_solvers(4)}
    kept, late, none = (
        rows[f"GAMG, {how}"]["iterations"]
        for how in ("near-null space", "near-null space after set-up", "no near-null space")
    )
    assert kept < late == none < rows["Jacobi"]["iterations"]
    assert max(row["off"] for row in rows.values()) < 1e-8
    assert [row["what"].split(", ")[0] for row in compare_threads(3)] == ["MUMPS"] * 2
    by_tolerance = [row["off"] for row in compare_tolerances(3)]
    assert by_tolerance == sorted(by_tolerance, reverse=True) and by_tolerance[-1] == 0.0
    assert len(by_tolerance) == len(TOLERANCES) + 1 and by_tolerance[0] > 1e-4
    own, *others = compare_laws(3)
    assert own["off"] == 0.0 and all(row["off"] > 1e-3 for row in others)


def test_answers_that_differ_fail_the_gate():
    lines = [{"what": "Jacobi", "off": 1e-9}, {"what": "MUMPS", "off": 0.0}]
    row = Row("linear solver, 6 cells", "FEniCSx", "done", "", {"rows": lines}, 1.0, None, 0.0, "")
    (gate,) = Timing().gates([row])
    assert gate["passed"]
    lines[0]["off"] = np.inf
    (gate,) = Timing().gates([row])
    assert not gate["passed"]


@pytest.mark.parametrize("cells", [(), ("2",), ("six",)])
def test_blocks_of_few_cells_are_refused(cells):
    with pytest.raises(InputError, match="cells: expected 3 or more"):
        Timing(cells=cells).tasks()
