"""softdeca train and evaluate: train a network on a corpus, and compare methods on its test faces."""

import json
from dataclasses import replace
from pathlib import Path

import click

from ..lhm.base.files.atomic import replaced, write_whole
from ..lhm.base.limits import TRAINING_STEPS
from .options import count_range
from .terminal import show_progress
from .written_file import FOLDER


@click.command()
@click.argument("corpus", type=click.Path(path_type=Path))
@click.option("--out", default="out/surrogate", type=FOLDER, help="folder of weights and curve")
@click.option(
    "--network",
    type=click.Choice(["modal", "hyper", "paper", "softsmpl-small", "softsmpl-large", "face-wise"]),
    default="modal",
    help="modal: the shipped form; paper: SoftDECA's hypernetwork as printed, by its protocol; hyper: the same beyond "
    "modal's tables, quick; softsmpl-small, softsmpl-large, face-wise: its rivals",
)
@click.option("--steps", type=count_range(TRAINING_STEPS), help="training steps; default: the network's own number")
@click.option("--batch", type=click.IntRange(1, 4096), help="frames a step, not of modal; default: the network's own")
@click.option(
    "--recurrence-steps",
    type=click.IntRange(0, 1_000_000),
    help="steps that learn alpha, beta and gamma of Eq. 21 from the corpus' sequences, not of modal; default: 0",
)
@click.option("--device", default="cpu", help="torch device: cpu, or cuda for modal")
@click.option("--more", type=click.Path(path_type=Path), help="second corpus, of faces without frames (preset faces)")
@click.option(
    "--start",
    type=click.Path(path_type=Path),
    help="weights to start from; what the corpora cannot teach stays theirs",
)
@click.option(
    "--share",
    type=click.FloatRange(0.0, 1.0, min_open=True),
    default=1.0,
    help="share of the people to learn from, the first ones",
)
@click.option("--partial", is_flag=True, help="accept an incomplete corpus")
def train(
    corpus: Path,
    out: Path,
    network: str,
    steps: int | None,
    batch: int | None,
    recurrence_steps: int | None,
    device: str,
    more: Path | None,
    start: Path | None,
    share: float,
    partial: bool,
) -> int:
    """Train a surrogate on CORPUS, from `softdeca corpus generate`. An interrupted training resumes.

    Writes OUT/NETWORK.safetensors, which `Surrogate.load` and `--surrogate` read, and the learning curve as
    OUT/curve.json and curve.png. An option that a network cannot honour is refused.
    """
    from ..animation.plots import draw_learning_curve

    options = {
        "steps": steps,
        "device": device,
    }
    given = {name: value for name, value in options.items() if value is not None}
    read = {"partial": partial, "share": share}
    if network == "modal":
        _refuse(network, {"--batch": batch, "--recurrence-steps": recurrence_steps})
    elif network != "hyper":
        _refuse(network, {"--more": more, "--start": start})
    with show_progress() as progress:
        teachers = _read_teachers(more, start, read)
        if network == "modal":
            path, curve = _modal(corpus, teachers, out, given, read, progress)
        else:
            path, curve = _gradients(
                network, corpus, teachers, out, given, batch, recurrence_steps or 0, read, progress
            )
    with replaced(out / "curve.json") as temporary:
        temporary.write_text(json.dumps(curve, indent=1))
    write_whole(out / "curve.png", draw_learning_curve(curve))
    for written in (path, out / "curve.json", out / "curve.png"):
        click.echo(f"wrote {written}")
    return 0


def _read_teachers(more: Path | None, start: Path | None, read: dict) -> dict:
    """Read what teaches a network beside its corpus, as trainings take it."""
    from ..surrogate.corpus.reading import Faces
    from ..surrogate.networks.weights import Weights

    return {
        "more": None if more is None else Faces(more, "train", **read),
        "start": None if start is None else Weights.load(start),
    }


def _modal(corpus: Path, teachers: dict, out: Path, options: dict, read: dict, progress):
    from ..surrogate.corpus.people import people_from_text
    from ..surrogate.corpus.reading import Faces
    from ..surrogate.networks.modal_training import ModalTraining, train_modal
    from ..surrogate.rigs.inertia import Looseness

    config, faces = ModalTraining(**options), Faces(corpus, "train", **read)
    out.mkdir(parents=True, exist_ok=True)
    weights = train_modal(faces, config, **teachers, state=out / "modal.pt", on_progress=progress)
    if faces.space == "anny" and weights.looseness is None:
        weights = replace(weights, looseness=Looseness.from_people(people_from_text("anny"), on_progress=progress))
    weights.save(out / "modal.safetensors")
    return out / "modal.safetensors", [dict(point) for point in weights.note.curve]


def _refuse(network: str, options: dict) -> None:
    """Raise InputError for an option that a network cannot honour."""
    from ..lhm.base.errors import InputError

    given = [name for name, value in options.items() if value is not None]
    if given:
        raise InputError(f"--network {network} cannot honour {given[0]}; leave it out")


def _gradients(
    network: str,
    corpus: Path,
    teachers: dict,
    out: Path,
    options: dict,
    batch: int | None,
    recurrence_steps: int,
    read: dict,
    progress,
):
    from ..surrogate import Surrogate
    from ..surrogate.corpus.folder import Corpus
    from ..surrogate.corpus.reading import Faces, Table
    from ..surrogate.networks.gradient_training import NETWORKS, train_gradients, with_batch
    from ..surrogate.networks.recurrence_training import RecurrenceTraining, find_mean_pivot, train_recurrence

    config = replace(NETWORKS[network], **options)
    config = config if batch is None else with_batch(config, batch)
    faces = Faces(corpus, "train", **read)
    # Before the long part: where there are no sequences, or nobody fits heads.
    sequences = Table(corpus, "sequences", "train", **read) if recurrence_steps else None
    pivot = find_mean_pivot(Corpus.open(corpus).heads(progress)) if recurrence_steps else None
    out.mkdir(parents=True, exist_ok=True)
    weights = train_gradients(faces, config, **teachers, state=out / f"{network}.pt", on_progress=progress)
    if sequences is not None and pivot is not None:
        moving = RecurrenceTraining(steps=recurrence_steps)
        weights = train_recurrence(
            weights, Surrogate(weights).bind_face, sequences, pivot, moving, on_progress=progress
        )
    weights.save(out / f"{network}.safetensors")
    return out / f"{network}.safetensors", [dict(point) for point in weights.note.curve]


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

Writes OUT/index.html and OUT/results.json, with the frames after which training has paid, error against cost, and the
worst faces as pictures; OUT/rows.jsonl keeps what is done. Exit status 1 if a case could not be
measured.
"""
evaluate = Evaluate("evaluate", help=EVALUATE, short_help="Compare the surrogate and its rivals with the simulator.")
