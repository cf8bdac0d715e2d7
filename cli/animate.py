"""softdeca animate: a take of ARKit weights through the surrogate."""

import json
from dataclasses import asdict
from pathlib import Path

import click

from ..lhm.base.limits import BAKED_TARGETS
from ..lhm.template import DEFAULT_LEVEL
from .counts import counted
from .take_options import TakeRequest, take_options
from .terminal import show_progress
from .written_file import FOLDER


@click.command()
@click.argument("take")
@take_options
@click.option("--out", default="out/animation", type=FOLDER, help="folder of the results")
@click.option("--surrogate", type=click.Path(path_type=Path), help="weights of `softdeca train`; default: the shipped")
@click.option("--exact", is_flag=True, help="offset and responses by the simulator, in seconds, on any head")
@click.option(
    "--beyond",
    type=click.Choice(["refuse", "clamp"]),
    default="refuse",
    help="parameters that the network has not seen: refuse them, or take the nearest",
)
@click.option("--targets", type=counted(BAKED_TARGETS), help="write glTF of so many morph targets that serve any take")
@click.option("--json", "as_json", is_flag=True, help="print the outcome as JSON")
def animate(
    request: TakeRequest,
    surrogate: Path | None,
    exact: bool,
    beyond: str,
    targets: int | None,
    as_json: bool,
) -> int:
    """Animate TAKE by the surrogate: what `simulate` reads and writes, at the price of blendshapes.

    The shipped network serves the default head's people. A head of their triangles that is none of them takes offset
    and responses of the simulator besides; a head of other triangles, such as ICT-FaceKit's, takes these alone and
    leaves out what is not linear in the weights. The method is named. Parameters in the TOML file may vary: one value
    per face of the skin.

    Writes OUT/take.vtkhdf (or .glb) and OUT/preview.gif (or .mp4); with --targets OUT/rig.glb besides, whose morph
    targets are the rig's own, with the take's weights of them.
    """
    from ..animation.animate import animate as run
    from ..animation.animate import bind_head, bind_person
    from ..animation.play import Output
    from ..surrogate import Surrogate

    which, parameters = request.which, request.parameters
    if targets is not None and request.dynamic:
        raise click.UsageError("--targets are of static frames; leave out --dynamic", click.get_current_context())
    output = Output(**request.files)
    network = Surrogate.load(surrogate)
    with show_progress() as progress:
        if which.head_file is None and which.space.name == network.space == "anny":
            served = bind_person(
                network,
                which.code(which.space),
                parameters,
                exact=exact,
                level=which.level or DEFAULT_LEVEL,
                beyond=beyond,  # type: ignore[arg-type]
            )
        else:
            head, deltas = which.head(progress)
            served = bind_head(network, head, deltas, parameters, exact=exact, beyond=beyond)  # type: ignore[arg-type]
        result = run(output, served, request.take, progress)
        files = list(result.files)
        if targets is not None:
            served.rig.bake(targets).write_gltf(request.out / "rig.glb", request.take)
            files.append(request.out / "rig.glb")
    if as_json:
        click.echo(json.dumps(asdict(result) | {"files": files}, indent=1, default=str))
        return 0
    click.echo(
        f"{result.frames} frames by {result.method}: bound in {result.bind_seconds:.2g} s, "
        f"median {result.frame_ms:.2g} ms a frame"
    )
    for path in files:
        click.echo(path)
    return 0
