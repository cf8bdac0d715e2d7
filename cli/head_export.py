"""softdeca head export: a head with morph targets, for other programs."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from ..lhm.base.files.usd import check_usd
from ..lhm.scans.own_mesh import OwnMesh
from ..reference import Parameters
from ..reference.face.parameters import read_parameters
from .head import head
from .options import FILE, argument, as_command, option
from .take_options import DETAIL, HeadChoice
from .terminal import show_progress
from .written_file import RIG

STILL = 1e-6
"""[mm] below which a target moves nothing: what is carried to other vertices is rounded."""
ENDINGS = {"glb": (".glb",), "usd": (".usd", ".usdc", ".usda")}


@as_command(head, "export")
@dataclass(frozen=True)
class Export:
    """Write HEAD for other programs: its skin, with ARKit's 52 expressions as morph targets, and its eyes and teeth.

    Without --parameters the targets are blendshapes. With it, the skin is the one that settles under p, and each target
    is what the simulator makes of that expression, to first order; some seconds. Sums of targets then are off the
    simulator by what is not linear: that is measured on 8 mixed expressions, told, and written into the file.

    Eyes are nodes that turn about their own origin. Eyes and teeth are known for heads in the default triangles, as
    those of scans are.
    """

    head: Path = argument("HEAD", type=FILE)
    format: str = option("glb", "glb: glTF 2.0; usd: UsdSkel's blend shapes", type=click.Choice(list(ENDINGS)))
    parameters: Path | None = option(
        None, "TOML file of parameters p, for the simulator's targets; one that is empty has all defaults", type=FILE
    )
    identities: str | None = option(
        None, "identity space of the expressions (anny or ict:FILE); default: the head's own", type=str
    )
    detail: bool = option(False, DETAIL)
    scan: Path | None = option(
        None, "the file that the head was fitted to: its own mesh is written in place of the skin", type=FILE
    )
    out: Path | None = option(None, "the file to write; default: out/head.glb or out/head.usd", type=RIG)
    json: bool = option(False, "print the result as JSON")

    def run(self) -> int:
        """Make the rig, write it, and tell its error."""
        out = Path(f"out/head.{self.format}") if self.out is None else self.out
        if out.suffix not in ENDINGS[self.format]:
            words = f"--format {self.format} writes {' or '.join(ENDINGS[self.format])}, not {out.name}"
            raise click.UsageError(words, click.get_current_context())
        if self.detail and self.scan is not None:
            raise click.UsageError("--detail or --scan, not both", click.get_current_context())
        if self.format == "usd":
            check_usd()
        parameters = None if self.parameters is None else read_parameters(self.parameters)
        from ..animation.export import WRITERS, blended_rig, carry_rig, refine_rig, simulated_rig

        with show_progress() as progress:
            face = HeadChoice(self.head, self.identities).face(parameters or Parameters(), progress)
            own = None if self.scan is None else OwnMesh.read(self.scan, face.head)
            rig = blended_rig(face) if parameters is None else simulated_rig(face, progress)
            if self.detail:
                rig = refine_rig(rig, face.head.fine_skin)
            if own is not None:
                rig = carry_rig(rig, face.head, own)
            WRITERS[self.format](out, rig)
        surfaces, notes = [surface.name for surface in rig.surfaces], rig.notes
        moves = np.abs(rig.surfaces[0].targets).max(axis=(1, 2))
        still = [name for name, move in zip(rig.names, moves, strict=True) if move < STILL]
        if self.json:
            result = {**notes, "surfaces": surfaces, "targets": len(rig.names), "without": still, "files": [str(out)]}
            click.echo(json.dumps(result, indent=1))
            return 0
        click.echo(f"{', '.join(surfaces)}: {len(rig.names)} morph targets, {notes['method']}")
        if still:
            click.echo(f"without {', '.join(still)}")
        for part in ("mouth", "lids"):
            if part in notes:
                click.echo(f"{part}: {notes[part]}")
        if "mean_error_mm" in notes:
            regions = notes["largest_error_regions"] or "no region"
            click.echo(
                f"error to the simulator on {notes['expressions']} mixed expressions: mean "
                f"{notes['mean_error_mm']:.2g} mm, at most {notes['largest_error_mm']:.2g} mm, in "
                f"{notes['largest_error_in']}, at vertex {notes['largest_error_vertex']} ({regions})"
            )
        click.echo(f"wrote {out}")
        return 0
