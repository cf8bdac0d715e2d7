"""softdeca simulate: play a take of ARKit weights on a head by the simulator."""

import json
from dataclasses import asdict, replace

import click

from .take_options import TakeRequest, take_options
from .terminal import show_progress
from .written_file import FOLDER


@click.command()
@click.argument("take")
@take_options
@click.option("--out", default="out/take", type=FOLDER, help="folder of the results; finished frames in it are kept")
@click.option(
    "--bones", type=click.Choice(["prescribed", "rigid", "soft"]), default="prescribed", help="motion of the mandible"
)
@click.option("--contact", multiple=True, help="region of the skin that must not cross itself, as lips; repeatable")
@click.option("--tolerance", type=float, help="gradient norm, relative to that of skin 1 mm off its targets  [5e-05]")
@click.option("--json", "as_json", is_flag=True, help="print the result as JSON")
def simulate(
    request: TakeRequest,
    bones: str,
    contact: tuple[str, ...],
    tolerance: float | None,
    as_json: bool,
) -> int:
    """Simulate TAKE: a LiveLink Face CSV, weights.csv, JSON, 'conversation[:SECONDS[:SEED]]' or 'speech:TEXT'.

    The neutral face first settles under the parameters (weight, gravity, bones). The take moves that face.

    Writes OUT/take.vtkhdf (or .glb), OUT/preview.gif (or .mp4) and OUT/log.jsonl, a line per frame. An interrupted run
    resumes. Exit status 1 if a frame or the neutral face did not converge; those are listed.
    """
    from ..animation.simulate import TakeConfig, run_take

    choices = {"bones": bones} | ({"contact": list(contact)} if contact else {})
    config = TakeConfig(**request.files, choices=choices)
    config = config if tolerance is None else replace(config, tolerance=tolerance)
    try:
        with show_progress() as progress:
            head, deltas = request.which.head(progress)
            result = run_take(config, head, deltas, request.take, request.parameters, progress)
    except KeyboardInterrupt:
        click.echo(f"softdeca: interrupted; the same command goes on after the frames in {request.out}", err=True)
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
