"""softdeca head show, mesh and import: pictures and tets of a head, and published files as one file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np

from ..lhm.base.errors import InputError, quote
from ..lhm.base.files.atomic import write_whole
from ..lhm.base.files.npz import write_arrays
from ..lhm.head.file import load_head
from .head import head
from .options import FILE, argument, as_command, option, refuse_unread
from .take_options import DETAIL
from .terminal import show_progress
from .written_file import ANY, FOLDER, NPZ


@as_command(head, "show")
@dataclass(frozen=True)
class Show:
    """Draw the head in FILE as PNG files in OUT: layers cut open, sections, fit, worst tets."""

    file: Path = argument("FILE", type=FILE)
    out: Path = option("out/head", "folder of the pictures", type=FOLDER)
    expression: str | None = option(
        None, "simulate this expression, as jawOpen*0.5+cheekPuff, for layers and sections", type=str
    )
    identities: str | None = option(
        None, "identity space of the expressions (anny or ict:FILE); default: the head's own", type=str
    )
    detail: bool = option(False, DETAIL)

    def run(self) -> int:
        """Draw and write."""
        from ..animation.head_pictures import draw_head, expression_deltas, pose_head
        from ..lhm import expressions

        if self.expression is None:
            refuse_unread(self, "without --expression", "identities")
        weights = None if self.expression is None else expressions.parse_weights(self.expression)
        shown = load_head(self.file)
        for note in shown.notes:
            click.echo(f"softdeca: {self.file}: {note}", err=True)
        with show_progress() as progress:
            progress("pictures", 0.0)
            pose = None
            if weights is not None:
                pose = pose_head(shown, expression_deltas(shown, str(self.file), self.identities), weights)
            for name, png in draw_head(shown, pose=pose, detail=self.detail).items():
                write_whole(self.out / f"{name}.png", png)
                click.echo(self.out / f"{name}.png")
            progress("pictures", 1.0)
        return 0


@as_command(head, "mesh")
@dataclass(frozen=True)
class WriteMesh:
    """Write the tets of the head in FILE with tags and surfaces, and report their shape.

    Tags: 1 soft tissue, 2 muscle; surfaces 11 skin wrap, 12 muscle wrap, 13 skull wrap.
    """

    file: Path = argument("FILE", type=FILE)
    layers: str = option("1,1", "layers of soft tissue and of muscle")
    size: float | None = option(
        None,
        "free tets of at most this size [mm] between the wraps, by gmsh, instead of layers; by the wraps they are as "
        "large as their triangles",
        type=float,
    )
    out: Path = option(
        "out/head.msh", "file of the mesh: .msh, .vtu, .mesh, .usd, or .xdmf with an .h5 beside", type=ANY
    )
    json: bool = option(False, "print the report as JSON")

    def run(self) -> int:
        """Mesh, write and report."""
        from ..lhm.base.files import tet_file
        from ..lhm.base.geometry.tets import tet_quality
        from ..lhm.base.geometry.topology import unique_edges
        from ..lhm.head.file import tets_from_head
        from ..lhm.head.remesh import remesh

        counts = parse_layers(self.layers)
        meshed = load_head(self.file)
        if self.size is not None:
            given = meshed.skin_wrap
            edge = float(np.linalg.norm(np.diff(given.vertices[unique_edges(given.triangles)], axis=1), axis=2).mean())
            if self.size < edge:
                click.echo(
                    f"softdeca: --size {self.size:g}: the wraps' triangles have edges of {edge:.2g} mm; tets in layers "
                    "that are as thin are no smaller, and `head fit --level` makes finer wraps",
                    err=True,
                )
            meshed = remesh(meshed, self.size)
        tagged = tets_from_head(meshed, counts)
        tet_file.write_tets(self.out, tagged)
        vertices, tets = tagged.mesh.vertices, tagged.mesh.tets
        report = {
            tagged.names[int(tag)]: {"tag": int(tag), **asdict(tet_quality(vertices, tets[tagged.tags == tag]))}
            for tag in np.unique(tagged.tags)
        }
        if self.json:
            click.echo(json.dumps({"file": str(self.out), "vertices": len(vertices), "tissues": report}, indent=1))
            return 0
        for name, figures in report.items():
            for key, value in figures.items():
                click.echo(f"{name.replace('_', ' ')}, {key.replace('_', ' ')}: {value:.6g}")
        click.echo(f"{len(vertices)} vertices")
        click.echo(f"wrote {self.out}")
        return 0


def parse_layers(text: str) -> tuple[int, int]:
    """Read the counts of layers of soft tissue and muscle, as 2,2; InputError for another text."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2 or not all(part.isascii() and part.isdecimal() and len(part) < 9 for part in parts):
        raise InputError(f"layers {quote(text)!r}: expected two counts, as 2,2")
    return int(parts[0]), int(parts[1])


@as_command(head, "import")
@dataclass(frozen=True)
class Import:
    """Turn the published files in DIR into one file.

    ict: ICT-FaceKit, for `--identities ict:FILE`. DIR is FaceXModel, or a clone of the repository ICT-FaceKit by
    ICT-VGL (the vision and graphics lab of USC's Institute for Creative Technologies) on GitHub. Its licence is MIT,
    and is kept in the file.

    bodyparts3d: bones, teeth and muscles of BodyParts3D's head, for `head template --anatomy`. DIR is an unpacked
    archive of OBJ files from its download page at the Life Science Database Archive of Japan:
    BodyParts3D_3.0_obj_99.zip, or isa_BP3D_4.0_obj_99.zip of release 4.0. Credit "BodyParts3D, (c) The Database
    Center for Life Science" under the licence stated there, also for what you make of it.
    """

    form: str = argument("{ict|bodyparts3d}", type=click.Choice(["ict", "bodyparts3d"]))
    folder: Path = argument("DIR", type=FILE)
    out: Path | None = option(None, "the file to write; default: ict_facekit.npz or bodyparts3d_head.npz", type=NPZ)

    def run(self) -> int:
        """Read, check and write."""
        missing: Sequence[str]
        with show_progress() as progress:
            if self.form == "ict":
                from ..lhm.identities import ict

                arrays, out = ict.read_folder(self.folder, progress=progress), self.out or Path("ict_facekit.npz")
                space = ict.space_from_arrays(arrays, self.folder)
                count, missing = len(arrays["expression_names"]), space.missing
                summary = (
                    f"{len(arrays['vertices'])} vertices, {space.code_size} identity shapes, {count} expression shapes"
                )
            else:
                from ..lhm.anatomy import bodyparts

                out = self.out or Path("bodyparts3d_head.npz")
                arrays = bodyparts.read_folder(self.folder, progress=progress)
                bodyparts.anatomy_from_arrays(arrays, self.folder)
                missing = bodyparts.missing_parts(arrays)
                summary = f"{len(arrays['part_name'])} parts of {len(arrays['faces'])} triangles"
            write_arrays(out, arrays)
        click.echo(summary)
        if missing:
            click.echo(f"without {', '.join(missing)}")
        click.echo(f"wrote {out}")
        return 0
