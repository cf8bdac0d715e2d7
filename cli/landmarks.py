"""softdeca head landmarks: their names, and their places on the template or on a scan."""

import json
from pathlib import Path

import click
import numpy as np

from ..lhm import Surface, identities, load_template, scans
from ..lhm.base.files.atomic import write_whole
from ..lhm.registration import landmark_ids
from .terminal import show_progress
from .written_file import ANY

AFile = click.Path(path_type=Path)
AROUND = 30.0
"""[mm] Margin of the picture around the landmarks."""


@click.command("landmarks")
@click.option("--names", is_flag=True, help="print the names, and draw their places on the template")
@click.option("--skin", type=AFile, help="find them on this scan (OBJ, PLY, STL, glTF, NPZ)")
@click.option("--unit", metavar="UNIT", help="as for `head fit`")
@click.option("--up", type=click.Choice(scans.AXES), help="as for `head fit`")
@click.option("--front", type=click.Choice(scans.AXES), help="as for `head fit`")
@click.option("--identities", "space_name", default="anny", help="identity space of the template")
@click.option("--out", type=ANY, default="out/landmarks.json", help="file of the points, for `head fit --landmarks`")
@click.option("--picture", type=ANY, default="out/landmarks.png", help="picture of the points")
def landmarks_command(
    names: bool,
    skin: Path | None,
    unit: str | None,
    up: str | None,
    front: str | None,
    space_name: str,
    out: Path,
    picture: Path,
) -> int:
    """Name the landmarks, or find them on a scan. Look at the picture, correct the JSON, give it to `head fit`.

    The points are in the file's own unit and axes.
    """
    if names == (skin is not None):
        raise click.UsageError("either --names or --skin FILE", click.get_current_context())
    with show_progress() as progress:
        progress("landmarks", 0.0)
        template = load_template(identities.from_text(space_name), progress=progress)
        ids = landmark_ids(template.skin, template.parts)
        surface, points = template.skin, {name: template.skin.vertices[vertex] for name, vertex in ids.items()}
        if skin is not None:
            scan = scans.read_head_scan(skin, template, scans.Hints(unit, up, front), progress=progress)
            surface, points = scan.skin, scans.suggest_landmarks(scan, template, progress=progress)
            there = scan.placement.inverse(np.array(list(points.values())))
            text = {name: [float(f"{c:.6g}") for c in point] for name, point in zip(points, there, strict=True)}
            write_whole(out, json.dumps(text, indent=1).encode())
        write_whole(picture, _picture(surface, points))
        progress("landmarks", 1.0)
    if names:
        for name in points:
            click.echo(name)
    else:
        click.echo(f"wrote {out}")
    click.echo(f"wrote {picture}", err=names)
    return 0


def _picture(surface: Surface, points) -> bytes:
    from ..animation.head_pictures import FRONT, SIDE
    from ..animation.pictures import draw_labelled

    places = np.array(list(points.values()))
    framed = np.vstack([places.min(axis=0) - AROUND, places.max(axis=0) + AROUND])
    return draw_labelled(surface, points, [("from the front", FRONT), ("from the subject's left", SIDE)], framed=framed)
