"""softdeca train and evaluate: train a network on a corpus, and compare methods on its test faces."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..lhm.base.files.atomic import write_whole
from ..lhm.base.limits import TRAINING_STEPS
from ..lhm.base.progress import OnProgress
from .options import FILE, FloatRange, argument, make_command, option, refuse_unread
from .terminal import show_progress
from .written_file import FOLDER

if TYPE_CHECKING:
    from ..surrogate.corpus.reading import Faces
    from ..surrogate.networks.weights import Weights


@dataclass(frozen=True)
class Train:
    """Train a surrogate on CORPUS, from `softdeca corpus generate`. An interrupted training resumes.

    Writes OUT/NETWORK.safetensors, which `Surrogate.load` and `--surrogate` read, and the learning curve as
    OUT/curve.json and curve.png. An option that a network cannot honour is refused.
    """

    corpus: Path = argument("CORPUS", type=FILE)
    out: Path = option(Path("out/surrogate"), "folder of weights and curve", type=FOLDER)
    network: str = option(
        "modal",
        "modal: the shipped form; paper: SoftDECA's hypernetwork as printed, by its protocol; hyper: the same beyond "
        "modal's tables, quick; softsmpl-small, softsmpl-large, face-wise: its rivals",
        type=click.Choice(["modal", "hyper", "paper", "softsmpl-small", "softsmpl-large", "face-wise"]),
    )
    steps: int | None = option(None, "training steps; default: the network's own number", bound=TRAINING_STEPS)
    minutes: float | None = option(
        None,
        "minutes of a processor for the training, in place of --steps; the looseness of 96 heads, by which a first "
        "modal network of anny ends, comes on top",
        type=FloatRange(0.0, 100_000.0, min_open=True),
    )
    batch: int | None = option(
        None, "frames a step, not of modal; default: the network's own", type=click.IntRange(1, 4096)
    )
    recurrence_steps: int | None = option(
        None,
        "steps that learn alpha, beta and gamma of Eq. 21 from the corpus' sequences, not of modal; default: 0",
        name="--recurrence-steps",
        type=click.IntRange(0, 1_000_000),
    )
    device: str = option("cpu", "torch device: cpu, or cuda for modal")
    more: Path | None = option(None, "second corpus, of faces without frames (preset faces)", type=FILE)
    start: Path | None = option(None, "weights to start from; what the corpora cannot teach stays theirs", type=FILE)
    share: float = option(
        1.0, "share of the people to learn from, the first ones", type=FloatRange(0.0, 1.0, min_open=True)
    )
    partial: bool = option(False, "accept an incomplete corpus")

    def run(self) -> int:
        """Train, and write weights and curve."""
        from ..animation.plots import draw_learning_curve
        from ..surrogate.networks import trainer  # noqa: F401  says what to install, before a corpus is read
        from ..surrogate.networks.weights import Weights

        if self.minutes is not None:
            refuse_unread(self, "with --minutes", "steps")
        if self.network == "modal":
            refuse_unread(self, "for --network modal", "batch", "recurrence_steps")
        elif self.network != "hyper":
            refuse_unread(self, f"for --network {self.network}", "more", "start")
        with show_progress() as progress:
            teachers = {
                "extra_faces": None if self.more is None else self._read(self.more),
                "start": None if self.start is None else Weights.load(self.start),
                "state": self.out / f"{self.network}.pt",
                "on_progress": progress,
            }
            faces = self._read(self.corpus)
            train_network = self._train_modal if self.network == "modal" else self._train_gradients
            weights = train_network(faces, teachers, progress)
        path = self.out / f"{self.network}.safetensors"
        weights.save(path)
        curve = [dict(point) for point in weights.note.curve]
        write_whole(self.out / "curve.json", json.dumps(curve, indent=1).encode())
        write_whole(self.out / "curve.png", draw_learning_curve(curve))
        for written in (path, self.out / "curve.json", self.out / "curve.png"):
            click.echo(f"wrote {written}")
        return 0

    def _read(self, corpus: Path) -> Faces:
        from ..surrogate.corpus.reading import Faces

        return Faces(corpus, "train", partial=self.partial, share=self.share)

    @property
    def _options(self) -> dict[str, Any]:
        """Options that replace the network's own."""
        asked = {"steps": self.steps, "hours": None if self.minutes is None else self.minutes / 60.0}
        return {"device": self.device} | {name: value for name, value in asked.items() if value is not None}

    def _train_modal(self, faces: Faces, teachers: dict[str, Any], progress: OnProgress) -> Weights:
        from ..surrogate.corpus.people import people_from_text
        from ..surrogate.networks.modal_training import ModalTraining, train_modal
        from ..surrogate.rigs.inertia import Looseness

        self.out.mkdir(parents=True, exist_ok=True)
        weights = train_modal(faces, ModalTraining(**self._options), **teachers)
        if faces.space != "anny" or weights.looseness is not None:
            return weights
        return replace(weights, looseness=Looseness.from_people(people_from_text("anny"), on_progress=progress))

    def _train_gradients(self, faces: Faces, teachers: dict[str, Any], progress: OnProgress) -> Weights:
        from ..surrogate import Surrogate
        from ..surrogate.corpus.reading import Table
        from ..surrogate.networks.gradient_training import NETWORKS, train_gradients, with_batch
        from ..surrogate.networks.recurrence_training import RecurrenceTraining, find_mean_pivot, train_recurrence

        config = replace(NETWORKS[self.network], **self._options)
        config = config if self.batch is None else with_batch(config, self.batch)
        moving = None
        if self.recurrence_steps:
            # Before the long part: where there are no sequences, or nobody fits heads.
            sequences = Table(self.corpus, "sequences", "train", partial=self.partial, share=self.share)
            pivot = find_mean_pivot(faces.corpus.heads(progress))
            moving = sequences, pivot, RecurrenceTraining(steps=self.recurrence_steps)
        self.out.mkdir(parents=True, exist_ok=True)
        weights = train_gradients(faces, config, **teachers)
        if moving is None:
            return weights
        return train_recurrence(weights, Surrogate(weights).bind_face, *moving, on_progress=progress)


train = make_command("train", Train)


class Evaluate(click.Command):
    """The command of the surrogate's study, whose options are read when they are asked for: it brings the surrogate."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """The study's options; the corpus is an argument."""
        from ..benchmarks.studies.surrogate.study import SurrogateOnCorpus
        from .study_command import command_of_study

        if not self.params:
            whole = command_of_study(SurrogateOnCorpus, out="out/evaluate", named="corpus", judged=False)
            self.params, self.callback = whole.params, whole.callback
        return super().get_params(ctx)


EVALUATE = """Compare the surrogate and its rivals with the simulator on people of CORPUS whom training has not seen.

On static frames, by kind of parameters and strength of the expression; where CORPUS has them on sequences with inertia
(Eq. 21 over each method's static answers), and against FEniCSx by both laws. Further questions by option.

Shares are of |T - carried(S)|: of the simulated skin T less blendshapes S that move along with scaled bones.

Writes OUT/index.html and OUT/results.json, with error against cost, and the worst faces as pictures; OUT/rows.jsonl
keeps what is done. Exit status 1 if a case could not be measured.
"""
evaluate = Evaluate("evaluate", help=EVALUATE, short_help="Compare the surrogate and its rivals with the simulator.")
