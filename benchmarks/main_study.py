"""The main study: how far every method is from the simulator, and it from converged finite elements."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..lhm.base.errors import SoftdecaError
from ..lhm.base.files.resumable import lock_folder
from ..lhm.base.progress import OnProgress
from .harness import Results, RunRequest, run_together
from .harness.processes import read_cpu_seconds
from .harness.report import ReportPart, write_report
from .studies.faces import Faces
from .studies.verification import Hard, Verification

TITLE = "is the fast simulator right, and how far is the network from it?"


def choose_studies(faces: Faces, out: Path, *, small: bool = False) -> Sequence[RunRequest]:
    """List the studies, each with its folder of `out`. `small`: fewer cases of each."""
    studies = {faces: "", Verification(): "two layers", Hard(solvers=("projective",)): "flattened"}
    return [RunRequest(study, out / study.name, part if small else "") for study, part in studies.items()]


@dataclass(frozen=True)
class Done:
    """Results of the studies, why others could not be run, by name, the report's files, and a sentence on the cost."""

    results: Sequence[Results]
    failed: Sequence[tuple[str, str]]
    written: Sequence[Path]
    spent: str

    @property
    def passed(self) -> bool:
        """Whether all was run, and every gate holds that asks for a right answer."""
        return not self.failed and all(results.passed for results in self.results)

    @property
    def complete(self) -> bool:
        """Whether all was run, whatever the gates say."""
        rows = [row for results in self.results for row in results.rows]
        return not self.failed and all(row.status != "failed" for row in rows)


def run_study(faces: Faces, out: Path, *, small: bool = False, progress: OnProgress) -> Done:
    """Run all of it, each study in its folder of `out`, and write the report of all there, meanwhile and at the end.

    Rows that are there are kept, as by `harness.run`. A study that cannot be run is told with its reason, and the rest
    is complete. Raises InputError for a space or an expression that cannot be read, before anything is run.
    """
    faces.tasks()
    begin, processor = time.perf_counter(), read_cpu_seconds()
    with lock_folder(out, "study"):
        chosen = choose_studies(faces, out, small=small)
        by_name = {asked.study.name: asked for asked in chosen}

        def write(there: Sequence[Results], failed: Sequence[tuple[str, str]] = (), spent: str = "") -> list[Path]:
            parts = [ReportPart(by_name[each.study].study, each, by_name[each.study].out) for each in there]
            return write_report(parts, out, TITLE, failed, spent)

        ended = run_together(chosen, progress=progress, on_results=write)
        made = [each for each in ended if isinstance(each, Results)]
        failed = [
            (asked.study.name, str(each))
            for asked, each in zip(chosen, ended, strict=True)
            if isinstance(each, SoftdecaError)
        ]
        spent = (
            f"This run took {read_cpu_seconds() - processor:.0f} s of processor time in "
            f"{time.perf_counter() - begin:.0f} s, rows of earlier runs not counted."
        )
        written = write(made, failed, spent)
    return Done(made, failed, written, spent)
