"""The main study: quick versions of those that say whether PD is right, how far the surrogate is, what it costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ..lhm import fit_head, identities, load_template
from ..lhm.errors import SoftdecaError
from ..lhm.files.alone import alone_in
from ..lhm.progress import OnProgress
from ..surrogate.corpus.folder import Corpus
from ..surrogate.corpus.person import OfSpace
from ..surrogate.corpus.plan import PRESETS
from ..surrogate.schedule import processors, schedule
from .harness import Results, Study, run
from .harness.report import Made, write
from .harness.runner import Only
from .studies.agreement import Agreement
from .studies.effects import Effects
from .studies.hard import Hard
from .studies.material import Material
from .studies.split import Split
from .studies.surrogate import SurrogateOnCorpus
from .studies.throughput import ITERATION, Throughput
from .studies.verification import Verification
from .studies.work_precision import FACE, WorkPrecision

TITLE = "is projective dynamics right, and how far is the surrogate?"
PLAN = PRESETS["study"]
"""Of the corpus on which the surrogate is tested: people, parameters and recordings that its training has not seen."""


@dataclass(frozen=True)
class Part:
    """A study of the main one, and the part of names that its tasks must have."""

    study: Study
    match: str = ""


def parts(agreement: Agreement, corpus: Path) -> Sequence[Part]:
    """The studies, in the order in which they are run: what is compared of a head first, what is timed last.

    Where no network knows the people of `agreement`, those of the surrogate are left out; `corpus` is what it is
    tested on.
    """
    whose, learned = agreement.identities, agreement.network() is not None
    found = [
        Part(agreement),
        Part(Verification()),
        Part(Hard(solvers=("projective",))),
        Part(Material(poisson=("0.45",))),
        Part(Effects(identities=whose, effects=("bells-palsy", "weight-40"))),
    ]
    if learned:
        found.append(Part(SurrogateOnCorpus(corpus=str(corpus), weights=agreement.weights, people="all")))
    if learned and not agreement.weights:
        frames = ("mouthSmileLeft*0.6+mouthSmileRight*0.6", "mouthPucker")
        found.append(Part(Split(identities=whose, expressions=frames, effects=("defaults", "40 % more soft tissue"))))
    found.append(Part(Throughput(identities=whose), ITERATION))
    # Of the face's energy, and of what has learned it; not of ARAP's.
    timed = "the face's energy" if learned else FACE
    return [*found, Part(WorkPrecision(identities=whose, expressions=("jawOpen",)), timed)]


@dataclass(frozen=True)
class Done:
    """What the studies gave, why others could not be run, by name, and the report's files."""

    results: Sequence[Results]
    failed: Sequence[tuple[str, str]]
    written: Sequence[Path]

    @property
    def passed(self) -> bool:
        """Whether all was run, and every gate holds that asks for a right answer."""
        return not self.failed and all(results.passed for results in self.results)


def run_study(agreement: Agreement, out: Path, *, only: Only = "missing", progress: OnProgress) -> Done:
    """Run all of it, each study in its folder of `out`, and write the report of all there.

    Rows that are there are kept, as by `harness.run`. A study that cannot be run is told with its reason, and the rest
    is complete. Raises InputError for a space or an expression that cannot be read, before anything is run.
    """
    agreement.tasks()
    with alone_in(out, "study"):
        template = load_template(identities.from_text(agreement.identities), progress=progress)
        corpus = out / "surrogate" / f"corpus-{template.digest}-{PLAN.digest}"
        made, failed = [], []
        for part in parts(agreement, corpus):
            folder = out / part.study.name
            try:
                if isinstance(part.study, SurrogateOnCorpus):
                    _simulate(agreement.identities, template, corpus, progress)
                results = run(part.study, folder, only=only, match=part.match, progress=progress)
                made.append(Made(part.study, results, folder))
            except SoftdecaError as error:
                failed.append((part.study.name, str(error)))
        written = write(made, out, TITLE, failed)
    return Done([each.results for each in made], failed, written)


def _simulate(whose: str, template, folder: Path, progress: OnProgress) -> None:
    """What is missing of the corpus."""
    space = identities.from_text(whose)
    people = OfSpace(space, space.mean, partial(fit_head, template), template.digest)
    Corpus(folder, PLAN, people).generate(on=schedule(min(2, processors())), on_progress=progress)
