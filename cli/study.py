"""softdeca study: the main job."""

from pathlib import Path
from typing import Annotated

import typer

from .progress import shown


def study(
    identities: Annotated[str, typer.Option(help="whose head: 'anny' (the default head) or 'ict:FILE'")] = "anny",
    out: Annotated[Path, typer.Option(help="folder of the report; its corpus and surrogate are reused")] = Path(
        "out/study"
    ),
    expressions: Annotated[
        str,
        typer.Option(help="ARKit expressions, separated by commas; join shapes with +, scale with *, as jawOpen*0.5"),
    ] = "jawOpen,mouthSmileLeft+mouthSmileRight,mouthPucker,cheekPuff,browInnerUp",
    json: Annotated[bool, typer.Option("--json", help="print the results file to stdout")] = False,
) -> int:
    """Head, scenes, every solver and the surrogate, compared: OUT/index.html and OUT/results.json.

    Exit status 1 if an answer misses its bound; a figure of speed that does is printed only.
    """
    from ..benchmarks.study import StudyConfig, run_study

    config = StudyConfig(identities=identities, out=out, expressions=tuple(expressions.split(",")))
    with shown() as progress:
        results = run_study(config, progress)
    if json:
        typer.echo((out / "results.json").read_text())
    else:
        for gate in results["gates"]:
            value = "not measured" if gate["value"] is None else f"{gate['value']:.3g}"
            typer.echo(f"{'ok  ' if gate['passed'] else 'MISS'} {gate['what']}: {value} ({gate['bound']})")
        typer.echo(f"report: {out / 'index.html'}")
    return 0 if all(gate["passed"] for gate in results["gates"] if gate["answer"]) else 1
