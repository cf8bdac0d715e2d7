"""softdeca animate: play a take of ARKit weights on a head by the surrogate."""

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
@click.option(
    "--surrogate", type=click.Path(path_type=Path), help="weights of `softdeca train`; default: the shipped network"
)
@click.option("--exact", is_flag=True, help="take the simulator's derivatives at bind, in seconds; on any head")
@click.option(
    "--beyond",
    type=click.Choice(["refuse", "clamp"]),
    default="refuse",
    help="parameters that the network has not seen: refuse them, or use the nearest",
)
@click.option(
    "--targets", type=counted(BAKED_TARGETS), help="also write glTF with this many morph targets, for any take"
)
@click.option("--json", "as_json", is_flag=True, help="print the result as JSON")
def animate(
    request: TakeRequest,
    surrogate: Path | None,
    exact: bool,
    beyond: str,
    targets: int | None,
    as_json: bool,
) -> int:
    """Animate TAKE by the surrogate, at the price of blendshapes. It reads and writes the files of `simulate`.

    The shipped network knows the default head's people. Other heads with their triangles also get the simulator's
    derivatives. Heads with other triangles, such as ICT-FaceKit's, get the derivatives alone, which are linear in the
    weights. The method is printed. Parameters in the TOML file may vary: one value per face of the skin.

    Writes OUT/take.vtkhdf (or .glb) and OUT/preview.gif (or .mp4). With --targets it also writes OUT/rig.glb, with the
    rig's own morph targets and the take's weights of them.
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
