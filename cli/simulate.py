"""softdeca simulate: a take of ARKit weights on a head."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import click
import numpy as np

from ..lhm import expressions, fit_head, identities, load_template
from ..lhm.errors import InputError
from ..lhm.files.head_file import load_head
from ..lhm.template import DEFAULT_LEVEL
from ..reference import Parameters
from ..reference.parameter_file import read_parameters
from .progress import shown
from .written_file import FOLDER

AFile = click.Path(path_type=Path)


@click.command()
@click.argument("take")
@click.option("--head", "head_file", type=AFile, help="a head by `head fit`; default: one fitted to --identities")
@click.option("--identities", "space_name", help="whose head ('anny' or 'ict:FILE'); with --head: whose expressions")
@click.option("--seed", type=click.IntRange(min=0), help="of a random identity; default: the mean")
@click.option("--level", type=click.IntRange(1, 3), help="1,212, 4,842 (default) or 19,362 vertices per wrap")
@click.option("--parameters", "parameter_file", type=AFile, help="TOML of named parameters p; default: all defaults")
@click.option("--out", default="out/take", type=FOLDER, help="folder of the results; what is done there is kept")
@click.option("--format", "kind", type=click.Choice(["vtkhdf", "gltf"]), default="vtkhdf", help="of the moving skin")
@click.option("--preview", type=click.Choice(["mp4", "gif", "none"]), default="gif", help="a rendered picture of it")
@click.option("--fps", type=float, help="frames per second; default: the take's own")
@click.option("--frames", "chosen", metavar="A:B", help="only these frames, B left out, counted at --fps")
@click.option(
    "--dynamic", is_flag=True, help="with inertia (Eq. 9): flesh lags and swings as TAKE turns the head; not lips, bone"
)
@click.option("--turned", is_flag=True, help="write the head turned as TAKE has it; default: in its own frame")
@click.option(
    "--bones", type=click.Choice(["prescribed", "rigid", "soft"]), default="prescribed", help="how a jaw moves"
)
@click.option("--contact", multiple=True, help="a region of the skin kept from crossing itself, as lips; repeat")
@click.option("--tolerance", type=float, help="gradient norm over that of skin 1 mm off its targets  [5e-05]")
@click.option("--json", "as_json", is_flag=True, help="print the outcome as JSON")
def simulate(
    take: str,
    head_file: Path | None,
    space_name: str | None,
    seed: int | None,
    level: int | None,
    parameter_file: Path | None,
    out: Path,
    kind: str,
    preview: str,
    fps: float | None,
    chosen: str | None,
    dynamic: bool,
    turned: bool,
    bones: str,
    contact: tuple[str, ...],
    tolerance: float | None,
    as_json: bool,
) -> int:
    """Simulate TAKE: a LiveLink Face CSV, weights.csv, JSON, 'conversation[:SECONDS[:SEED]]' or 'speech:TEXT'.

    What p makes of the neutral face (weight, gravity, bones) settles first; the take moves that face.

    Writes OUT/take.vtkhdf (or .glb), OUT/preview.gif (or .mp4) and OUT/log.jsonl, a line per frame. A run that was
    stopped goes on where it was. Exit status 1 if a frame, or the neutral face, did not converge; those are
    listed.
    """
    from ..benchmarks.head_pictures import deltas_of
    from ..benchmarks.take import TakeConfig, cut, run_take, take_from_text

    if head_file is not None and seed is not None:
        raise click.UsageError("--head and --seed both say which head; give one", click.get_current_context())
    if head_file is not None and level is not None:
        raise click.UsageError("--level is of a head yet to be fitted; --head has its own", click.get_current_context())
    recorded = take_from_text(take)
    recorded = expressions.resampled(recorded, recorded.rate if fps is None else fps)
    recorded = recorded if chosen is None else cut(recorded, chosen)
    if turned and recorded.head is None:
        raise InputError(f"--turned: {take} has no head rotation")
    parameters = Parameters() if parameter_file is None else read_parameters(parameter_file)
    choices = {"bones": bones} | ({"contact": list(contact)} if contact else {})
    config = TakeConfig(out, kind, preview, dynamic, turned, choices=choices)  # type: ignore[arg-type]
    config = config if tolerance is None else replace(config, tolerance=tolerance)
    if recorded.remarks():
        click.echo(f"softdeca: {take}: {'; '.join(recorded.remarks())}", err=True)
    try:
        with shown() as progress:
            progress("head", 0.0)
            if head_file is not None:
                head = load_head(head_file)
                deltas = deltas_of(head, str(head_file), space_name)
            else:
                space = identities.from_text(space_name or "anny")
                template = load_template(space, level=level or DEFAULT_LEVEL, progress=progress)
                code = np.zeros(space.code_size) if seed is None else space.sample(np.random.default_rng(seed))[0]
                head, deltas = fit_head(template, space.skin(code)), space.expression_deltas(code)
            progress("head", 1.0)
            result = run_take(config, head, deltas, recorded, parameters, progress)
    except KeyboardInterrupt:
        click.echo(f"softdeca: interrupted; the same command goes on after the frames in {out}", err=True)
        return 130
    if as_json:
        click.echo(json.dumps(asdict(result), indent=1, default=str))
    else:
        if result.neutral != "CONVERGED":
            click.echo(f"FAILED neutral face: {result.neutral}")
        for frame, reason in result.failed:
            click.echo(f"FAILED frame {frame}: {reason}")
        medians = f"median {result.median_seconds:.3g} s and {result.median_iterations:g} iterations a frame"
        click.echo(f"{result.frames} frames, {len(result.failed)} failed; {medians}")
        for path in result.files:
            click.echo(path)
    return 1 if result.failed or result.neutral != "CONVERGED" else 0
