"""The runner of studies: failures are rows, what is done is kept, and two results are compared beside their noise."""

import ast
import inspect
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import fields, is_dataclass

import pytest

from softdeca.benchmarks.harness import RunRequest, Task, compare_results, processes, run, run_together, runner
from softdeca.benchmarks.harness.processes import Job
from softdeca.benchmarks.harness.results import read_results
from softdeca.benchmarks.studies import STUDIES, load_study
from softdeca.cli import animate, bench, corpus, head, head_files, study, train_regressor
from softdeca.cli.study_command import RunOptions, command_of_study
from softdeca.lhm import InputError

from ..conftest import measure_here

# Another process has to import what it measures.
TOYS = """
import os
import time
from dataclasses import dataclass
from pathlib import Path

from softdeca.benchmarks.harness.study import at_most
from softdeca.benchmarks.harness import Column, Study, Task, option
from softdeca.lhm.base.errors import InputError, MissingDependencyError
from softdeca.lhm.base.limits import Bound


@dataclass(frozen=True)
class Toy(Study):
    name = "toy"
    question = "What is twice a number?"
    columns = (Column("twice", "twice"), Column("times", "time [ms]", cost=True))
    limit = 20.0

    folder: str = ""
    cases: tuple[str, ...] = ("1", "2")

    def tasks(self):
        return [Task(case, "doubling") for case in self.cases]

    def measure(self, task):
        with open(Path(self.folder) / "calls", "a") as file:
            file.write(task.case + "\\n")
        if task.case == "bad":
            raise InputError("case: must be a number")
        if task.case == "bug":
            raise ZeroDivisionError("a defect of ours")
        if task.case == "dead":
            os._exit(7)
        if task.case == "slow":
            time.sleep(600)
        if task.case == "missing":
            raise MissingDependencyError("needs what is not there")
        if task.case == "nan":
            return {"twice": float("nan"), "times": [1.0]}
        return {"twice": 2.0 * float(task.case), "times": [1.0, 1.1, 0.9]}

    def gates(self, rows):
        return [at_most("the largest", max(row.values["twice"] for row in rows), 4.0)]

    def words(self, rows):
        return f"{len(rows)} numbers were doubled."


@dataclass(frozen=True)
class Impatient(Toy):
    limit = 0.5


@dataclass(frozen=True)
class Apart(Toy):
    alone = True


@dataclass(frozen=True)
class Levelled(Toy):
    level: int = option(1, "of a game")
    people: int = option(5, "who may be nobody")
    count: int = option(3, "of coins", bound=Bound("coins", 9, "a purse is small", 2))
"""


@pytest.fixture
def toys(tmp_path, monkeypatch):
    (tmp_path / "toy_studies.py").write_text(TOYS)
    monkeypatch.syspath_prepend(tmp_path)
    import toy_studies

    yield toy_studies
    del sys.modules["toy_studies"]


def calls(folder):
    return (folder / "calls").read_text().split()


def test_rows_come_in_the_order_of_tasks_and_are_kept(toys, tmp_path, monkeypatch):
    study = toys.Toy(folder=str(tmp_path))
    results = run(study, tmp_path / "out", workers=2)
    assert [(row.case, row.values["twice"]) for row in results.rows] == [("1", 2.0), ("2", 4.0)]
    assert results.passed and results.words == "2 numbers were doubled."
    assert json.loads((tmp_path / "out" / "results.json").read_text())["rows"][0]["values"]["twice"] == 2.0
    measure_here(monkeypatch)
    again = run(study, tmp_path / "out")
    assert again.rows == results.rows and sorted(calls(tmp_path)) == ["1", "2"]
    # A row torn by a kill is done again, the other is not.
    rows = tmp_path / "out" / "rows.jsonl"
    lines = rows.read_text().splitlines()
    rows.write_text(lines[0] + "\n" + lines[1][:40])
    assert run(study, tmp_path / "out").passed and len(calls(tmp_path)) == 3
    # Rows of another version of the study are measured anew.
    monkeypatch.setattr(toys.Toy, "version", 2)
    assert run(study, tmp_path / "out").passed and len(calls(tmp_path)) == 5
    monkeypatch.setattr(toys.Toy, "version", 1)
    # Another question is not answered by these rows.
    other = toys.Toy(folder=str(tmp_path), cases=("1", "2", "2.0"))
    assert len(run(other, tmp_path / "out").rows) == 3 and len(calls(tmp_path)) == 8


def test_what_fails_is_a_row_with_its_reason_and_the_rest_is_complete(toys, tmp_path):
    study = toys.Toy(folder=str(tmp_path), cases=("1", "bad", "bug", "dead", "nan", "missing", "2"))
    results = run(study, tmp_path / "out", workers=1)
    assert {row.case: (row.status, row.reason) for row in results.rows} == {
        "1": ("done", ""),
        "bad": ("failed", "case: must be a number"),
        "bug": ("failed", "ZeroDivisionError: a defect of ours"),
        "dead": ("failed", "its process died"),
        "nan": ("failed", "not finite: twice"),
        "missing": ("skipped", "needs what is not there"),
        "2": ("done", ""),
    }
    assert not results.passed and results.gates[0]["value"] == 4 and results.gates[1]["passed"]
    text = (tmp_path / "out" / "index.html").read_text()
    assert "its process died" in text and "a defect of ours" in text and "NaN" not in text
    before = len(calls(tmp_path))
    run(study, tmp_path / "out")
    assert sorted(calls(tmp_path)[before:]) == sorted(["bad", "bug", "dead", "nan", "missing"])


def test_what_takes_too_long_is_ended(toys, tmp_path):
    results = run(toys.Impatient(folder=str(tmp_path), cases=("slow", "missing")), tmp_path / "out", workers=1)
    assert results.rows[0].reason == "ended after 0.5 s" and not results.passed
    assert results.words == "Nothing could be measured."


def test_a_process_of_its_own_tells_its_memory(toys, tmp_path):
    rows = run(toys.Apart(folder=str(tmp_path)), tmp_path / "out", match="1").rows
    assert len(rows) == 1 and 20 < rows[0].memory_mb < 2000
    with pytest.raises(InputError, match="toy: no case and method matches 'nothing'"):
        run(toys.Apart(folder=str(tmp_path)), tmp_path / "out", match="nothing")


STARTED = """
import sys
from pathlib import Path
from softdeca.benchmarks.harness import run
folder = Path(sys.argv[1])
sys.path.insert(0, str(folder))
from toy_studies import Toy
run(
    Toy(folder=str(folder), cases=("1", "slow")), folder / "out", workers=2,
    progress=lambda what, share: print(what, file=sys.stderr, flush=True),
)
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_study_goes_on_and_leaves_no_worker(toys, tmp_path, how):
    """Ctrl-C goes to all processes of a terminal; a kill goes to one, and the workers have to notice."""
    arguments = [sys.executable, "-c", STARTED, tmp_path]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        for line in process.stderr:
            if line.startswith("toy: 1"):
                break
        (os.killpg if how == signal.SIGINT else os.kill)(process.pid, how)
        process.stderr.read()
        process.wait(60)
    assert process.returncode == -how
    for _ in range(100):
        if not is_alive(process.pid):
            break
        time.sleep(0.1)
    assert not is_alive(process.pid), "a worker outlived its parent"
    (row,) = [json.loads(line) for line in (tmp_path / "out" / "rows.jsonl").read_text().splitlines()]
    assert row["case"] == "1" and not (tmp_path / "out" / "results.json").exists()
    again = run(toys.Toy(folder=str(tmp_path), cases=("1", "slow")), tmp_path / "out", match="1", workers=1)
    assert again.rows[0].seconds == row["seconds"] and calls(tmp_path).count("1") == 1


def is_alive(group):
    """Whether a process of the group is left that is not a zombie."""
    found = subprocess.run(["ps", "-eo", "pgid=,stat="], capture_output=True, text=True, check=True).stdout
    return any(line.split()[0] == str(group) and line.split()[1][0] != "Z" for line in found.splitlines())


def results_file(path, rows):
    rows = [
        {"case": case, "method": "m", "status": "done" if times else "failed", "values": {"times": times, "error": 1.0}}
        for case, times in rows.items()
    ]
    path.write_text(json.dumps({"study": "toy", "rows": rows}))
    return path


def test_answers_are_compared_but_for_rounding(toys, tmp_path):
    def written(name, values, reached):
        rows = [
            {"case": str(k), "method": "m", "status": "done", "values": {"twice": value, "times": [1.0]}}
            for k, value in enumerate(values)
        ]
        gates = [{"what": "small", "passed": reached}, {"what": "quick", "passed": not reached}]
        (tmp_path / name).write_text(json.dumps({"study": "toy", "rows": rows, "gates": gates}))
        return tmp_path / name

    before = written("a.json", [100.0, 1e-9, 50.0, "right", None, True], True)
    after = written("b.json", [101.0, 2e-2, 55.0, "wrong", 1.0, False], False)
    found = compare_results(before, after, toys.Toy)
    told = {change.task: change.share for change in found.changes if change.is_beyond_noise}
    assert set(told) == {"2, m"} and told["2, m"] == pytest.approx(0.1)
    assert found.broken == ["small: reached before, not after"]
    assert found.other == ["quick: not reached before, but after", "3, m, twice: right before, wrong after"]
    assert not any(change.is_beyond_noise for change in compare_results(before, before, toys.Toy).changes)


DAMAGED = {
    "[]": "an object with the name of its study",
    '{"study": "toy"}': "rows: expected a list, got None",
    '{"study": "toy", "rows": [3]}': "row 0: expected an object, got 3",
    '{"study": "toy", "rows": [{"case": "a", "method": "m", "status": "done", "values": null}]}': "row 0, values: got",
    '{"study": "toy", "rows": [{"case": "a", "method": "m", "status": "gone", "values": {}}]}': "row 0, status: gone",
    '{"study": "toy", "rows": [], "gates": [{"what": "x", "passed": 1}]}': "gate 0, passed: got 1",
    '{"study": "toy", "rows": [NaN]}': "NaN is no finite number",
    "[" * 100_000: "levels of brackets",
}


@pytest.mark.parametrize("text", DAMAGED, ids=lambda text: text[:40])
def test_a_damaged_results_file_is_named_with_the_place(tmp_path, text):
    (tmp_path / "results.json").write_text(text)
    with pytest.raises(InputError, match="results.json: no results of a study") as refused:
        read_results(tmp_path)
    assert DAMAGED[text] in str(refused.value)


def test_values_that_a_study_cannot_read_are_named(toys, tmp_path):
    before = results_file(tmp_path / "a.json", {"x": [1.0]})
    rows = [{"case": "x", "method": "m", "status": "done", "values": {"rows": 3}}]
    (tmp_path / "b.json").write_text(json.dumps({"study": "toy", "rows": rows}))
    with pytest.raises(InputError, match="results damaged, or made by another version"):
        compare_results(before, tmp_path / "b.json", toys.Toy)


def test_the_command_makes_its_options_of_the_studys_fields(command, tmp_path):
    words = ("bench", "verification", "two layers", "--solver", "skfem", "--out", tmp_path)
    ended = command(*words)
    assert ended.status == 0 and ended.errors == []
    assert "4 of 4 values by skfem are within their bounds." in ended.out
    said = json.loads(command(*words, "--json").out)
    assert said["options"] == {"solvers": ["skfem"], "fine": False} and len(said["rows"]) == 4
    same = command("bench", "compare", tmp_path, tmp_path / "results.json")
    assert same.status == 0
    assert same.out == "16 of 16 answers are the same within noise\n4 of 4 costs are the same within noise\n"
    assert "verification" in command("bench", "list").out


GIVEN = {
    "bench agreement --level 1 --seed 0 --case zombie": {"level": 1, "seed": 0, "cases": ("zombie",)},
    "bench heads --gallery 0 --count 1000 --seed 0": {"gallery": 0, "count": 1000, "seed": 0},
    "bench dial --faces 6": {"seed": 7000, "faces": 6},
    "bench table-1 --external ''": {"external": "", "hours": 1.0},
    "bench work-precision --slow": {"slow": True, "repeats": 5, "seed": 0},
    "bench dial --faces 20 --faces 30": {"faces": 30},
    "evaluate corpus --external ''": {"corpus": "corpus", "external": ""},
}  # fmt: skip


@pytest.mark.parametrize("words", GIVEN)
def test_an_option_that_is_given_counts_whatever_its_value(command, monkeypatch, tmp_path, words):
    asked = []
    monkeypatch.setattr(RunOptions, "run_study", lambda self, study, folder, **_: asked.append(study) or 0)
    monkeypatch.chdir(tmp_path)
    assert command(*shlex.split(words)).status == 0
    (study,) = asked
    assert {name: getattr(study, name) for name in GIVEN[words]} == GIVEN[words]


def list_kinds():
    """All commands of dataclasses and all studies, by name."""
    found = {f"bench {name}": load_study(name) for name in STUDIES}
    for module in (animate, bench, corpus, head, head_files, study, train_regressor):
        own = (each for each in vars(module).values() if isinstance(each, type) and is_dataclass(each))
        found |= {f"{module.__name__} {each.__name__}": each for each in own if each.__module__ == module.__name__}
    return found | {"every study": RunOptions}


@pytest.mark.parametrize(("name", "kind"), list_kinds().items())
def test_every_option_is_read(name, kind):
    """A field that no code of its class or module takes up would be an option that does nothing."""
    modules = {sys.modules[each.__module__] for each in kind.__mro__ if each.__module__.startswith("softdeca")}
    nodes = [node for module in modules for node in ast.walk(ast.parse(inspect.getsource(module)))]
    read = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    read |= {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    assert not {field.name for field in fields(kind)} - read


def test_a_study_has_no_level_where_each_mesh_has_its_own():
    assert "level" not in {field.name for field in fields(load_study("unknowns"))}


def test_bounds_are_those_of_the_study_not_of_a_name(toys):
    named = {p.name: p.type for p in command_of_study(toys.Levelled).params}
    assert named["level"].convert(70, None, None) == 70 and named["people"].convert(0, None, None) == 0
    assert (named["count"].min, named["count"].max) == (2, 9)
    whose = {p.name: p.type for p in command_of_study(load_study("dial")).params}
    assert whose["faces"].max == 1000 and "level" not in whose


def test_no_study_has_an_option_twice():
    for name in STUDIES:
        options = [option for parameter in command_of_study(load_study(name)).params for option in parameter.opts]
        assert len(options) == len(set(options)), name
    assert "--processes" in [
        option for parameter in command_of_study(load_study("ranks")).params for option in parameter.opts
    ]


def test_a_process_goes_on_with_its_case(toys, tmp_path):
    """What it has kept of a case serves the rest of it; another begins with a case of its own."""
    lane = processes._Lane()
    jobs = [Job(toys.Toy(), Task(case, method)) for case in "123" for method in "ab"]
    ones, twos = ("toy", "1"), ("toy", "2")
    assert lane.choose(jobs, {ones}) == jobs[2]
    lane.job = jobs[4]
    assert lane.choose(jobs, {ones, twos}) == jobs[4] and lane.choose(jobs[:4], {ones, twos}) == jobs[0]


def test_studies_together_are_one_after_another_where_one_is_timed_and_one_that_cannot_be_run_is_told(
    toys, tmp_path, monkeypatch
):
    lanes_used = []

    def seen(jobs, count):
        lanes_used.append(count)
        return processes.measure_jobs(jobs, count)

    monkeypatch.setattr(runner, "measure_jobs", seen)
    good, more = (toys.Toy(folder=str(tmp_path), cases=(case,)) for case in "12")
    asked = [
        RunRequest(good, tmp_path / "a"),
        RunRequest(good, tmp_path / "b", "no such"),
        RunRequest(more, tmp_path / "c"),
    ]
    first, second, third = run_together(asked, workers=2)
    assert [row.values["twice"] for row in (*first.rows, *third.rows)] == [2.0, 4.0]
    assert isinstance(second, InputError) and "no such" in str(second) and not (tmp_path / "b").exists()
    assert all((tmp_path / name / "index.html").is_file() for name in "ac")
    monkeypatch.setattr(toys.Toy, "timed", True)
    again = run_together(asked[::2], workers=2)
    assert [each.rows for each in again] == [first.rows, third.rows] and lanes_used == [2, 1]
