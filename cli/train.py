"""softdeca train: the surrogate of an identity space, without the study around it."""

import json
from pathlib import Path

import click

from ..lhm import identities, load_template
from .progress import shown


@click.command()
@click.option(
    "--identities", "space_name", default="anny", help="whose heads: anny, ict:FILE, flame:FILE or folder:DIR"
)
@click.option(
    "--out",
    default="out/study/surrogate",
    type=click.Path(path_type=Path),
    help="folder of corpus and network, the study's; what is there is used again",
)
@click.option("--json", "as_json", is_flag=True, help="print the figures as JSON")
def train(space_name: str, out: Path, as_json: bool) -> int:
    """Simulate a corpus, train the surrogate and test it on unseen identities (some minutes, without FEniCSx).

    The default head's is kept where `Surrogate.load()` finds it. Exit status 1 if it is no better than blendshapes.
    """
    from ..benchmarks import learned
    from ..surrogate.runtime import default_path

    with shown() as progress:
        space = identities.from_text(space_name)
        figures, _ = learned.study(space, load_template(space, progress=progress), out, progress)
    if as_json:
        click.echo(json.dumps(figures, indent=1))
    else:
        for name in ("surrogate", "blendshapes"):
            errors = figures["test"][name]
            click.echo(
                f"{name:<12} error mean {errors['mean']:.3f}  95 % {errors['p95']:.3f}  max {errors['max']:.3f} mm"
            )
        click.echo(f"corpus and network: {out}")
        if space.name == "anny":
            click.echo(f"network: {default_path()}")
    return 0 if figures["test"]["gain"] > 1.0 else 1
