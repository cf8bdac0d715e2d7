"""The main study: quick versions of those that say whether PD is right, how far the surrogate is, what it costs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ..lhm import fit_head, identities, load_template
from ..lhm.base.errors import SoftdecaError
from ..lhm.base.files.resumable import lock_folder
from ..lhm.base.progress import OnProgress
from ..surrogate.corpus.folder import Corpus
from ..surrogate.corpus.people import OfSpace
from ..surrogate.corpus.plan import PRESETS
from ..surrogate.corpus.schedule import count_processors, make_schedule
from ..surrogate.methods import PD, PD_TETS
from .harness import Results, RunRequest, Study, run_together
from .harness.processes import read_cpu_seconds
from .harness.report import ReportPart, write_report
from .studies.agreement.material import Material
from .studies.agreement.study import Agreement
from .studies.arena.work_precision import FACE, WorkPrecision
from .studies.cases import WEIGHTS_AND_LOADS, parse_expression
from .studies.mesh.study import MeshError
from .studies.surrogate.dial import Dial
from .studies.surrogate.split import Split
from .studies.surrogate.study import SurrogateOnCorpus
from .studies.verification import Hard, Verification

TITLE = "is the fast simulator right, and how far is the network from it?"
PLAN = PRESETS["study"]
"""Of the corpus on which the surrogate is tested: people, parameters and recordings that its training has not seen."""
SMALL_PLAN = replace(PLAN, identities=2, groups=2, frames=2, conversations=2, hard=2)
BESIDE_EXPRESSIONS = (*(case.name for case in WEIGHTS_AND_LOADS), "bells-palsy", "weight-40")
"""Cases of the main study beside the expressions that are asked for."""
MESH_CASE = "3 g, 2 kPa, seed 900"
"""The main study's one case of `mesh`, whose quadratic tets take half a minute."""
SMALL_CASES = ("cheekPuff", "jaw")
"""Cases in which the coarsest head has no inverted tet."""


def choose_cases(expressions: Sequence[str]) -> tuple[str, ...]:
    """List the cases of the main study. InputError for an expression that cannot be read."""
    return (*(parse_expression(text).name for text in expressions), *BESIDE_EXPRESSIONS)


def choose_studies(agreement: Agreement, out: Path, corpus: Path, *, small: bool = False) -> Sequence[RunRequest]:
    """List the studies, each with its folder of `out`, in the order of the run: what is timed comes last.

    Where no network knows the people of `agreement`, those of the surrogate are left out; `corpus` is what it is
    tested on. `small`: fewer cases of each, on the level of `agreement`.
    """
    whose, level, learned = agreement.identities, agreement.level, agreement.network() is not None
    chosen: list[tuple[Study, str]] = [
        (agreement, ""),
        (Verification(), "two layers" if small else ""),
        (Hard(solvers=("projective",)), "flattened" if small else ""),
        (Material(poisson=("0.45",)), ""),
        (MeshError(identities=whose, level=level, refined=(), methods=(PD_TETS, PD)), MESH_CASE),
    ]
    if learned and not agreement.weights:
        frames = ("mouthPucker",) if small else ("mouthSmileLeft*0.6+mouthSmileRight*0.6", "mouthPucker")
        effects = ("40 % more soft tissue",) if small else ("defaults", "40 % more soft tissue")
        split = Split(identities=whose, level=level, expressions=frames, effects=effects, refined=())
        chosen.append((split, ""))
    if learned:
        chosen.append((SurrogateOnCorpus(corpus=str(corpus), weights=agreement.weights, people="all"), ""))
        chosen.append((Dial(faces=1, frames=1 if small else 2, level=level), ""))
    repeats = 1 if small else 5
    chosen.append((WorkPrecision(identities=whose, level=level, expressions=("jawOpen",), repeats=repeats), FACE))
    return [RunRequest(study, out / study.name, match) for study, match in chosen]


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


def run_study(agreement: Agreement, out: Path, *, small: bool = False, progress: OnProgress) -> Done:
    """Run all of it, each study in its folder of `out`, and write the report of all there; see `choose_studies`.

    Rows that are there are kept, as by `harness.run`. A study that cannot be run is told with its reason, and the rest
    is complete. Raises InputError for a space or an expression that cannot be read, before anything is run.
    """
    agreement.tasks()
    begin, processor = time.perf_counter(), read_cpu_seconds()
    with lock_folder(out, "study"):
        plan, level = SMALL_PLAN if small else PLAN, agreement.level
        template = load_template(identities.from_text(agreement.identities), level=level, progress=progress)
        corpus = out / "surrogate" / f"corpus-{template.digest}-{plan.digest}"
        made, failed = [], []
        chosen = choose_studies(agreement, out, corpus, small=small)
        # What is timed is run by itself: nothing of ours runs beside it.
        for asked in ([each for each in chosen if not each.study.timed], *([e] for e in chosen if e.study.timed)):
            if any(isinstance(each.study, SurrogateOnCorpus) for each in asked):
                space = identities.from_text(agreement.identities)
                people = OfSpace(space, space.mean, partial(fit_head, template), template.digest)
                made_with = {"identities": agreement.identities, "level": level}
                schedule = make_schedule(min(2, count_processors()))
                begun = Corpus.from_plan(corpus, plan, people, made_with)
                begun.generate(on=schedule, on_progress=progress)
            for each, results in zip(asked, run_together(asked, progress=progress), strict=True):
                if isinstance(results, SoftdecaError):
                    failed.append((each.study.name, str(results)))
                else:
                    made.append(ReportPart(each.study, results, each.out))
        spent = (
            f"This run took {read_cpu_seconds() - processor:.0f} s of processor time in "
            f"{time.perf_counter() - begin:.0f} s, rows of earlier runs not counted."
        )
        written = write_report(made, out, TITLE, failed, spent)
    return Done([each.results for each in made], failed, written, spent)
