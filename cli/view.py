"""softdeca view: a head on a page of its own, in 3D, with 52 sliders."""

from pathlib import Path

import click
import numpy as np

from ..lhm import fit_head, identities, load_template
from ..lhm.files.atomic import write_whole
from ..lhm.files.head_file import load_head
from ..lhm.template import DEFAULT_LEVEL
from ..reference import Parameters
from ..reference.parameter_file import read_parameters
from .progress import shown
from .written_file import HTML

AFile = click.Path(path_type=Path)
WORDS = "Turn it with the mouse or a finger; {}. The layers beneath move as the simulator says, to first order."


@click.command()
@click.argument("head_file", metavar="[HEAD]", type=AFile, required=False)
@click.option("--identities", "space_name", help="whose head ('anny' or 'ict:FILE'); with HEAD: whose expressions")
@click.option("--seed", type=click.IntRange(min=0), help="of a random identity; default: the mean")
@click.option("--parameters", "parameter_file", type=AFile, help="TOML of named parameters p; default: all defaults")
@click.option("--out", default="out/view.html", type=HTML, help="the page")
def view(
    head_file: Path | None, space_name: str | None, seed: int | None, parameter_file: Path | None, out: Path
) -> int:
    """Write a page that shows HEAD, by `head fit`, or one of --identities, with a slider for each expression.

    By blendshapes, by the simulator to first order (any head), and by the surrogate (people of its space). It opens
    in any browser with WebGL, from the file, and asks no network for anything.
    """
    from ..benchmarks.head_pictures import deltas_of
    from ..surrogate import Surrogate
    from ..viewer import Rig, face_page

    if head_file is not None and seed is not None:
        raise click.UsageError("HEAD and --seed both say which head; give one", click.get_current_context())
    parameters = Parameters() if parameter_file is None else read_parameters(parameter_file)
    rigs: list[Rig] = []
    with shown() as progress:
        progress("head", 0.0)
        if head_file is not None:
            title, head = head_file.stem, load_head(head_file)
            shapes = deltas_of(head, str(head_file), space_name)
        else:
            space = identities.from_text(space_name or "anny")
            title = f"{space.name}, {'the mean' if seed is None else f'seed {seed}'}"
            template = load_template(space, level=DEFAULT_LEVEL, progress=progress)
            code = np.zeros(space.code_size) if seed is None else space.sample(np.random.default_rng(seed))[0]
            head, shapes = fit_head(template, space.skin(code)), space.expression_deltas(code)
            surrogate = Surrogate.load()
            if surrogate.space == space.name:
                bound = surrogate.bind(head.skin, code, parameters, beyond="clamp")
                rigs.append(Rig.baked("surrogate", bound))
        progress("simulator", 0.3)
        words = WORDS.format("default parameters" if parameter_file is None else parameter_file.name)
        write_whole(out, face_page(title, words, head, parameters, shapes, rigs).encode())
        progress("page", 1.0)
    click.echo(f"wrote {out}")
    return 0
