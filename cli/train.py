"""softdeca train and evaluate: a network from a corpus, and methods compared on its test faces."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import click

from ..lhm.base.files.atomic import replaced
from ..lhm.base.limits import FACES, STUDIED_PAIRS, TRAINING_STEPS, WORKERS
from .counts import counted
from .progress import shown
from .written_file import FOLDER


@click.command()
@click.argument("corpus", type=click.Path(path_type=Path))
@click.option("--out", default="out/surrogate", type=FOLDER, help="folder of weights and curve")
@click.option(
    "--network",
    type=click.Choice(["modal", "paper"]),
    default="modal",
    help="modal: what is shipped; paper: SoftDECA's hypernetwork of deformation gradients, to compare with",
)
@click.option("--steps", type=counted(TRAINING_STEPS), help="instead of the network's own number")
@click.option("--device", default="cpu", help="as torch names it: cpu, cuda")
@click.option(
    "--precision",
    type=click.Choice(["float32", "bfloat16"]),
    default="float32",
    help="of products of matrices; GPUs do bfloat16 faster",
)
@click.option(
    "--neutrals", type=click.Path(path_type=Path), help="another corpus, of settled neutral faces: preset neutral"
)
@click.option(
    "--start",
    type=click.Path(path_type=Path),
    help="weights to go on from: their neutral faces are kept, what w does is learned on",
)
@click.option(
    "--share",
    type=click.FloatRange(0.0, 1.0, min_open=True),
    default=1.0,
    help="of the people: the first ones alone, for the curve of errors over the corpus' size",
)
@click.option("--partial", is_flag=True, help="learn from the people that are there, of a corpus not yet complete")
def train(
    corpus: Path,
    out: Path,
    network: str,
    steps: int | None,
    device: str,
    precision: str,
    neutrals: Path | None,
    start: Path | None,
    share: float,
    partial: bool,
) -> int:
    """Train a surrogate on CORPUS, a folder of `softdeca corpus generate`; a training that was stopped goes on.

    Writes OUT/modal.safetensors, which `Surrogate.load` and `softdeca study --surrogate` read, or OUT/paper.npz, and
    the learning curve as OUT/curve.json and curve.png. Several processes, a device each, share a training of the modal
    network under `torchrun --nproc-per-node 4 --no-python softdeca train CORPUS --device cuda`.
    """
    from ..animation.plots import draw_learning_curve

    with shown() as progress:
        if network == "modal":
            config = {"steps": steps, "device": device, "precision": precision}
            read = {"partial": partial, "share": share}
            path, curve = _modal(corpus, neutrals, start, out, config, read, progress)
        else:
            path, curve = _paper(corpus, out, steps, progress)
    with replaced(out / "curve.json") as temporary:
        temporary.write_text(json.dumps(curve, indent=1))
    (out / "curve.png").write_bytes(draw_learning_curve(curve))
    for written in (path, out / "curve.json", out / "curve.png"):
        click.echo(f"wrote {written}")
    return 0


def _modal(corpus: Path, neutrals: Path | None, start: Path | None, out: Path, options: dict, read: dict, progress):
    from ..surrogate.corpus.people import people_of
    from ..surrogate.corpus.reading import Faces
    from ..surrogate.dynamics import Looseness
    from ..surrogate.networks.modal_training import ModalTraining, train_modal
    from ..surrogate.networks.weights import Weights

    config = ModalTraining(**{name: value for name, value in options.items() if value is not None})
    faces = Faces(corpus, "train", **read)
    more = None if neutrals is None else Faces(neutrals, "train", table="groups", **read)
    out.mkdir(parents=True, exist_ok=True)
    begun = None if start is None else Weights.load(start)
    weights = train_modal(faces, config, neutrals=more, start=begun, state=out / "modal.pt", on_progress=progress)
    if faces.space == "anny" and weights.looseness is None:
        weights = replace(weights, looseness=Looseness.of(people_of("anny"), on_progress=progress))
    weights.save(out / "modal.safetensors")
    return out / "modal.safetensors", [dict(point) for point in weights.note.curve]


def _paper(corpus: Path, out: Path, steps: int | None, progress):
    from ..surrogate.paper.samples import samples_of
    from ..surrogate.paper.train import TrainConfig
    from ..surrogate.paper.train import train as train_paper

    config = TrainConfig() if steps is None else TrainConfig(steps=steps)
    samples = samples_of(corpus, "train")
    out.mkdir(parents=True, exist_ok=True)
    checkpoint = train_paper(samples, config, state=out / "paper.pt", on_progress=progress)
    checkpoint.save(out / "paper.npz")
    return out / "paper.npz", [asdict(point) for point in checkpoint.summary.history]


@click.command()
@click.argument("corpus", type=click.Path(path_type=Path))
@click.option("--surrogate", type=click.Path(path_type=Path), help="weights of `softdeca train`; default: the shipped")
@click.option(
    "--external", type=click.Path(path_type=Path), help="another corpus, as of --identities external:ict:FILE, to score"
)
@click.option(
    "--people",
    type=click.Choice(["test", "all"]),
    default="test",
    help="of CORPUS; all: where training has seen none, as of --preset fresh",
)
@click.option("--rivals", is_flag=True, help="also fit rivals that learn to the corpus' training faces (minutes)")
@click.option(
    "--simulated",
    type=counted(FACES),
    default=0,
    help="faces on which rivals that simulate run, too, and unseen parameters: minutes",
)
@click.option(
    "--generalisation",
    type=counted(STUDIED_PAIRS),
    metavar="N",
    help="pairs of people, known and unseen, simulated under both's parameters and recordings: a minute of a core each",
)
@click.option("--workers", type=counted(WORKERS), default=1, help="processes of --generalisation")
@click.option(
    "--curve",
    multiple=True,
    type=click.Path(path_type=Path),
    help="weights of `train --share`, one option each: errors over the corpus' size",
)
@click.option("--partial", is_flag=True, help="on the people that are there, of a corpus not yet complete")
@click.option("--out", default="out/evaluate", type=FOLDER, help="folder of tables and pictures")
@click.option("--json", "as_json", is_flag=True, help="print the scores as JSON")
def evaluate(
    corpus: Path,
    surrogate: Path | None,
    external: Path | None,
    people: str,
    rivals: bool,
    simulated: int,
    generalisation: int | None,
    workers: int,
    curve: tuple[Path, ...],
    partial: bool,
    out: Path,
    as_json: bool,
) -> int:
    """Compare the surrogate and its rivals on the test people of CORPUS against the simulator.

    Shares are of |T - carried(S)|: what of the simulated skin T is not blendshapes S moved along by scaled bones.

    On static frames, by kind of parameters and strength of the expression; on sequences with
    inertia (Eq. 21 over each method's static answers); and
    against FEniCSx, both laws, where CORPUS has its answers. With --generalisation by what is unseen, too: people,
    parameters, recordings, in every combination; what it simulates is kept in OUT/generalisation.

    Writes OUT/scores.json with machine, commit, versions and seed; scores.md with the frames and faces after which
    training has paid; error against seconds before the first frame and per frame as cost.png; and the six worst faces
    as frames.png; with --curve, errors over the
    number of people trained on as curve.png.
    """
    from ..benchmarks.surrogates import compare, told_first

    out.mkdir(parents=True, exist_ok=True)
    with shown() as progress:
        scores, written = compare(
            corpus,
            out,
            surrogate=surrogate,
            rivals=rivals,
            partial=partial,
            people=people,
            external=external,
            simulated=simulated,
            generalisation=generalisation,
            workers=workers,
            curve=curve,
            progress=progress,
        )
    if as_json:
        click.echo(json.dumps([asdict(score) for score in scores], indent=1))
        return 0
    click.echo(told_first(scores), nl=False)
    for score in scores:
        figures = f"share {100 * score.share:6.1f} %  mean {score.mean:.4f} mm  95 % {score.p95:.3f}"
        click.echo(f"{score.method:<36} {score.kind:<32} {figures}")
    for path in written:
        click.echo(f"wrote {path}")
    return 0
