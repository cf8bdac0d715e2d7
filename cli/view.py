"""softdeca view: write a page with a head in 3D and 52 sliders."""

from pathlib import Path

import click
import numpy as np

from ..lhm.base.files.atomic import write_whole
from ..lhm.base.limits import SEED
from ..reference import Parameters
from ..reference.face.parameters import read_parameters
from .options import count_range
from .take_options import HeadChoice
from .terminal import show_progress
from .written_file import HTML

AFile = click.Path(path_type=Path)
WORDS = "Turn it with the mouse or a finger; {}. The layers beneath move as the simulator says, to first order."


@click.command()
@click.argument("head_file", metavar="[HEAD]", type=AFile, required=False)
@click.option(
    "--identities", "space_name", help="identity space of the head (anny or ict:FILE); with HEAD: of the expressions"
)
@click.option("--seed", type=count_range(SEED), help="random seed of the identity; default: mean face")
@click.option("--parameters", "parameter_file", type=AFile, help="TOML file of parameters p; default: all defaults")
@click.option("--out", default="out/view.html", type=HTML, help="file of the page")
def view(
    head_file: Path | None, space_name: str | None, seed: int | None, parameter_file: Path | None, out: Path
) -> int:
    """Write a page that shows HEAD, or one of --identities, in 3D, with a slider for each expression.

    It moves by blendshapes, by the simulator's derivatives, and by the surrogate if the head has the triangles of its
    people. The file opens in any browser with WebGL and needs no network.
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
