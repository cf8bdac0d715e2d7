"""softdeca simulate: a take of ARKit weights on a head."""

import json
from dataclasses import asdict, replace

import click

from .take_options import TakeRequest, take_options
from .terminal import show_progress
from .written_file import FOLDER


@click.command()
@click.argument("take")
@take_options
@click.option("--out", default="out/take", type=FOLDER, help="folder of the results; what is done there is kept")
@click.option(
    "--bones", type=click.Choice(["prescribed", "rigid", "soft"]), default="prescribed", help="how a jaw moves"
)
@click.option("--contact", multiple=True, help="a region of the skin kept from crossing itself, as lips; repeat")
@click.option("--tolerance", type=float, help="gradient norm over that of skin 1 mm off its targets  [5e-05]")
@click.option("--json", "as_json", is_flag=True, help="print the outcome as JSON")
def simulate(
    request: TakeRequest,
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
