"""softdeca bench dynamics: a small sphere, its report, and what its configuration refuses."""

from functools import partial

import numpy as np
import pytest

pytest.importorskip("dolfinx")

from softdeca.benchmarks.harness import Row
from softdeca.benchmarks.studies.agreement.dynamics import RELEASED, SHAKEN, Dynamics, let_go, shake
from softdeca.benchmarks.studies.agreement.release import Release, swing
from softdeca.reference import Face, march
from softdeca.reference.fenicsx.policy import FenicsxPolicy, MarchPolicy


def test_a_swing_is_found_by_its_frequency_and_damping():
    t = np.arange(30) / 60
    for frequency, damping in ((4.0, 0.3), (9.0, 0.05), (2.5, 0.0)):
        omega = 2 * np.pi * frequency
        wave = 3 * np.exp(-damping * omega * t) * np.cos(omega * np.sqrt(1 - damping**2) * t - 0.4)
        found = swing(t, wave)
        assert (found.frequency, found.damping) == (
            pytest.approx(frequency, rel=1e-6),
            pytest.approx(damping, abs=1e-6),
        )
        assert found.misfit < 1e-6


def test_a_swing_of_few_values_is_not_taken_for_a_faster_one():
    """At 60 values a second 3.88 Hz and 56.2 Hz are the same; implicit Euler damps the former by 0.200."""
    left = np.array([1.0, 0.85, 0.594, 0.288, -0.016, -0.271, -0.447, -0.53, -0.52])
    found = swing(np.arange(9) / 60, left)
    assert found.frequency == pytest.approx(3.88, abs=0.01) and found.damping == pytest.approx(0.2, abs=0.01)


def rows_of(release, frames):
    found = {RELEASED: let_go(release, frames), SHAKEN: shake(release, frames)}
    return [Row(case, "all marches", "done", "", values, 1.0, None, 0.0, "") for case, values in found.items()]


def test_what_the_study_shows_on_a_small_sphere(spheres):
    """4 Hz at 60 frames per second: implicit Euler damps by 0.200 and swings 0.97 times as fast, by the closed form."""
    head = spheres(1)
    at = int(np.argmax(head.skin.vertices[:, 2] - np.abs(head.skin.vertices[:, 1] + 30.0)))
    rows, study = rows_of(Release(Face(head, choices={"bones": "prescribed"}), at), 10), Dynamics()
    assert [gate["what"] for gate in study.gates(rows) if not gate["passed"]] == []
    found = {row["name"]: row for row in rows[0].values["rows"]}
    # The springs' share of all stiffness is nearly one; the tissue's raises the frequency a little.
    assert found["Eq. 9, p's frequency and damping"]["damping"] == pytest.approx(0.3, abs=0.01)
    euler, exact = found["FEM, implicit Euler"], found["FEM, Newmark, 4 per frame"]
    assert euler["damping"] == pytest.approx(0.2, abs=0.01)
    assert euler["frequency"] / exact["frequency"] == pytest.approx(0.97, abs=0.01)
    assert exact["frequency"] == pytest.approx(4.0, abs=0.2) and abs(exact["damping"]) < 5e-3
    assert "FEM, implicit Euler: " in study.words(rows)
    assert "<svg" in next(iter(study.pictures(rows).values()))


def test_a_march_that_stops_is_a_row_with_its_reason(spheres, monkeypatch):
    hasty = partial(march, policy=FenicsxPolicy(march=MarchPolicy(max_iterations=2)))
    monkeypatch.setattr("softdeca.benchmarks.studies.agreement.release.march", hasty)
    rows, study = rows_of(Release(Face(spheres(1), choices={"bones": "prescribed"}), 0), 8), Dynamics()
    marches = [line for row in rows for line in row.values["rows"]]
    stopped = [line for line in marches if not line["converged"]]
    assert stopped and all("steps: iteration limit" in line["stopped"] for line in stopped)
    assert len(stopped) < len(marches)
    missed = {gate["what"]: gate["value"] for gate in study.gates(rows) if not gate["passed"]}
    assert missed["marches that did not reach what was asked"] == len(stopped)
    assert missed["shaken: PD to implicit Euler by FEM, of the largest displacement"] is None
