"""Differences, gates, and a report that stands alone, on results small enough to be written by hand."""

import base64
import copy
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from softdeca.benchmarks import cases
from softdeca.benchmarks.cases import first_below
from softdeca.benchmarks.differences import difference, distances
from softdeca.benchmarks.gates import gates
from softdeca.benchmarks.report import page
from softdeca.reference import Parameters, prepare

# A PNG of one pixel.
PIXEL = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)
AGREEMENTS = (
    "PD to FEniCSx, same energy",
    "scikit-fem to FEniCSx, PD's energy",
    "scikit-fem to FEniCSx, neo-Hookean",
    "PD to neo-Hookean",
)


def apart(mm: float, relative: float) -> dict:
    return {"mean": mm, "rms": mm, "p95": 2 * mm, "max": 3 * mm, "relative": relative}


def solved(label: str, law: str = "PD") -> dict:
    return {
        "label": label,
        "solver": "projective",
        "energy_law": law,
        "start": "rest",
        "compile_seconds": 2.0,
        "prepare_seconds": 0.1,
        "seconds": 0.3,
        "iterations": 2,
        "done": True,
        "reason": "converged",
        "energy": 1.0,
        "detail": {"factorisations": 1},
        "history": {"time": [0.0, 0.1, 0.3], "energy": [3.0, 2.0, 1.0], "gradient_norm": [1.0, 1e-4, 1e-10]},
        "error_mm": [1.0, 1e-3, 0.0],
    }


def scene(name: str) -> dict:
    spread = {"mean": 0.3, "median": 0.2, "p95": 0.9, "max": 1.5}
    return {
        "name": name,
        "parameters": {"gravity": 1.0},
        "largest_displacement_mm": 20.0,
        "another_minimum_mm": None,
        "runs": [solved("FEniCSx Newton"), solved("PD, accelerated"), solved("FEniCSx Newton", "neo-Hookean")],
        "comparisons": {what: apart(1e-9, 1e-10) for what in AGREEMENTS},
        "skin": {"PD to neo-Hookean": apart(0.25, 0.01), "surrogate to PD": apart(0.1, 0.01)},
        "target_residual_mm": spread,
        "target_residual_lips_mm": spread,
        "smallest_volume_ratio": 0.12,
        "iterations_to_001_mm": {"pd": 10, "plain": 100},
        "points": [{"label": "surrogate", "milliseconds": 0.4, "rms": 0.2}],
    }


METHODS = {
    "network": 0.05,
    "network + simulator at bind": 0.01,
    "linearised simulator": 0.02,
    "blendshapes (T = S)": 0.25,
}


def score(method: str, mean: float) -> dict:
    return {
        "method": method,
        "kind": "all",
        "frames": 100,
        "mean": mean,
        "p95": 3 * mean,
        "largest": 8 * mean,
        "share": mean / 0.25,
        "frame_ms": 0.4,
    }


@pytest.fixture
def results() -> dict:
    return {
        "title": "two scenes <of one head>",
        "identities": "anny",
        "machine": {"processor": "a CPU", "cores": 2, "versions": {"numpy": "1.26.4"}},
        "head": [{"figure": "smallest dihedral", "value": 6.1, "unit": "°", "limit": "at least 2 °"}],
        "cases": [scene("jawOpen"), scene("mouthPucker*0.5+cheekPuff")],
        "tets": 58080,
        "local_step_ms": 6.0,
        "unverified": [],
        "verification": [
            {
                "problem": "bar",
                "solver": "skfem",
                "value": 0.5,
                "reference": 0.5,
                "error": 0.0,
                "bound": 1e-6,
                "passed": True,
            }
        ],
        "surrogate": {
            "people": 10,
            "faces": 20,
            "frames": 100,
            "scores": [score(method, mean) for method, mean in METHODS.items()],
            "network_gain": 5.0,
            "hybrid_gain": 2.0,
            "rejected": [{"identity": 3, "frame": 2, "reason": "inverted tet"}],
            "note": {"frames": 300, "faces": 60, "people": 30},
        },
        "seconds": {"head": 3.0, "scenes": 200.0},
    }


class Links(HTMLParser):
    """What a page would load or lead to, and its text."""

    def __init__(self, text: str):
        super().__init__()
        self.targets: list[str] = []
        self.tags: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.targets += [v for k, v in attributes if k in ("src", "href", "xlink:href", "data", "action", "srcset")]

    def handle_data(self, data):
        self.words.append(data)


def report_of(results: dict) -> str:
    results = results | {"gates": gates(results)}
    return page(results, {"head": PIXEL} | {case["name"]: PIXEL for case in results["cases"]}, "<p>turn it</p>")


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


def test_iterations_are_counted_to_the_first_error_below():
    assert first_below([5.0, 0.02, 0.009, 0.02, 0.001], 0.01) == 2
    assert first_below([5.0, 0.02], 0.01) is None and first_below(None, 0.01) is None


def test_all_gates_are_passed_by_good_results(results):
    found = gates(results)
    assert len(found) == 10 and all(gate["passed"] for gate in found)
    assert sum(gate["answer"] for gate in found) == 8
    ratio = next(gate for gate in found if "iterations" in gate["what"])
    assert ratio["value"] == 0.1
    json.dumps(found, allow_nan=False)


def edited(path: str, value):
    def edit(results: dict) -> None:
        *way, last = path.split("/")
        for step in way:
            results = results[int(step) if isinstance(results, list) else step]
        results[last] = value

    return edit


@pytest.mark.parametrize(
    ("edit", "missed", "answer"),
    [
        (edited(f"cases/1/comparisons/{AGREEMENTS[0]}/relative", 1.1e-6), "PD to FEniCSx-Newton", True),
        (edited(f"cases/0/comparisons/{AGREEMENTS[1]}/relative", 1.1e-8), "PD's energy", True),
        (edited(f"cases/1/comparisons/{AGREEMENTS[2]}/relative", 1.1e-8), "neo-Hookean", True),
        (edited("cases/1/smallest_volume_ratio", -0.01), "smallest volume ratio", True),
        (edited("cases/1/smallest_volume_ratio", 0.0), "smallest volume ratio", True),
        (edited("cases/0/runs/1/done", False), "did not reach what was asked", True),
        (edited("verification/0/passed", False), "verification problems", True),
        (edited("surrogate/network_gain", 4.0), "blendshapes' error over", True),
        (edited("surrogate/network_gain", float("nan")), "blendshapes' error over", True),
        (edited("surrogate/hybrid_gain", 1.0), "the linearised simulator's error over", True),
        (edited(f"cases/1/comparisons/{AGREEMENTS[0]}/relative", float("nan")), "PD to FEniCSx-Newton", True),
        (edited("cases/1/iterations_to_001_mm/pd", 21), "iterations", False),
        (edited("cases/1/iterations_to_001_mm/pd", None), "iterations", False),
        (edited("local_step_ms", 8.5), "local step", False),
    ],
)
def test_a_miss_is_a_miss(results, edit, missed, answer):
    edit(results)
    found = [gate for gate in gates(results) if not gate["passed"]]
    assert len(found) == 1 and missed in found[0]["what"] and found[0]["answer"] is answer


def test_the_report_stands_alone_and_holds_every_scene(results):
    text = report_of(results)
    links = Links(text)
    assert links.targets and all(target.startswith(("data:", "#")) for target in links.targets)
    assert not {"script", "link", "object"} & set(links.tags)
    # The head in 3D is a page within the page, not a file beside it.
    assert links.tags.count("iframe") == 1 and 'srcdoc="&lt;p&gt;turn it' in text
    assert "@import" not in text and not re.search(r"url\((?!#|\"#|'#)", text)
    assert text.count(base64.b64encode(PIXEL).decode()) == 3
    words = " ".join(links.words)
    for case in results["cases"]:
        assert case["name"] in words
    assert "two scenes <of one head>" in words
    assert "On 10 people that training has not seen" in words and "identity 3, frame 2 (inverted tet)" in words
    assert "Not reached" not in words and "NO" not in words.split()


def test_the_report_marks_what_was_missed(results):
    good = report_of(copy.deepcopy(results))
    results["surrogate"]["network_gain"] = 1.5
    results["cases"][1]["runs"][0]["done"] = False
    text = report_of(results)
    assert good.count("<span class=no>") == 0
    # Two gates, and the run itself in the table of solvers.
    assert text.count("<span class=no>NO</span>") == 3
    words = " ".join(Links(text).words)
    assert "Not reached: solver runs that did not reach what was asked; blendshapes' error over" in words


def test_compilation_is_no_time_of_a_case_s_solvers(sphere_head, monkeypatch):
    """Preparation and compilation are those that the solution knows; another 50 s of the latter change nothing else."""
    pytest.importorskip("dolfinx")
    head = replace(sphere_head, regions={"lips": np.arange(len(sphere_head.bone)) < 5})
    case = cases.Case("none", np.zeros(52), Parameters(gravity=3.0))
    compiled = []

    class SlowlyCompiled:
        def __init__(self, prepared):
            self.prepared = prepared

        def solve(self, **asked):
            solution = self.prepared.solve(**asked)
            compiled.append(50.0 + solution.times.compilation)
            return replace(solution, times=replace(solution.times, compilation=compiled[-1]))

    monkeypatch.setattr(cases, "prepare", lambda scene, **options: SlowlyCompiled(prepare(scene, **options)))
    runs = cases.run_case(head, case, head.skin.vertices, lambda _: None).record["runs"]
    assert [run["compile_seconds"] for run in runs] == compiled and len(runs) == 6
    assert 0.0 < sum(run["prepare_seconds"] + run["seconds"] for run in runs) < 50.0


def test_where_fenicsx_ends_in_another_minimum_it_is_started_at_the_answer_it_checks(sphere_head, monkeypatch):
    pytest.importorskip("dolfinx")
    head = replace(sphere_head, regions={"lips": np.arange(len(sphere_head.bone)) < 5})
    case = cases.Case("none", np.zeros(52), Parameters(gravity=3.0))
    run, starts = cases._run, []

    def elsewhere(label, law, scene, how):
        solution, row = run(label, law, scene, how)
        if (how.solver, law) == ("fenicsx", cases.PD_ENERGY):
            starts.append(row["start"])
            if how.start is None:
                solution = replace(solution, positions=solution.positions + [0.0, 0.5, 0.0])
        return solution, row

    monkeypatch.setattr(cases, "_run", elsewhere)
    record = cases.run_case(head, case, head.skin.vertices, lambda _: None).record
    assert starts == ["rest", "PD's answer"]
    assert record["another_minimum_mm"] == pytest.approx(0.5, rel=1e-3)
    assert record["comparisons"]["PD to FEniCSx, same energy"]["relative"] < 1e-6
    assert [row["start"] for row in record["runs"]][:3] == ["rest", "rest", "PD's answer"]


def test_a_second_minimum_stands_in_the_report(results):
    assert "two minima" not in report_of(results)
    edited("cases/0/another_minimum_mm", 0.226)(results)
    assert "jawOpen has two minima of PD's energy: FEniCSx from rest ends 0.23 mm" in report_of(results)
