"""softdeca head: fit and check layered heads."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..lhm import check_head, fit_head, identities, load_template
from ..lhm.atomic import replaced
from ..lhm.errors import FitError
from ..lhm.head import LayeredHead
from ..lhm.head_file import export_vtk, load_head, save_head
from ..lhm.surface_file import read_surface
from .progress import shown

app = typer.Typer(help="Fit and check layered heads.", no_args_is_help=True)
AsJson = Annotated[bool, typer.Option("--json", help="print the report as JSON")]


@app.command()
def fit(
    identity_space: Annotated[
        str, typer.Option("--identities", help="whose topology: 'anny' (the default head) or 'ict:FILE'")
    ] = "anny",
    skin: Annotated[
        Path | None,
        typer.Option(help="a neutral skin of that topology (OBJ, PLY, STL); default: a sampled or mean one"),
    ] = None,
    unit: Annotated[str, typer.Option(help="unit of --skin: mm, cm or m")] = "mm",
    seed: Annotated[int | None, typer.Option(help="sample a random identity; default: the mean")] = None,
    out: Annotated[Path, typer.Option(help="the head to write")] = Path("out/head.npz"),
    vtk: Annotated[Path | None, typer.Option(help="also write .vtu files into this folder")] = None,
    picture: Annotated[Path | None, typer.Option(help="also draw the layers into this PNG")] = None,
    as_json: AsJson = False,
) -> int:
    """Fit the layered head (wraps and tets) to a skin, check it and write it."""
    space = identities.from_text(identity_space)
    surface = None if skin is None else read_surface(skin, unit=unit)
    with shown() as progress:
        template = load_template(space, progress=progress)
        if surface is None:
            surface = space.mean if seed is None else space.sample(np.random.default_rng(seed))[1]
        head = fit_head(template, surface)
    status = _report(head, as_json)
    save_head(out, head)
    if vtk is not None:
        export_vtk(vtk, head)
    if picture is not None:
        from ..benchmarks.pictures import cut_away

        with replaced(picture) as path:
            path.write_bytes(cut_away(head))
    return status


@app.command()
def check(file: Annotated[Path, typer.Argument(help="a head written by `head fit`")], as_json: AsJson = False) -> int:
    """Print every gate of a layered head with its figure; exit status 1 if one is not met."""
    return _report(load_head(file), as_json)


def _report(head: LayeredHead, as_json: bool) -> int:
    report = check_head(head)
    if as_json:
        typer.echo(json.dumps(asdict(report) | {"problems": list(report.problems)}, indent=1))
    else:
        for name, value in asdict(report).items():
            typer.echo(
                f"{name.replace('_', ' '):<40} {value:.4g}" if isinstance(value, float) else f"{name:<40} {value}"
            )
    if report.problems:
        raise FitError("; ".join(report.problems))
    return 0
