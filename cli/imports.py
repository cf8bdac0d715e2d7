"""softdeca head import: turn published files into one file that softdeca reads."""

from pathlib import Path

import click

from ..lhm.base.files.npz import write_arrays
from .terminal import show_progress
from .written_file import NPZ


@click.command("import")
@click.argument("form", type=click.Choice(["ict", "bodyparts3d"]))
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
@click.option("--out", type=NPZ, help="the file to write; default: ict_facekit.npz or bodyparts3d_head.npz")
def import_files(form: str, folder: Path, out: Path | None) -> int:
    """Turn the published files in DIR into one file.

    ict: ICT-FaceKit, for `--identities ict:FILE`. DIR is FaceXModel, or a clone of the repository ICT-FaceKit by
    ICT-VGL (the vision and graphics lab of USC's Institute for Creative Technologies) on GitHub. Its licence is MIT,
    and is kept in the file.

    bodyparts3d: bones, teeth and muscles of BodyParts3D's head, for `head template --anatomy`. DIR is an unpacked
    archive of OBJ files from its download page at the Life Science Database Archive of Japan:
    BodyParts3D_3.0_obj_99.zip, or isa_BP3D_4.0_obj_99.zip of release 4.0. Credit "BodyParts3D, (c) The Database
    Center for Life Science" under the licence stated there, also for what you make of it.
    """
    if form == "ict":
        _import_ict(folder, out or Path("ict_facekit.npz"))
    else:
        _import_bodyparts3d(folder, out or Path("bodyparts3d_head.npz"))
    return 0


def _import_ict(folder: Path, out: Path) -> None:
    from ..lhm.identities import ict

    with show_progress() as progress:
        arrays = ict.read_folder(folder, progress=progress)
        space = ict.space_from_arrays(arrays, folder)
        write_arrays(out, arrays)
    vertices, expressions = len(arrays["vertices"]), len(arrays["expression_names"])
    click.echo(f"{vertices} vertices, {space.code_size} identity shapes, {expressions} expression shapes")
    _report(out, space.missing)


def _import_bodyparts3d(folder: Path, out: Path) -> None:
    from ..lhm.anatomy import bodyparts

    with show_progress() as progress:
        arrays = bodyparts.read_folder(folder, progress=progress)
        bodyparts.anatomy_from_arrays(arrays, folder)
        write_arrays(out, arrays)
    click.echo(f"{len(arrays['part_name'])} parts of {len(arrays['faces'])} triangles")
    _report(out, bodyparts.missing_parts(arrays))


def _report(out: Path, missing) -> None:
    if missing:
        click.echo(f"without {', '.join(missing)}")
    click.echo(f"wrote {out}")
