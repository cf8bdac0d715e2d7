"""softdeca view: a head on a page of its own, in 3D, with 52 sliders."""

from pathlib import Path

import click
import numpy as np

from ..lhm.base.files.atomic import write_whole
from ..lhm.base.limits import SEED
from ..reference import Parameters
from ..reference.face.parameters import read_parameters
from .counts import counted
from .take_options import HeadChoice
from .terminal import show_progress
from .written_file import HTML

AFile = click.Path(path_type=Path)
WORDS = "Turn it with the mouse or a finger; {}. The layers beneath move as the simulator says, to first order."


@click.command()
@click.argument("head_file", metavar="[HEAD]", type=AFile, required=False)
@click.option("--identities", "space_name", help="whose head ('anny' or 'ict:FILE'); with HEAD: whose expressions")
@click.option("--seed", type=counted(SEED), help="of a random identity; default: the mean")
@click.option("--parameters", "parameter_file", type=AFile, help="TOML of named parameters p; default: all defaults")
@click.option("--out", default="out/view.html", type=HTML, help="the page")
def view(
    head_file: Path | None, space_name: str | None, seed: int | None, parameter_file: Path | None, out: Path
) -> int:
    """Write a page that shows HEAD, by `head fit`, or one of --identities, with a slider for each expression.

    By blendshapes, by the simulator to first order, and by the surrogate where the head has the triangles of its
    people. It opens in any browser with WebGL, from the file, and asks no network for anything.
    """
    from ..animation.animate import bind_head
    from ..animation.page import Rig, render_face_page
    from ..surrogate import Surrogate

    which = HeadChoice(head_file, space_name, seed, None)
    parameters = Parameters() if parameter_file is None else read_parameters(parameter_file)
    named = "default parameters" if parameter_file is None else parameter_file.name
    with show_progress() as progress:
        head, shapes = which.head(progress)
        rigs, surrogate = [], Surrogate.load()
        if np.array_equal(head.skin.triangles, surrogate.weights.mean.triangles):
            served = bind_head(surrogate, head, shapes, parameters, exact=False, beyond="clamp")
            rigs.append(Rig.baked(f"surrogate: {served.method}", served.rig))
        progress("page", 0.3)
        title = which.space.name if head_file is None else head_file.stem
        write_whole(out, render_face_page(title, WORDS.format(named), head, parameters, shapes, rigs).encode())
        progress("page", 1.0)
    click.echo(f"wrote {out}")
    return 0
