"""softdeca bench: one study by name."""

import json
from dataclasses import asdict
from pathlib import Path

import click

from ..lhm.base.limits import SEED
from ..reference import Parameters
from ..reference.face.parameters import read_parameters
from .counts import counted
from .study_command import Studies, changes, listed, report
from .terminal import show_progress
from .written_file import FOLDER

AFile = click.Path(path_type=Path)


def _add(context: click.Context, parameter: click.Parameter, files: tuple[Path, ...]) -> None:
    from ..reference.added import add_file

    for path in files:
        add_file(path)


@click.group(cls=Studies, no_args_is_help=False)
@click.option(
    "--add",
    type=AFile,
    multiple=True,
    callback=_add,
    is_eager=True,
    expose_value=False,
    help="a Python file of laws, solvers or studies of your own; repeat for several",
)
def bench() -> None:
    """Single studies by name."""


bench.add_command(listed)
bench.add_command(changes)
bench.add_command(report)


@bench.command()
@click.option("--identities", default="anny", help="the one head with a rig: 'anny' (the default head) or 'ict:FILE'")
@click.option("--upon", required=True, help="the other, as ict:FILE")
@click.option("--seed", default=0, type=counted(SEED), help="of a person of each, whose shapes are known")
@click.option("--json", "as_json", is_flag=True, help="print every shape as JSON")
def registration(identities: str, upon: str, seed: int, as_json: bool) -> int:
    """How far registered points slide, and how near transferred shapes come to a head's own: some two minutes.

    Points of the visible face are carried from each head to the other and back. Shapes, by cosine and mean distance:
    of a random person by exact points, which is transfer's share; by registered ones; and of the other head, whose
    artist had other shapes in mind.
    """
    from ..benchmarks.registrations import median, run_registrations
    from ..lhm.identities import from_text

    with show_progress() as progress:
        results = run_registrations((from_text(identities), from_text(upon)), seed, progress)
    if as_json:
        click.echo(json.dumps(results, indent=1))
        return 0
    for row in results["slide"]:
        figures = "  ".join(f"{key} {row[f'{key}_mm']:.3f}" for key in ("mean", "median", "p95"))
        click.echo(f"{row['from']} to {row['upon']} and back [mm]: {figures}  ({row['points']} points)")
    for group in results["shapes"]:
        for what, rows in group["rows"].items():
            cosine, mean = median(rows)
            least = min(rows, key=lambda row: row["cosine"])
            what = f"{group['from']} to {group['upon']}" if what == "another rig" else f"{group['from']}, {what}"
            worst = f"least {least['cosine']:.3f} {least['shape']}"
            click.echo(f"{what:<36} cosine, median {cosine:.4f}  {worst:<32} mean {mean:.3f} mm")
    return 0


@bench.command()
@click.argument("take", default="conversation:3")
@click.option("--frames", "chosen", metavar="A:B", help="only these frames of TAKE, B left out")
@click.option("--parameters", "parameter_file", type=AFile, help="TOML of named parameters p")
@click.option("--level", default=2, type=click.IntRange(1, 3), help="of the template: 1,212, 4,842 or 19,362 vertices")
@click.option("--dynamic", is_flag=True, help="with inertia, simulated and by the surrogate")
@click.option("--out", default="out/closures", type=FOLDER, help="folder of the curves")
@click.option("--json", "as_json", is_flag=True, help="print the figures as JSON")
def closures(
    take: str, chosen: str | None, parameter_file: Path | None, level: int, dynamic: bool, out: Path, as_json: bool
) -> int:
    """How far lids and lips are apart over TAKE [mm]: blendshapes, PD and the surrogate: OUT/gaps.png, OUT/gaps.json.

    On the mean of the default people; some minutes a hundred frames. Each row: the opening, the method, largest and
    mean difference of its width from PD's, and the least width of both.
    """
    from ..benchmarks.closures import closures as run
    from .take_options import load_take

    recorded = load_take(take, None, chosen, False)
    parameters = Parameters() if parameter_file is None else read_parameters(parameter_file)
    with show_progress() as progress:
        rows, written = run(recorded, out, parameters, level=level, dynamic=dynamic, progress=progress)
    if as_json:
        click.echo(json.dumps([asdict(row) for row in rows], indent=1))
        return 0
    for row in rows:
        off = f"largest {row.largest:.3f} mm, mean {row.mean:.3f} mm off"
        click.echo(
            f"{row.gap:<10} {row.method:<28} {off}; least {row.least:.2f} mm, simulated {row.least_simulated:.2f}"
        )
    for path in written:
        click.echo(f"wrote {path}")
    return 0
