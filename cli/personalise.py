"""softdeca head personalise: a head's expressions from scans of its person."""

import json
from pathlib import Path

import click

from ..lhm import check_head, identities, load_template, scans
from ..lhm.arkit import ARKIT
from ..lhm.base.errors import FitError
from ..lhm.head_file import load_head, save_head
from .terminal import show_progress
from .written_file import NPZ

AFile = click.Path(path_type=Path)


@click.command()
@click.argument("head_file", metavar="HEAD", type=AFile)
@click.argument("weights", type=AFile)
@click.option(
    "--identities", "space_name", default="anny", help="identity space of the template that HEAD was fitted from"
)
@click.option("--out", type=NPZ, default="out/personal.npz", help="file of the new head")
@click.option("--json", "as_json", is_flag=True, help="print the result as JSON")
def personalise(head_file: Path, weights: Path, space_name: str, out: Path, as_json: bool) -> int:
    """Fit the expressions of HEAD to scans of its person; half a minute for each scan.

    WEIGHTS names the scans beside it and guesses what each shows: JSON, {"smile.obj": {"mouthSmileLeft": 1}, ...}, or
    CSV with the header "scan,mouthSmileLeft,..." and a line per scan. Other expressions stay as they are. Exit
    status 1 if the new head misses a gate that HEAD did not.
    """
    from ..reference.face.check import check_posed_head

    guesses = scans.read_guesses(weights)
    given = load_head(head_file)
    with show_progress() as progress:
        progress("head: template", 0.0)
        template = load_template(identities.from_text(space_name), progress=progress)
        done = scans.personalise_head(given, template, guesses, progress=progress)
        progress("head", 1.0)
    save_head(out, done.head)
    before = {figure.name for figure in (*check_head(given).gates, *check_posed_head(given)) if figure.missed}
    after = [figure for figure in (*check_head(done.head).gates, *check_posed_head(done.head)) if figure.missed]
    names = [path.name for path in guesses]
    if as_json:
        fitted = {
            name: {ARKIT[k]: round(float(w), 4) for k, w in enumerate(row) if w > 0}
            for name, row in zip(names, done.rig.weights, strict=True)
        }
        result = {"weights": fitted, "rms_mm": done.rig.history.tolist(), "notes": done.notes}
        click.echo(json.dumps(result | {"problems": [str(figure) for figure in after], "files": [str(out)]}, indent=1))
    else:
        for line in (*done.notes, *scans.describe_rig(done.rig, names)):
            click.echo(line)
        click.echo(f"wrote {out}")
    new = [str(figure) for figure in after if figure.name not in before]
    if new:
        raise FitError(f"{out} is written, but misses {'; '.join(new)}")
    return 0
