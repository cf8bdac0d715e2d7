"""softdeca take: weights from moving meshes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from ..lhm.base.files.mesh_sequence import read_mesh_sequence
from ..lhm.base.files.surface_file import MILLIMETRES, Scan
from ..lhm.base.files.text import naming_file
from ..lhm.base.mesh import Ints, Surface
from ..lhm.expressions import TrackedFace, find_neutral, fit_take, write_take
from ..reference import Parameters
from .options import FILE, argument, as_command, option
from .take_options import HeadChoice
from .terminal import show_progress
from .written_file import CSV


@click.group(no_args_is_help=False)
def take() -> None:
    """Make takes of ARKit weights."""


@as_command(take, "fit")
@dataclass(frozen=True)
class Fit:
    """Fit the weights of a head's 52 shapes to MESHES, and write them as a take that `animate` reads.

    MESHES is a folder of meshes of one triangulation, in the order of their names, or an .npz with vertices
    (frames, n, 3) and, if the head has others, triangles. Meshes of other triangles than the head's are registered on
    its skin by the frame that lies nearest to it; an expression of that frame counts as none, so one has to be neutral.
    The head's rotation is found in every frame, and written.

    The residual of a frame is the root mean square distance that shapes and rotation leave, over the area. OUT has all
    in a row of its own.
    """

    meshes: Path = argument("MESHES", type=FILE)
    head: Path | None = option(None, "head from `head fit`; default: the mean of --identities", type=FILE)
    identities: str | None = option(
        None, "identity space of the head (anny or ict:FILE); with --head: of the expressions", type=str
    )
    unit: str = option("mm", "unit of the meshes", type=click.Choice(list(MILLIMETRES)))
    fps: float = option(30.0, "frames per second of the meshes", type=float)
    out: Path = option("out/take.csv", "file of the take", type=CSV)
    json: bool = option(False, "print the result, every frame's residual with it, as JSON")

    def run(self) -> int:
        """Fit, write and report."""
        sequence = read_mesh_sequence(self.meshes, unit=self.unit)
        with show_progress() as progress:
            face = HeadChoice(self.head, self.identities).face(Parameters(), progress)
            with naming_file(self.meshes):
                first, triangles = sequence.read(0), sequence.triangles
                notes = list(sequence.notes)
                if triangles is None or has_same_triangles(triangles, face.skin.triangles):
                    tracked = TrackedFace.from_skin(face.skin, face.shapes)
                else:
                    triangles = triangles[Scan(first, triangles).sound]
                    number, off = find_neutral(face.skin, sequence, triangles)
                    neutral = Surface(sequence.read(number), triangles)
                    tracked = TrackedFace.from_mesh(face.skin, face.shapes, neutral)
                    notes.append(
                        f"{sequence.names[number]} counts as neutral: {off:.2g} mm off the head's skin in the mean"
                    )
                fitted = fit_take(
                    tracked,
                    sequence,
                    rate=self.fps,
                    on_frame=lambda number: progress("take", (number + 1) / len(sequence)),
                )
        for note in notes:
            click.echo(f"softdeca: {self.meshes}: {note}", err=True)
        residuals = fitted.residuals
        write_take(self.out, fitted.take, {"residual mm": residuals})
        mean, worst = float(residuals.mean()), int(residuals.argmax())
        if self.json:
            result = {"frames": len(residuals), "residuals_mm": residuals.tolist(), "missing": fitted.take.missing}
            click.echo(json.dumps(result | {"files": [str(self.out)]}, indent=1))
            return 0
        click.echo(
            f"{len(residuals)} frames: residual {mean:.2g} mm in the mean, "
            f"{residuals[worst]:.2g} mm at most ({sequence.names[worst]})"
        )
        if fitted.take.missing:
            click.echo(f"not fitted, since the meshes hardly move by them: {', '.join(fitted.take.missing)}")
        click.echo(f"wrote {self.out}")
        return 0


def has_same_triangles(one: Ints, other: Ints) -> bool:
    """Tell whether two lists (m, 3) have the same triangles, whatever their order and the way round."""
    first, second = (np.unique(np.sort(each, axis=1), axis=0) for each in (one, other))
    return np.array_equal(first, second)
