"""softdeca head import-ict and import-bodyparts3d: files that others publish, made what softdeca reads."""

from pathlib import Path

import click

from ..lhm.base.files.npz import write_arrays
from .progress import shown
from .written_file import NPZ

AFolder = click.Path(path_type=Path)


@click.command("import-ict")
@click.argument("folder", type=AFolder, metavar="DIR")
@click.option("--out", type=NPZ, default="ict_facekit.npz", help="the file to write, for `--identities ict:FILE`")
def import_ict(folder: Path, out: Path) -> int:
    """Make one file of ICT-FaceKit's folder DIR, which `--identities ict:FILE` takes (half a minute).

    DIR is FaceXModel, or a clone of the repository ICT-FaceKit by ICT-VGL (the vision and graphics lab of USC's
    Institute for Creative Technologies) on GitHub. Its licence is MIT, and is kept in the file.
    """
    from ..lhm.identities import ict

    with shown() as progress:
        arrays = ict.read_folder(folder, progress=progress)
        space = ict.space_from_arrays(arrays, folder)
        write_arrays(out, arrays)
    n, names = len(arrays["vertices"]), len(arrays["expression_names"])
    click.echo(f"{n} vertices, {space.code_size} identity shapes, {names} expression shapes")
    if space.missing:
        click.echo(f"without {', '.join(space.missing)}")
    click.echo(f"wrote {out}")
    return 0


@click.command("import-bodyparts3d")
@click.argument("folder", type=AFolder, metavar="DIR")
@click.option(
    "--out", type=NPZ, default="bodyparts3d_head.npz", help="the file to write, for `head template --anatomy`"
)
def import_bodyparts3d(folder: Path, out: Path) -> int:
    """Make one file of the head's bones, teeth and muscles in DIR, which `head template --anatomy` takes.

    DIR is an unpacked archive of OBJ files from BodyParts3D's download page at the Life Science Database Archive of
    Japan: BodyParts3D_3.0_obj_99.zip, or isa_BP3D_4.0_obj_99.zip of release 4.0. Credit "BodyParts3D, (c) The
    Database Center for Life Science" under the licence stated there, and so what is made of it.
    """
    from ..lhm.anatomy import bodyparts

    with shown() as progress:
        arrays = bodyparts.read_folder(folder, progress=progress)
        bodyparts.anatomy_from_arrays(arrays, folder)
        write_arrays(out, arrays)
    click.echo(f"{len(arrays['part_name'])} parts of {len(arrays['faces'])} triangles")
    if missing := bodyparts.missing_parts(arrays):
        click.echo(f"without {', '.join(missing)}")
    click.echo(f"wrote {out}")
    return 0
