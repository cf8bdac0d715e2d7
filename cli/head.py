"""softdeca head: fit and check layered heads."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import click
import numpy as np

from ..lhm import HeadReport, LayeredHead, Template, check_head, fit_head, identities, load_template, scans
from ..lhm.base.errors import FitError, InputError
from ..lhm.base.files.atomic import write_whole
from ..lhm.check import Figure
from ..lhm.head_file import export_vtk, load_head, naming_damage, read_parts, save_head
from ..lhm.identities import LinearSpace
from ..lhm.registration import read_landmarks
from ..lhm.regressor.depths import DepthRegressor
from ..lhm.template import DEFAULT_LEVEL
from ..lhm.template_file import read_template, save_template
from .imports import import_files
from .landmarks import landmarks_command
from .personalise import personalise
from .terminal import show_progress
from .train_regressor import train_regressor
from .written_file import ANY, FOLDER, NPZ, PNG

ROUGH = (
    "the skin is rougher than a wrap can follow, or the template lies badly on it: `head show` draws where. Smooth "
    "straps, rags and hair in the scan, or give --landmarks. The head works as it is: parts that lie off move along"
)
"""Advice for a skin wrap that lies off the skin."""
AFile = click.Path(path_type=Path)
as_json_option = click.option("--json", "as_json", is_flag=True, help="print the report as JSON")


@click.group(no_args_is_help=False)
def head() -> None:
    """Fit and check layered heads."""


head.add_command(train_regressor)
head.add_command(landmarks_command)
head.add_command(personalise)
head.add_command(import_files)


@head.command()
@click.option(
    "--identities", "space_name", default="anny", help="identity space: anny, ict:FILE, flame:FILE or folder:DIR"
)
@click.option("--skin", type=AFile, help="a neutral head of any topology (OBJ, PLY, STL, glTF, NPZ); default: the mean")
@click.option(
    "--unit", metavar="UNIT", help=f"of --skin: {', '.join(scans.UNITS)} or millimetres, as 49; default: detected"
)
@click.option("--up", type=click.Choice(scans.AXES), help="axis of --skin that points up; default: detected")
@click.option(
    "--front", type=click.Choice(scans.AXES), help="axis of --skin that its face looks along; default: detected"
)
@click.option(
    "--no-repair", is_flag=True, help="take the mesh as it is, or refuse it; default: repair it and list the changes"
)
@click.option("--keep-sealed", is_flag=True, help="keep a sealed mouth closed; default: open it between the lips")
@click.option("--landmarks", type=AFile, help="JSON of named points on --skin, in its own unit or in mm")
@click.option("--template", "template_file", type=AFile, help="template from `head template`; default: the space's own")
@click.option("--level", type=click.IntRange(1, 3), help="1,212, 4,842 (default) or 19,362 vertices per wrap")
@click.option("--regressor", "regressor_file", type=AFile, help="depths from `head train-regressor`; default: a prior")
@click.option(
    "--seed", type=click.IntRange(min=0), help="random seed of the identity; default: --skin, or the mean face"
)
@click.option("--out", type=NPZ, default="out/head.npz", help="file of the head")
@click.option("--vtk", type=FOLDER, help="also write .vtu files into this folder")
@click.option("--picture", type=PNG, help="also draw the layers into this PNG")
@as_json_option
def fit(
    space_name: str,
    skin: Path | None,
    unit: str | None,
    up: str | None,
    front: str | None,
    no_repair: bool,
    keep_sealed: bool,
    landmarks: Path | None,
    template_file: Path | None,
    level: int | None,
    regressor_file: Path | None,
    seed: int | None,
    out: Path,
    vtk: Path | None,
    picture: Path | None,
    as_json: bool,
) -> int:
    """Fit a layered head (wraps and tets) to a skin, write it and check it; exit status 1 if it misses a gate.

    A gate is a bound on a figure of the head, such as no inverted tet. `head check` lists them all.
    """
    if skin is not None and seed is not None:
        raise click.UsageError("--skin and --seed both say which skin; give one", click.get_current_context())
    about = {"--unit": unit, "--up": up, "--front": front, "--landmarks": landmarks}
    for option in about if skin is None else ():
        if about[option] is not None:
            raise click.UsageError(f"{option} is of --skin, which is not given", click.get_current_context())
    if template_file is not None and level is not None:
        raise click.UsageError("--template has a level; --level is of the space's own", click.get_current_context())
    points = None if landmarks is None else read_landmarks(landmarks)
    where = scans.Hints(unit=unit, up=up, front=front, landmarks=points)
    with show_progress() as progress:
        progress("head: identity space", 0.0)
        space = identities.from_text(space_name)
        if template_file is None:
            template = load_template(space, level=level or DEFAULT_LEVEL, progress=progress)
        else:
            template = _in_space(read_template(template_file), space)
        regressor = None
        if regressor_file is not None:
            regressor = DepthRegressor.load(regressor_file, template.skin_wrap)
        if skin is None:
            surface = space.mean if seed is None else space.sample(np.random.default_rng(seed))[1]
            fitted = fit_head(template, surface, regressor=regressor, progress=progress)
        elif (own := scans.read_same_topology(skin, template, where)) is not None:
            surface, notes = own
            for note in notes:
                click.echo(f"softdeca: {skin}: {note}", err=True)
            fitted = replace(fit_head(template, surface, regressor=regressor, progress=progress), notes=notes)
        else:
            scan = scans.read_head_scan(skin, template, where, repair=not no_repair, progress=progress)
            for note in scan.notes:
                click.echo(f"softdeca: {skin}: {note}", err=True)
            fitted = scans.fit_head_scan(scan, template, regressor=regressor, unseal=not keep_sealed, progress=progress)
            for note in fitted.notes[len(scan.notes) :]:
                click.echo(f"softdeca: {skin}: {note}", err=True)
        progress("head", 1.0)
    save_head(out, fitted)
    written = [out, *(export_vtk(vtk, fitted) if vtk is not None else ())]
    if picture is not None:
        from ..animation.pictures import draw_cut_away

        write_whole(picture, draw_cut_away(fitted))
        written.append(picture)
    _warn(skin or out, {} if fitted.rig is None else fitted.rig.doubtful)
    _report(check_head(fitted), as_json, written, notes=fitted.notes, posed=_posed(fitted))
    return 0


@head.command()
@click.option(
    "--identities",
    "space_name",
    default="ict:ict_facekit.npz",
    help="identity space of the mean head: anny or ict:FILE",
)
@click.option("--anatomy", type=AFile, required=True, help="bones and muscles: BodyParts3D's head as .npz")
@click.option("--level", type=click.IntRange(1, 3), default=2, help="1,212, 4,842 or 19,362 vertices per wrap")
@click.option("--out", type=NPZ, default="out/template.npz", help="file of the template, for `head fit --template`")
@as_json_option
def template(space_name: str, anatomy: Path, level: int, out: Path, as_json: bool) -> int:
    """Build a template from real anatomy (some two minutes), write it and check its own head."""
    from ..lhm.anatomy.template import anatomical_template

    with show_progress() as progress:
        built = anatomical_template(identities.from_text(space_name), anatomy, level=level, progress=progress)
        progress("template", 1.0)
    save_template(out, built)
    _report(check_head(built.head), as_json, [out])
    return 0


@head.command()
@click.argument("file", type=AFile)
@as_json_option
def check(file: Path, as_json: bool) -> int:
    """Print every gate of the head in FILE with its figure; exit status 1 if it misses one."""
    with naming_damage(file, "a layered head"):
        parts = read_parts(file)
        _warn(file, {} if parts.rig is None else parts.rig.doubtful)
        report = parts.report()
        # A head with inverted tets at rest cannot be moved.
        moves = report.inverted_tets == 0 and report.least_volume > 0
        posed = _posed(parts.head()) if moves else ()
    _report(report, as_json, notes=parts.notes, posed=posed)
    return 0


@head.command()
@click.argument("file", type=AFile)
@click.option("--out", type=FOLDER, default="out/head", help="folder of the pictures")
@click.option("--expression", help="simulate this expression, as jawOpen*0.5+cheekPuff, for layers and sections")
@click.option(
    "--identities", "space_name", help="identity space of the expressions (anny or ict:FILE); default: the head's own"
)
@click.option("--vtk", type=FOLDER, help="also write .vtu files into this folder")
def show(file: Path, out: Path, expression: str | None, space_name: str | None, vtk: Path | None) -> int:
    """Draw the head in FILE as PNG files in OUT: layers cut open, sections, fit, worst tets."""
    from ..animation.head_pictures import draw_head, expression_deltas, pose_head
    from ..lhm import expressions

    weights = None if expression is None else expressions.parse_weights(expression)
    shown_head = load_head(file)
    for note in shown_head.notes:
        click.echo(f"softdeca: {file}: {note}", err=True)
    if shown_head.rig is not None and space_name is None:
        _warn(file, shown_head.rig.doubtful)
    with show_progress() as progress:
        progress("pictures", 0.0)
        pose = None
        if weights is not None:
            pose = pose_head(shown_head, expression_deltas(shown_head, str(file), space_name), weights)
        for name, png in draw_head(shown_head, pose=pose).items():
            write_whole(out / f"{name}.png", png)
            click.echo(out / f"{name}.png")
        progress("pictures", 1.0)
    for path in export_vtk(vtk, shown_head) if vtk is not None else ():
        click.echo(path)
    return 0


@head.command()
@click.argument("file", type=AFile)
@click.option("--layers", default="1,1", help="layers of soft tissue and of muscle")
@click.option(
    "--size", type=float, help="free tets of at most this size [mm] between the wraps, by gmsh, instead of layers"
)
@click.option("--out", type=ANY, default="out/head.msh", help="file of the mesh: .msh, .vtu, .xdmf or .mesh")
@as_json_option
def mesh(file: Path, layers: str, size: float | None, out: Path, as_json: bool) -> int:
    """Write the tets of the head in FILE with tags and surfaces, and report their shape.

    Tags: 1 soft tissue, 2 muscle; surfaces 11 skin wrap, 12 muscle wrap, 13 skull wrap.
    """
    from ..lhm.base.files import tet_file
    from ..lhm.base.geometry.tets import tet_quality
    from ..lhm.head_file import tets_from_head
    from ..lhm.remesh import remesh

    counts = _counts(layers)
    if size is not None and counts != (1, 1):
        raise click.UsageError("--layers and --size both say which tets; give one", click.get_current_context())
    meshed = load_head(file)
    if size is not None:
        meshed = remesh(meshed, size)
    tagged = tets_from_head(meshed, counts)
    tet_file.write_tets(out, tagged)
    vertices, tets = tagged.mesh.vertices, tagged.mesh.tets
    report = {
        tagged.names[int(tag)]: {"tag": int(tag), **asdict(tet_quality(vertices, tets[tagged.tags == tag]))}
        for tag in np.unique(tagged.tags)
    }
    if as_json:
        click.echo(json.dumps({"file": str(out), "vertices": len(vertices), "tissues": report}, indent=1))
        return 0
    for name, figures in report.items():
        for key, value in figures.items():
            click.echo(f"{name.replace('_', ' ')}, {key.replace('_', ' ')}: {value:.6g}")
    click.echo(f"{len(vertices)} vertices")
    click.echo(f"wrote {out}")
    return 0


def _counts(text: str) -> tuple[int, int]:
    try:
        soft, muscle = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"layers {text!r}: expected two counts, as 2,2") from None
    return soft, muscle


def _in_space(template: Template, space: LinearSpace) -> Template:
    """Give a template its expressions and identities, if it has the topology of this space."""
    same = np.array_equal(template.skin.triangles, space.triangles)
    return replace(template, space=space) if same else template


def _warn(file: Path, doubtful: Mapping[str, str]) -> None:
    """Print a line for each reason why expressions will not look right."""
    for reason in dict.fromkeys(doubtful.values()):
        names = ", ".join(name for name, why in doubtful.items() if why == reason)
        click.echo(f"softdeca: {file}: {reason}; not right: {names}", err=True)


def _posed(moved: LayeredHead) -> tuple[Figure, ...]:
    from ..reference.face.check import check_posed_head

    return check_posed_head(moved)


def _report(
    report: HeadReport,
    as_json: bool,
    written: Sequence[Path] = (),
    *,
    notes: Sequence[str] = (),
    posed: Sequence[Figure] = (),
) -> None:
    """Print the figures and the files. FitError names the missed gates, and the files that were written nevertheless.

    `posed`: gates of the moving head.
    """
    all_gates = (*report.gates, *posed)
    problems = [*report.problems, *(str(gate) for gate in posed if gate.missed)]
    if as_json:
        gates = [asdict(gate) | {"passed": not gate.missed} for gate in all_gates]
        files = {"files": [str(path) for path in written]} if written else {}
        more = {"gates": gates, "problems": problems, "notes": list(notes)}
        click.echo(json.dumps(asdict(report) | {gate.name: gate.value for gate in posed} | more | files, indent=1))
    else:
        for figure in (*report.figures, *posed):
            mark = "" if figure.bound is None else "MISSED" if figure.missed else "ok"
            click.echo(f"{mark:<7}{figure}")
        for note in notes:
            click.echo(f"{'':<7}{note}")
        for path in written:
            click.echo(f"wrote {path}")
    if problems:
        missed = "; ".join(problems)
        if any(gate.missed for gate in all_gates if gate.name == "wrap_to_skin_mean"):
            missed += f" ({ROUGH})"
        raise FitError(f"{written[0]} is written, but misses {missed}" if written else missed)
