"""The simulator's benchmark: traces, gates and leads on figures made by hand, ARAP and costs on a small sphere."""

import json
import re

import numpy as np
import pytest

from softdeca.benchmarks import arap, floor, scaling, work_precision
from softdeca.benchmarks.apart import apart, held_megabytes, peak_megabytes
from softdeca.benchmarks.costs import timed
from softdeca.benchmarks.minimal_model import VARIANTS, WHOLE, Variant, measure_dynamics, measure_variant
from softdeca.benchmarks.simulator import PARTS, SimulatorConfig, run_simulator
from softdeca.benchmarks.simulator_report import gates, page
from softdeca.benchmarks.traces import Trace, farthest, traced, traced_to_itself
from softdeca.benchmarks.work_precision import ACCURACIES, ARAP, FACE, NEWTON, OURS, lead, medians
from softdeca.lhm.errors import InputError, SoftdecaError
from softdeca.reference import Parameters, facial_scene, prepare, terms


@pytest.fixture(scope="module")
def targets(sphere_head):
    """The sphere's skin, drawn out by 3 mm where it looks forward."""
    skin = sphere_head.skin.vertices
    return skin + 3.0 * np.maximum(skin[:, 2:] / np.abs(skin).max(), 0.0) * np.array([0.0, 0.3, 1.0])


def test_a_trace_counts_from_where_the_error_stays_below():
    trace = Trace([0.0, 1.0, 2.0, 3.0], [5.0, 0.009, 0.02, 0.008], [1.0, 0.1, 0.2, 0.01])
    assert trace.settled(0.01) == 3 and trace.seconds_to(0.01) == 3.0
    assert trace.settled(0.5) == 1 and trace.seconds_to(5.0) == 0.0
    assert trace.settled(1e-3) is None and trace.seconds_to(1e-3) is None and trace.tolerance_for(1e-3) is None
    # A solve with this tolerance goes on past iteration 1, whose gradient is 0.1.
    assert trace.tolerance_for(0.03) == 0.1 and trace.tolerance_for(0.01) == 0.01
    assert Trace([0.0, 1.0], [1.0, float("nan")], [1.0, 1.0]).settled(2.0) is None


def test_a_solve_seen_from_its_end_is_seen_from_the_truth(sphere_head, targets):
    prepared = prepare(facial_scene(sphere_head, Parameters(), targets))
    solution, own = traced_to_itself(prepared)
    again, trace = traced(prepared, solution.positions)
    assert again.converged and trace.error[-1] == 0.0
    assert np.allclose(own.error, trace.error, atol=2e-5) and own.gradient == pytest.approx(trace.gradient)
    stopped, short = traced(prepared, solution.positions, enough=0.1)
    assert not stopped.converged and short.error[-1] <= 0.1 < short.error[-2]
    # The tolerance that a trace names leads a solve of its own to that accuracy.
    answer, cost = timed(lambda: facial_scene(sphere_head, Parameters(), targets), trace.tolerance_for(0.01))
    assert farthest(answer.positions, solution.positions) <= 0.01
    assert cost["iterations"] >= trace.settled(0.01)
    assert cost["seconds"] == pytest.approx(sum(cost[f"{part}_seconds"] for part in ("scene", "prepare", "solve")))


def curve(label: str, energy: str, prepare_seconds: float, seconds: float | None) -> dict:
    times = [None if seconds is None else seconds * (1 + k) for k in range(len(ACCURACIES))]
    return {"energy": energy, "expression": "a", "label": label, "prepare_seconds": prepare_seconds, "seconds": [0, 1],
            "error_mm": [1.0, 1e-3], "seconds_to": times}  # fmt: skip


def test_a_lead_is_the_worst_ratio_below_a_tenth_of_a_millimetre():
    assert ACCURACIES[0] == 1.0 and ACCURACIES[-1] == 1e-6 and 0.1 in ACCURACIES
    rows = medians([curve(OURS, FACE, 1.0, 1.0), curve(NEWTON, FACE, 0.0, 1.5), curve("slow", FACE, 0.0, None)])
    # Prepared: 1 to 1.5 at each; with preparation (1 + k + 1) / 1.5 (k + 1), worst at 0.1 mm, where k = 2.
    assert ACCURACIES[2] == 0.1
    assert lead(rows, FACE, NEWTON, "solve") == (pytest.approx(1 / 1.5), [])
    assert lead(rows, FACE, NEWTON) == (pytest.approx(4 / 4.5), [])
    assert lead(rows, FACE, "slow") == (0.0, []) and lead(rows, ARAP, NEWTON) == (None, [])
    behind = medians([curve(OURS, FACE, 0.0, None), curve(NEWTON, FACE, 0.0, 1.0)])
    worst, where = lead(behind, FACE, NEWTON)
    assert worst == np.inf and where == list(ACCURACIES[2:])


def test_medians_are_missing_where_an_expression_did_not_come_so_far():
    two = [curve(OURS, FACE, 1.0, 1.0), curve(OURS, FACE, 3.0, None)]
    assert medians(two)[0]["solve"] == [None] * len(ACCURACIES)
    three = [curve(OURS, FACE, 1.0, 1.0), curve(OURS, FACE, 3.0, 3.0), curve(OURS, FACE, 2.0, 2.0)]
    row = medians(three)[0]
    assert row["solve"][0] == 2.0 and row["total"][0] == 4.0 and row["prepare_seconds"] == 2.0


def test_exponents_are_slopes_of_powers():
    rows = [{"tets": n, "megabytes": 3.0 * n**1.2, "iterations": 7, "factor_mb": None} for n in (10, 40, 160)]
    rows = [dict.fromkeys(scaling.GROWING) | row for row in rows]
    found = scaling.exponents(rows)
    assert found == {"megabytes": pytest.approx(1.2), "iterations": pytest.approx(0.0, abs=1e-12)}
    assert scaling.exponents(rows[:1]) == {}


def test_libigl_and_we_minimise_the_same_energy(sphere_head, targets):
    pytest.importorskip("igl")
    face = facial_scene(sphere_head, Parameters(), targets)
    handles = arap.Handles.of(sphere_head, face, targets)
    held, _ = face.dirichlet()
    assert set(np.flatnonzero(held.all(axis=1))) < set(handles.vertices)
    scene = handles.scene(face)
    assert [type(term) for term in scene.terms] == [terms.Strain, terms.Fixed]
    truth = prepare(scene).solve(tolerance=1e-10).positions
    answer, _, trace, own = arap.solved_by_igl(scene, handles, truth)
    moved = farthest(truth, scene.vertices)
    assert moved > 1.0 and farthest(answer, truth) < 2e-3 * moved
    assert own[-1] == 0.0 and len(own) == len(trace.error) and trace.error[-1] < 0.01 * trace.error[0]


def test_bytes_of_a_factor_are_those_of_a_dense_one(sphere_head, targets):
    prepared = prepare(facial_scene(sphere_head, Parameters(), targets))
    matrix, _ = prepared.energy.matrix(prepared.scene)
    free = prepared.system.coordinates.groups[0][1]
    lower = np.count_nonzero(np.tril(matrix[free][:, free].toarray()))
    n = len(free)
    assert 12 * lower <= floor.factor_bytes(prepared) <= 12 * n * (n + 1) // 2
    # Per tet 8 B times its parameters, and four corners of 4 B, in blocks.
    assert floor.tet_bytes(prepared) >= len(prepared.scene.tets) * (8 * 9 + 16)


def grown(count: int) -> tuple[float, float]:
    before = held_megabytes()
    block = np.ones(count)
    return peak_megabytes() - before, float(block.sum())


def refused():
    raise InputError("told by the child")


def test_memory_is_seen_in_a_process_of_its_own():
    megabytes, total = apart(grown, 10_000_000)
    assert total == 1e7 and 75.0 < megabytes < 120.0
    with pytest.raises(SoftdecaError, match="told by the child"):
        apart(refused)


def test_pieces_are_compared_on_a_sphere(sphere_head, targets):
    whole = measure_variant(sphere_head, [targets], VARIANTS[WHOLE])
    bare = measure_variant(sphere_head, [targets], VARIANTS["no membrane"])
    for found in (whole, bare):
        assert found["failure"] is None and found["cost"]["iterations"] > 0
    assert farthest(whole["skins"][0], bare["skins"][0]) > 1e-3
    wrong = measure_variant(sphere_head, [targets], Variant({"without": ("bone",)}))
    assert "bone" in wrong["failure"] and wrong["skins"] == []


def test_dynamics_lag_behind_statics(sphere_head, targets):
    row = measure_dynamics(sphere_head, np.stack([sphere_head.skin.vertices, targets]))
    # The first frame after rest goes γ of the way, which is a quarter at most: the rest is left to go.
    assert row["failure"] is None and 0.5 < row["max_mm"] < 5.0 and row["mean_mm"] < row["max_mm"]


@pytest.fixture
def results() -> dict:
    cold = {"scene_seconds": 0.1, "prepare_seconds": 0.2, "solve_seconds": 0.2, "seconds": 0.5, "cpu_seconds": 0.5,
            "iterations": 30, "error_mm": 0.004, "seed": 0}  # fmt: skip
    warm = cold | {"seconds": 0.1, "inverted_tets": 0}
    split = {"iteration": 2.0, "local": 1.0, "solve": 0.5, "rest": 0.5}
    rivals = [(OURS, 0.5), (NEWTON, 5.0), ("PD, plain", 6.0)]
    curves = [curve(name, FACE, 0.1, t) for name, t in rivals]
    curves += [curve(name, ARAP, 0.1, t) for name, t in [*rivals[:2], ("libigl ARAP", 9.0)]]
    cost = {"seconds": 1.0, "cpu_seconds": 1.0, "iterations": 40.0, "megabytes": 80.0}
    level = {"vertices": 1, "converged": True, "iterations": 30, "iteration_ms": 1.0, "peak_mb": 500.0}
    rows = [
        level | {"level": k, "tets": 10 * 4**k, "prepare_seconds": 4.0**k, "solve_seconds": 4.0**k,
                 "megabytes": 4.0**k, "factor_mb": 4.0**k}
        for k in (1, 2, 3)
    ]  # fmt: skip
    return {
        "title": "a simulator <by hand>",
        "parts": list(PARTS),
        "seeds": [0],
        "seconds": {"throughput": 1.0},
        "machine": {"processor": "a CPU", "cores": 2, "load": 0.1, "load_at_end": 1.0, "versions": {"numpy": "1"}},
        "throughput": {
            "cold": [{"kind": "default p", "tolerance": 1e-4, "rows": [cold]}],
            "warm": {"tolerance": 5e-5, "rows": [warm] * 3, "errors_mm": [0.003]},
            "worker_mb": {"loaded": 200.0, "fit": 400.0, "peak": 450.0},
            "floor": {"bandwidth_gb_s": 20.0, "factor_mb": 14.0, "tets_mb": 8.0, "floor_ms": 1.8, "ratio": 1.1,
                      "split_ms": split, "evaluations_per_iteration": 1.1},
        },
        "precision": {"accuracies_mm": list(ACCURACIES), "curves": curves, "medians": medians(curves), "skipped": [],
                      "agreement_mm": {f"{NEWTON}, a": 1e-7}, "handles": 12, "most_of_igl": 9},
        "minimal": {"expressions": ["a", "b"], "rows": [{"piece": "membrane", "kept": cost, "left_out": cost,
                    "mean_mm": 0.1, "max_mm": 1.0, "failure": None}]},
        "scaling": {"expression": "a", "rows": rows, "exponents": scaling.exponents(rows)},
    }  # fmt: skip


def edited(path: str, value):
    def edit(results: dict) -> None:
        *way, last = path.split("/")
        for step in way:
            results = results[int(step) if isinstance(results, list) else step]
        results[int(last) if isinstance(results, list) else last] = value

    return edit


def behind(results: dict) -> None:
    curves = results["precision"]["curves"]
    results["precision"]["medians"] = medians([*curves[:1], curve(NEWTON, FACE, 0.0, 0.1), *curves[2:]])


def test_good_figures_pass_every_gate(results):
    found = gates(results)
    assert found and all(gate["passed"] for gate in found)
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize(
    ("edit", "missed", "count"),
    [
        (edited("throughput/cold/0/rows/0/seconds", 1.01), "slowest, scene to solution|cold frames per core-hour", 2),
        (edited("throughput/cold/0/rows/0/error_mm", 0.011), "cold frame, default p: largest error", 1),
        (edited("throughput/warm/rows/0", {"seconds": 1.0}), "warm frames per core-hour", 1),
        (edited("throughput/warm/errors_mm/0", float("nan")), "warm frame: largest error", 1),
        (edited("throughput/worker_mb/peak", 601.0), "memory of a worker", 1),
        (edited("throughput/floor/ratio", 2.1), "over its floor", 1),
        (behind, "over FEniCSx Newton's", 2),
        (edited("precision/agreement_mm", {f"{NEWTON}, a": 0.02}), "both tight", 1),
        (edited("minimal/rows/0/failure", "it did not converge"), "could not be compared", 1),
        (edited("scaling/rows/2/iterations", None), "did not converge", 1),
    ],
)
def test_a_miss_is_a_miss(results, edit, missed, count):
    edit(results)
    found = [gate["what"] for gate in gates(results) if not gate["passed"]]
    assert len(found) == count and all(re.search(missed, what) for what in found)


def test_a_rival_that_is_not_installed_is_named_and_no_gate(results):
    found = len(gates(results))
    results["precision"]["skipped"] = ["libigl ARAP: libigl is not installed (softdeca[bench])"]
    assert len(gates(results)) == found - 2
    assert "libigl is not installed" in page(results | {"gates": gates(results)})


def test_the_page_stands_alone_and_shows_what_there_is(results):
    text = page(results | {"gates": gates(results)})
    assert "a simulator &lt;by hand&gt;" in text and "All that was asked is reached" in text
    assert not re.search(r"<(script|link|iframe|object)|@import|(src|href)=\"(?!#|data:)", text)
    assert text.count("<svg") == 3 and "membrane" in text and "tets^1.00" in text
    one = {key: value for key, value in results.items() if key not in ("precision", "minimal", "scaling")}
    text = page(one | {"gates": gates(one)})
    assert text.count("<svg") == 1 and "Cold frames" in text and "Growth" not in text
    results["scaling"]["rows"][0]["converged"] = False
    assert "Not reached: levels of the template" in page(results | {"gates": gates(results)})


def test_a_run_writes_results_and_page(results, tmp_path, monkeypatch):
    from softdeca.benchmarks import simulator

    for part in PARTS:
        monkeypatch.setattr(simulator, f"measure_{part}", lambda *_, part=part: results[part])
    told = []
    found = run_simulator(SimulatorConfig(("minimal", "scaling"), tmp_path), lambda text, share: told.append(text))
    assert json.loads((tmp_path / "results.json").read_text()) == found
    assert set(PARTS) & set(found) == {"minimal", "scaling"} and (tmp_path / "index.html").stat().st_size > 5000


@pytest.mark.parametrize("wrong", [{"parts": ("speed",)}, {"parts": ()}, {"frames": 3}, {"seeds": ()}])
def test_a_wrong_configuration_is_refused(wrong):
    with pytest.raises(InputError):
        SimulatorConfig(**wrong)


def test_the_command_tells_gates_and_ends_by_them(results, command, monkeypatch, tmp_path):
    from softdeca.benchmarks import simulator

    monkeypatch.setattr(simulator, "measure_scaling", lambda *_: results["scaling"])
    ended = command("bench", "simulator", "--parts", "scaling", "--out", tmp_path)
    assert ended.status == 0 and "ok   levels of the template at which the solve did not converge: 0" in ended.out
    results["scaling"]["rows"][0]["iterations"] = None
    ended = command("bench", "simulator", "--parts", "scaling", "--out", tmp_path)
    assert ended.status == 1 and "MISS levels" in ended.out
    ended = command("bench", "simulator", "--parts", "speed", "--out", tmp_path)
    assert ended.status != 0 and len(ended.errors) == 1 and "speed" in ended.errors[0]
    assert "there are throughput, precision, minimal, scaling" in ended.errors[0]


def test_newton_ends_where_we_do(sphere_head, targets):
    pytest.importorskip("dolfinx")
    scene = facial_scene(sphere_head, Parameters(), targets)
    truth = prepare(scene).solve(tolerance=1e-10).positions
    found, distance = work_precision._newton(FACE, "a", scene, truth)
    assert distance < 1e-6 and found.row()["seconds_to"][-1] is not None
