"""softdeca view: a head in a browser with sliders for weights and p, served live; or a page of it as one file."""

from pathlib import Path

import click

from ..lhm.base.files.atomic import write_whole
from ..lhm.base.limits import PORT
from ..reference import Parameters
from ..reference.face.parameters import read_parameters
from .options import count_range
from .take_options import DETAIL, SURROGATE, HeadChoice
from .terminal import show_progress
from .written_file import HTML

AFile = click.Path(path_type=Path)
WORDS = "Turn it with the mouse or a finger; {}. The layers beneath move as the simulator says, to first order."


@click.command()
@click.argument("head_file", metavar="[HEAD]", type=AFile, required=False)
@click.option(
    "--identities", "space_name", help="identity space of the head (anny or ict:FILE); with HEAD: of the expressions"
)
@click.option("--parameters", "parameter_file", type=AFile, help="TOML file of parameters p; default: all defaults")
@click.option("--surrogate", type=AFile, help="of the first answers: " + SURROGATE)
@click.option("--detail", is_flag=True, help=DETAIL)
@click.option("--port", type=count_range(PORT), help="port of the live page; default: a free one")
@click.option("--out", type=HTML, help="export a page to this file instead, with fixed parameters")
def view(
    head_file: Path | None,
    space_name: str | None,
    parameter_file: Path | None,
    surrogate: Path | None,
    detail: bool,
    port: int | None,
    out: Path | None,
) -> int:
    """Show HEAD, or the mean of --identities, in 3D, with sliders for the 52 expressions and the parameters p.

    The address is printed; only browsers on this machine reach it. The network answers while a slider moves, or
    SoftDECA's hypernetwork if --surrogate says so. The simulator's derivatives and the simulator itself then refine
    the frame, and the page shows the falling error [mm]. Ctrl-C ends it.

    With --out it writes one file, which opens in any browser with WebGL and needs no network. Its sliders move
    expressions alone: by blendshapes, derivatives, and the network if the head has the triangles of its people.
    """
    if port is not None and out is not None:
        raise click.UsageError("--port: nothing reads it with --out, which serves no page", click.get_current_context())
    which = HeadChoice(head_file, space_name)
    parameters = Parameters() if parameter_file is None else read_parameters(parameter_file)
    title = which.space.name if head_file is None else head_file.stem
    if out is None:
        _serve(which, parameters, title, surrogate, port, detail)
    else:
        words = WORDS.format("default parameters" if parameter_file is None else parameter_file.name)
        _export(which, parameters, title, words, surrogate, out, detail)
    return 0


def _serve(
    which: HeadChoice, parameters: Parameters, title: str, weights: Path | None, port: int | None, detail: bool
) -> None:
    from ..animation.live.server import serve_face
    from ..surrogate import Surrogate

    def tell(address: str) -> None:
        click.echo(f"{title}: {address} (Ctrl-C ends it)")

    def warn(line: str) -> None:
        click.echo(f"softdeca: {line}", err=True)

    with show_progress() as progress:
        face, network = which.face(parameters, progress), Surrogate.load(weights)
    serve_face(face, title, network, detail=detail, port=port, on_ready=tell, on_trouble=warn)


def _export(
    which: HeadChoice, parameters: Parameters, title: str, words: str, weights: Path | None, out: Path, detail: bool
) -> None:
    from ..animation.page import Rig, render_face_page
    from ..surrogate import Surrogate
    from ..surrogate.methods import bind_cheaply

    with show_progress() as progress:
        face, surrogate = which.face(parameters, progress), Surrogate.load(weights)
        rigs = []
        if surrogate.knows(face.skin):
            rigs.append(Rig.baked(*bind_cheaply(face, surrogate, beyond="clamp")))
        progress("page", 0.3)
        write_whole(out, render_face_page(title, words, face, rigs, detail=detail).encode())
        progress("page", 1.0)
    click.echo(f"wrote {out}")
