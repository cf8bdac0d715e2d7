#!/usr/bin/env python3
"""The results that benchmarks/results keeps: how each is made again, whether it is stale, and whether it holds.

`python tools/kept.py keep [NAMES]` makes results again, by default all that are stale or of other code, stale ones
first. Each has a process of its own, and is written when it is done, whatever its gates say. An interrupted run
resumes: rows lie in out/keep/COMMIT. The tree has to be clean. Exit status 1 if a result could not be made. `list` says
what is stale and why. `check` measures a cheap part of each anew, some ten minutes of one core, and says which answers
moved; seconds are not compared. Results without a cheap part are judged by what decides them. Exit status 1 if a result
is stale or moved.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from softdeca.benchmarks.harness import Results, run
from softdeca.benchmarks.harness.inputs import find_inputs
from softdeca.benchmarks.harness.results import find_middle, is_number, read_results, refuse_other_versions
from softdeca.benchmarks.harness.study import Study
from softdeca.benchmarks.studies import load_study
from softdeca.cli.terminal import show_progress
from softdeca.lhm.base import provenance
from softdeca.lhm.base.errors import InputError, SoftdecaError, quote
from softdeca.lhm.base.files.atomic import write_whole
from softdeca.lhm.base.progress import OnProgress, describe_duration, silent
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.people import people_from_text
from softdeca.surrogate.corpus.plan import PRESETS, CorpusPlan
from softdeca.surrogate.corpus.schedule import count_processors, make_schedule

RESULTS = Path(__file__).resolve().parents[1] / "benchmarks" / "results"
DATA = Path(os.environ.get("SOFTDECA_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
"""Folder of other people's heads."""
ICT = "ict_facekit.npz"
LEVEL = 2
"""Level of the template of corpora's people."""


@dataclass(frozen=True)
class KeptCorpus:
    """A corpus that kept results are measured on: its plan, and whose people (`people_from_text`)."""

    plan: CorpusPlan
    identities: str = "anny"

    def generate(self, folder: Path, progress: OnProgress) -> None:
        """Simulate what a folder lacks of it."""
        people = people_from_text(self.identities, level=LEVEL, on_progress=progress)
        corpus = Corpus.from_plan(folder, self.plan, people, {"identities": self.identities, "level": LEVEL})
        corpus.generate(on=make_schedule(count_processors()), on_progress=progress)


@dataclass(frozen=True)
class Kept:
    """A kept result: a study by its name, options that are not its defaults, and PART of its rows where not all.

    Options name corpora (`CORPORA`) and files (of DATA) as they lie in the folder of the run.
    """

    study: str
    options: Mapping[str, Any] = field(default_factory=dict)
    part: str = ""
    corpora: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    def make_study(self) -> Study:
        """Make the study."""
        return load_study(self.study)(**self.options)


CORPORA: Mapping[str, KeptCorpus] = {
    **{name: KeptCorpus(PRESETS[name]) for name in ("study", "fresh", "moving")},
    "external": KeptCorpus(PRESETS["external"], f"external:ict:{ICT}"),
}
KEPT: Mapping[str, Kept] = {
    "agreement": Kept("agreement"),
    "arena": Kept("arena"),
    "contact": Kept("contact"),
    "dial": Kept("dial", {"faces": 4, "external": f"ict:{ICT}"}, files=(ICT,)),
    "face-benchmark": Kept("face-benchmark"),
    "faces": Kept("faces", {"converged": 6}),
    "hard": Kept("hard"),
    "heads": Kept("heads", {"count": 200}),
    "material": Kept("material"),
    "mesh": Kept("mesh", {"people": 10, "expressions": ()}),
    "minimal": Kept("minimal"),
    "ranks": Kept("ranks", {"processes": (1, 2)}),
    "split": Kept("split"),
    "throughput": Kept("throughput"),
    "unknowns": Kept("unknowns"),
    "verification": Kept("verification"),
    "work-precision": Kept("work-precision"),
    "further/unknowns-640000": Kept("unknowns", {"up_to": 640_000}, part="level 3, 5 sub-layers, P1, FEniCSx, neo"),
    "surrogate/study": Kept("surrogate", {"corpus": "study", "people": "all"}, corpora=("study",)),
    "surrogate/fresh": Kept("surrogate", {"corpus": "fresh", "people": "all"}, corpora=("fresh",)),
    "surrogate/moving": Kept(
        "surrogate",
        {"corpus": "moving", "people": "all", "external": "external"},
        corpora=("moving", "external"),
        files=(ICT,),
    ),
}
"""Kept results that `keep` makes again, by the name of their file."""
SINGLE: Mapping[str, str] = {
    "surrogate/table-1": "its corpus and its trainings take hours",
    "surrogate/corpus": "its corpus takes an hour",
    "surrogate/curve": "its trainings take half an hour, and their corpora two hours",
    "further/corotated": "its study is no more",
    "further/scaling": "its study is no more",
    "further/timing": "its study is no more",
}
"""Kept results that stay with the commit that they name, and why."""


@dataclass(frozen=True)
class State:
    """A kept result as it lies there: why it is stale, the commits that measured it, and seconds of its rows.

    `stale`: in words, what differs today; empty where nothing does. `single`: why it stays with its own commit, where
    it does; such a one is not stale. `seconds` are of a processor where that was measured, since other work lengthens
    those of a clock.
    """

    name: str
    stale: tuple[str, ...] = ()
    single: str = ""
    commits: tuple[str, ...] = ()
    seconds: float | None = None


def find_path(name: str) -> Path:
    """Give the file of a kept result."""
    return RESULTS / f"{name}.json"


def judge(name: str) -> State:
    """Compare what decided a kept result with what decides it today. InputError for a name that there is not."""
    if name in SINGLE:
        return State(name, single=SINGLE[name])
    study = _find(name).make_study()
    if not find_path(name).is_file():
        return State(name, ("it is not there",))
    try:
        content = read_results(find_path(name))
    except InputError:
        return State(name, ("it is of a form that is no more",))
    asked, said, today = _write_options(study), content.get("decided_by"), find_inputs(study)
    stale = [key for key in asked if content["options"].get(key) != asked[key]]
    if said is None:
        stale.append("it does not say what decided it")
    else:
        stale += [key for key in today if said.get(key) != today[key]]
    stale += list_missing(content)
    seconds = sum(row.get("cpu") or row.get("seconds", 0.0) for row in content["rows"])
    commits = provenance.list_commits(content["machine"], content["rows"])
    return State(name, tuple(stale), "", tuple(commits), seconds)


def order_for_keeping(commit: str) -> list[State]:
    """List what `keep` has to make again at a commit: what is stale first, then what another commit measured."""
    states = [judge(name) for name in KEPT]
    stale = [state for state in states if state.stale]
    return stale + [state for state in states if not state.stale and state.commits != (commit,)]


def estimate_seconds(states: Sequence[State]) -> float:
    """Estimate the time [s] on this machine by what rows took last; rows of studies that compare none share it."""
    shares = {state.name: 1 if _find(state.name).make_study().timed else count_processors() for state in states}
    return sum((state.seconds or 0.0) / shares[state.name] for state in states)


def read_clean_commit() -> str:
    """Read the commit of the code. InputError where no commit holds all of it, since no result of it is kept."""
    commit = provenance.read_commit()
    if " " in commit or provenance.is_dirty(commit):
        raise InputError(f"results are kept of a clean tree, whose commit is known; this is {commit}")
    return commit


def keep(name: str, work: Path, progress: OnProgress = silent) -> Results:
    """Run the study of a kept result in WORK/COMMIT, where rows and corpora are kept, and write the result's file.

    Raises InputError for code that no commit holds, now or at the end, a file that DATA lacks, and a run that
    would lose rows of the kept result.
    """
    kept, commit = _find(name), read_clean_commit()
    folder = work / commit
    with _inside(folder):
        _link_files(name, kept)
        for corpus in kept.corpora:
            CORPORA[corpus].generate(Path(corpus), progress)
        out = Path(name)
        results = run(kept.make_study(), out, match=kept.part, progress=progress)
        content = (out / "results.json").read_bytes()
    provenance.read_commit.cache_clear()
    if read_clean_commit() != commit:
        raise InputError(f"{name}: the code changed while it was measured; run it again")
    _refuse_loss(name, results)
    write_whole(find_path(name), content)
    return results


@dataclass(frozen=True)
class Check:
    """Findings of a cheap part of a kept result, measured anew: changes in words, or why nothing was measured."""

    state: State
    moved: tuple[str, ...] = ()
    unmeasured: str = ""

    @property
    def holds(self) -> bool:
        """Whether nothing that decides it differs, and no answer moved."""
        return not self.state.stale and not self.moved


def check(name: str, progress: OnProgress = silent) -> Check:
    """Measure the cheap part of a kept result anew, if it has one, and compare its answers; no seconds.

    Raises InputError for a name that there is not.
    """
    state = judge(name)
    if state.single or state.seconds is None:
        return Check(state, unmeasured=state.single or ", ".join(state.stale))
    kept = _find(name)
    study = kept.make_study()
    if kept.part or not study.cheap:
        return Check(state, unmeasured="no part of it is cheap")
    with TemporaryDirectory() as folder, _inside(Path(folder)):
        try:
            _link_files(name, kept)
        except InputError as error:
            return Check(state, unmeasured=str(error))
        run(study, Path("anew"), workers=1, match=study.cheap, progress=progress)
        moved = find_moved(read_results(find_path(name)), read_results(Path("anew")), type(study))
    return Check(state, tuple(moved))


UNSEEN = 1e-5
"""In the units of all columns, as mm: what moves by less is rounding, such as the distance of two converged answers."""


def list_missing(results: Any) -> list[str]:
    """Name what a results file lacks for its figures to be made again, of its content as read from JSON.

    It has to say machine, versions, the options (or plan) with its seeds, and a commit, which holds all code.
    """
    if not isinstance(results, Mapping):
        return ["machine", "commit", "versions", "options"]
    if results and all(isinstance(each, Mapping) and "study" in each for each in results.values()):
        return sorted({missing for each in results.values() for missing in list_missing(each)})  # a report of studies
    machine = results.get("machine") or {}
    missing = [] if machine.get("processor") and machine.get("cores") else ["machine"]
    commits = provenance.list_commits(machine, results.get("rows", ()))
    missing += ["commit"] if any(not commit or " " in commit for commit in commits) else []
    missing += ["clean tree"] if any(map(provenance.is_dirty, commits)) else []
    missing += [] if machine.get("versions") else ["versions"]
    return missing + ([] if "options" in results or "plan" in results else ["options"])


def find_moved(kept: Mapping[str, Any], anew: Mapping[str, Any], kind: type[Study]) -> list[str]:
    """Name the answers of rows measured anew that differ from the kept ones by more than the study allows, in words.

    Both are contents of results files. Of a row's many lines the first that moved is told, and how many more did. A row
    that is not done anew, that `kept` lacks, or that has another number of lines has moved.
    """
    moved: list[str] = []
    rows = {(row["case"], row["method"]): row for row in kept["rows"] if row["status"] == "done"}
    answers = [column for column in kind.columns if not column.cost]
    with refuse_other_versions(f"results of {kind.name}"):
        for row in anew["rows"]:
            task = f"{row['case']}, {row['method']}"
            before = rows.get((row["case"], row["method"]))
            if before is None:
                moved.append(f"{task}: not among the kept rows")
                continue
            if row["status"] != "done":
                moved.append(f"{task}: {row['status']}, {row['reason']}")
                continue
            old_lines, new_lines = kind.lines(before["values"]), kind.lines(row["values"])
            if len(old_lines) != len(new_lines):
                moved.append(f"{task}: {len(old_lines)} -> {len(new_lines)} lines")
            pairs = list(zip(old_lines, new_lines, strict=False))
            for column in answers:
                values = [(old.get(column.key), new.get(column.key)) for old, new in pairs]
                apart = [(a, b) for a, b in values if not _is_same(a, b, kind.allowed)]
                if apart:
                    (a, b), more = apart[0], f", and {len(apart) - 1} more lines" if len(apart) > 1 else ""
                    moved.append(f"{task}, {column.title}: {_shorten(a)} -> {_shorten(b)}{more}")
    return moved


def _is_same(a: Any, b: Any, share: float) -> bool:
    """Whether two values of an answer are one but for a share of them, or rounding."""
    if is_number(a) and is_number(b):
        middle, middle_after = find_middle(a)[0], find_middle(b)[0]
        return abs(middle_after - middle) <= max(share * abs(middle), UNSEEN)
    return bool(a == b)


def _shorten(value: Any) -> str:
    return f"{find_middle(value)[0]:.6g}" if is_number(value) else str(value)


def _find(name: str) -> Kept:
    if not RESULTS.is_dir():
        raise InputError("kept results lie in a checkout of softdeca, which this is not")
    if name not in KEPT:
        raise InputError(f"kept result {quote(name)!r}: there are {', '.join(KEPT)}")
    return KEPT[name]


def _write_options(study: Study) -> dict[str, Any]:
    """A study's options as a results file has them."""
    options: dict[str, Any] = json.loads(json.dumps(asdict(study)))  # type: ignore[call-overload]  # a dataclass
    return options


def _refuse_loss(name: str, results: Results) -> None:
    """Refuse results that lack rows which the kept file has."""
    if not find_path(name).is_file():
        return
    rows: Sequence[Mapping[str, Any]] = json.loads(find_path(name).read_text()).get("rows", [])
    done = {(row["case"], row["method"]) for row in rows if row["status"] == "done"}
    lost = [row for row in results.rows if row.status != "done" and (row.case, row.method) in done]
    if lost:
        first = lost[0]
        raise InputError(f"{name}: not kept, since {len(lost)} rows that it has were {first.status}: {first.reason}")


def _link_files(name: str, kept: Kept) -> None:
    """Let files of DATA lie in this folder."""
    for file in kept.files:
        if not (DATA / file).is_file():
            raise InputError(f"{name}: {file} is not in {DATA}, nor does $SOFTDECA_DATA name a folder with it")
        if not Path(file).exists():
            Path(file).symlink_to((DATA / file).resolve())


@contextmanager
def _inside(folder: Path) -> Iterator[None]:
    """Work in a folder, where options name files and corpora by their bare names, so that results are portable."""
    before = Path.cwd()
    folder.mkdir(parents=True, exist_ok=True)
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def describe_state(state: State) -> str:
    """Write a line on a kept result: whether it is stale, the time of its rows, and why."""
    took = "" if state.seconds is None else describe_duration(state.seconds)
    word = "single" if state.single else "stale" if state.stale else "current"
    return f"{word:<8} {state.name:<24} {took:>10}  {state.single or ', '.join(state.stale)}".rstrip()


def list_all(names: Sequence[str]) -> int:
    """Print what is stale and why, and the time that each took last."""
    states = [judge(name) for name in names or (*KEPT, *SINGLE)]
    for state in states:
        print(describe_state(state))
    stale = [state for state in states if state.stale]
    cost = describe_duration(estimate_seconds(stale))
    print(f"{len(stale)} of {len(states)} are stale; they took {cost} last, without corpora")
    return 0


def keep_all(names: Sequence[str]) -> int:
    """Keep one result here, or each in a process of its own."""
    if len(names) == 1:
        with show_progress() as progress:
            results = keep(names[0], Path("out/keep"), progress)
        failed = sum(row.status == "failed" for row in results.rows)
        missed = sum(not gate["passed"] for gate in results.gates)
        print(f"{len(results.rows)} rows, {failed} of them failed; {missed} of {len(results.gates)} gates missed")
        return 0
    commit = read_clean_commit()
    failures = []
    for name in names or [state.name for state in order_for_keeping(commit)]:
        before = time.monotonic()
        if subprocess.run([sys.executable, __file__, "keep", name], check=False).returncode:
            failures.append(name)
        print(f"{name}: {describe_duration(time.monotonic() - before)}", flush=True)
    if failures:
        print(f"FAILED {', '.join(failures)}")
    return 1 if failures else 0


def check_all(names: Sequence[str]) -> int:
    """Check results, and print which are stale or moved."""
    faults = 0
    for name in names or (*KEPT, *SINGLE):
        with show_progress() as progress:
            checked = check(name, progress)
        print(describe_state(checked.state))
        if checked.unmeasured and not checked.state.single:
            print(f"         judged by digests alone: {checked.unmeasured}")
        for line in checked.moved:
            print(f"MOVED    {line}")
        faults += not checked.holds
    print(f"{faults} kept results are stale or moved" if faults else "every kept result holds")
    return 1 if faults else 0


def main() -> int:
    """Keep, list or check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = {"keep": keep_all, "list": list_all, "check": check_all}
    parser.add_argument("command", choices=commands)
    parser.add_argument("names", nargs="*", metavar="NAMES", help="results by name, default: all")
    asked = parser.parse_args()
    try:
        return commands[asked.command](asked.names)
    except SoftdecaError as error:
        print(f"kept: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
