"""The runner of studies: failures are rows, what is done is kept, and two results are compared beside their noise."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from softdeca.benchmarks.harness import RunRequest, processes, run, run_together, runner
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
