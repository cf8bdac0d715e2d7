"""softdeca study: the main job."""

from pathlib import Path

import click

from .progress import shown
from .written_file import FOLDER


@click.command()
@click.option(
    "--identities", default="anny", help="whose head: 'anny' (the default), 'ict:FILE', 'flame:FILE' or 'folder:DIR'"
)
@click.option(
    "--out",
    default="out/study",
    type=FOLDER,
    help="folder of the report; the corpus in it is used again",
)
@click.option(
    "--expressions",
    default="jawOpen,mouthSmileLeft+mouthSmileRight,mouthPucker,cheekPuff,browInnerUp",
    help="ARKit expressions, separated by commas; join shapes with +, scale with *, as jawOpen*0.5",
)
@click.option(
    "--surrogate",
    type=click.Path(path_type=Path),
    help="weights to test, of `softdeca train`; by default those that are shipped, for the people they know",
)
@click.option("--json", "as_json", is_flag=True, help="print the results file to stdout")
def study(identities: str, out: Path, expressions: str, surrogate: Path | None, as_json: bool) -> int:
    """Head, scenes, every solver and the surrogate, compared: OUT/index.html and OUT/results.json.

    Exit status 1 if an answer misses its bound; a figure of speed that does is printed only.
    """
    from ..benchmarks.study import StudyConfig, run_study

    config = StudyConfig(identities=identities, out=out, expressions=tuple(expressions.split(",")), surrogate=surrogate)
    with shown() as progress:
        results = run_study(config, progress)
    if as_json:
        click.echo((out / "results.json").read_text())
    else:
        for gate in results["gates"]:
            value = "not measured" if gate["value"] is None else f"{gate['value']:.3g}"
            click.echo(f"{'ok  ' if gate['passed'] else 'MISS'} {gate['what']}: {value} ({gate['bound']})")
        for name in ("index.html", "results.json"):
            click.echo(f"wrote {out / name}")
    return 0 if all(gate["passed"] for gate in results["gates"] if gate["answer"]) else 1
