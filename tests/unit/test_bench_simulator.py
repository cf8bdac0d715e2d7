"""What the studies of the simulator are made of: traces, leads, costs, libigl's ARAP, memory, on a small sphere."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from softdeca.benchmarks.harness.processes import held_megabytes, peak_megabytes
from softdeca.benchmarks.studies.arena.contest import Lines, run_outside, summarise, summarise_repeats
from softdeca.benchmarks.studies.arena.laws import RIGID
from softdeca.benchmarks.studies.arena.problems import pull_handles
from softdeca.benchmarks.studies.arena.work_precision import WorkPrecision
from softdeca.benchmarks.studies.measures import Trace, largest_distance, time_solve, trace_solve, trace_to_itself
from softdeca.benchmarks.studies.person import Person
from softdeca.lhm.base.errors import InputError
from softdeca.reference import NotModelledError, Parameters, facial_scene, prepare, terms
from softdeca.surrogate.methods import METHODS, NETWORK


@pytest.fixture(scope="module")
def targets(sphere_head):
    """The sphere's skin, drawn out by 3 mm where it looks forward."""
    skin = sphere_head.skin.vertices
    return skin + 3.0 * np.maximum(skin[:, 2:] / np.abs(skin).max(), 0.0) * np.array([0.0, 0.3, 1.0])


def test_a_trace_counts_from_where_the_error_stays_below():
    trace = Trace([0.0, 1.0, 2.0, 3.0], [5.0, 0.009, 0.02, 0.008], [1.0, 0.1, 0.2, 0.01])
    assert trace.iterations_to(0.01) == 3 and trace.seconds_to(0.01) == 3.0
    assert trace.iterations_to(0.5) == 1 and trace.seconds_to(5.0) == 0.0
    assert trace.iterations_to(1e-3) is None and trace.seconds_to(1e-3) is None and trace.tolerance_for(1e-3) is None
    # A solve with this tolerance goes on past iteration 1, whose gradient is 0.1.
    assert trace.tolerance_for(0.03) == 0.1 and trace.tolerance_for(0.01) == 0.01
    assert Trace([0.0, 1.0], [1.0, float("nan")], [1.0, 1.0]).iterations_to(2.0) is None


def test_a_solve_seen_from_its_end_is_seen_from_the_truth(sphere_head, targets):
    prepared = prepare(facial_scene(sphere_head, Parameters(), targets))
    solution, own = trace_to_itself(prepared)
    again, trace = trace_solve(prepared, solution.positions)
    assert again.converged and trace.error[-1] == 0.0
    assert np.allclose(own.error, trace.error, atol=2e-5) and own.gradient == pytest.approx(trace.gradient)
    stopped, short = trace_solve(prepared, solution.positions, enough=0.1)
    assert not stopped.converged and short.error[-1] <= 0.1 < short.error[-2]
    # The tolerance that a trace names leads a solve of its own to that accuracy.
    answer, cost = time_solve(lambda: facial_scene(sphere_head, Parameters(), targets), trace.tolerance_for(0.01))
    assert largest_distance(answer.positions, solution.positions) <= 0.01
    assert cost["iterations"] >= trace.iterations_to(0.01)
    assert min(cost[f"{part}_s"] for part in ("scene", "prepare", "solve", "cpu")) > 0


def test_a_rig_that_refuses_a_face_is_left_out(sphere_head, monkeypatch):
    def refuse(face):
        raise InputError("none of its people")

    monkeypatch.setitem(METHODS, NETWORK, replace(METHODS[NETWORK], bind=refuse))
    still = np.zeros((52, *sphere_head.skin.vertices.shape))
    of = Person(SimpleNamespace(shapes_on=lambda skin: still), np.zeros(3), sphere_head)
    monkeypatch.setattr(Person, "shape", lambda self, text: self.head.skin.vertices)
    monkeypatch.setattr(WorkPrecision, "person", lambda self: of)
    task = next(task for task in WorkPrecision(level=1).tasks() if task.method == NETWORK)
    with pytest.raises(NotModelledError, match="network: none of its people"):
        WorkPrecision(level=1).measure(task)


def test_times_are_those_of_the_run_in_the_middle():
    def lines(seconds):
        see = [{"cpu_s": seconds * k, "wall_s": 0.0, "work": k, "own": [0.0, 10.0**-k]} for k in range(4)]
        return Lines([{"phase": "set-up", "cpu_s": 0.1 * seconds}, *see])

    found = summarise_repeats([lines(3.0), lines(1.0), lines(2.0)])
    assert found["solve_s"] == [9.0, 3.0, 6.0] and found["repeats"] == 3 and found["iterations"] == 3
    assert found["seconds_to"][:4] == [0.0, 2.0, 4.0, 6.0] and found["work_to"][:4] == [0, 1, 2, 3]
    assert found["seconds_to"][4:] == [None] * 3 and found["to_hundredth_s"] == 4.0


def test_libigl_and_we_minimise_the_same_energy(sphere_head, targets):
    pytest.importorskip("igl")
    problem = pull_handles(sphere_head, targets)
    held, _ = facial_scene(sphere_head, Parameters(), targets).dirichlet()
    assert set(np.flatnonzero(held.all(axis=1))) < set(problem.held)
    scene = problem.scene(RIGID)
    assert [type(term) for term in scene.terms] == [terms.Strain, terms.Fixed]
    truth = prepare(scene).solve(tolerance=1e-10).positions
    found = summarise(run_outside("libigl_arap", problem.arrays(), {"own": truth}, {}, 2.0))
    moved = largest_distance(truth, scene.vertices)
    assert moved > 1.0 and found["max_mm"] < 2e-3 * moved and found["max_mm"] < 0.01 * found["first_mm"]


def grown(count: int) -> tuple[float, float]:
    before = held_megabytes()
    block = np.ones(count)
    return peak_megabytes() - before, float(block.sum())


def test_memory_is_seen_in_a_process_of_its_own():
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        megabytes, total = pool.submit(grown, 10_000_000).result()
    assert total == 1e7 and 75.0 < megabytes < 120.0
