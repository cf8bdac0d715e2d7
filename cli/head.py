"""softdeca head: fit layered heads and check them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click
import numpy as np

from ..lhm import HeadReport, LayeredHead, Template, check_head, fit_head, identities, load_template, scans
from ..lhm.base.errors import FitError
from ..lhm.base.files.atomic import write_whole
from ..lhm.base.progress import OnProgress
from ..lhm.head.file import load_head, save_head
from ..lhm.head.gates import Figure
from ..lhm.identities.arkit import ARKIT
from ..lhm.template.depths.depths import DepthRegressor
from ..lhm.template.file import read_template, save_template
from ..lhm.template.registration import landmark_ids, read_landmarks
from ..lhm.template.template import DEFAULT_LEVEL
from .options import FILE, LEVEL, argument, as_command, option, refuse_unread
from .terminal import show_progress
from .written_file import ANY, NPZ

ROUGH = (
    "the skin is rougher than a wrap can follow, or the template lies badly on it: `head show` draws where. Smooth "
    "straps, rags and hair in the scan, or give --landmarks. The head works as it is: parts that lie off move along"
)
"""Advice for a skin wrap that lies off the skin."""
AROUND = 30.0
"""[mm] Margin of the landmarks' picture."""
LEVELS = "1,212, 4,842 (default) or 19,362 vertices per wrap"


@click.group(no_args_is_help=False)
def head() -> None:
    """Fit and check layered heads."""


@as_command(head, "fit")
@dataclass(frozen=True)
class Fit:
    """Fit a layered head (wraps and tets) to a skin, write it and check it; exit status 1 if it misses a gate.

    A gate is a bound on a figure of the head, such as no inverted tet. `head check` lists them all.

    With --find-landmarks it fits nothing. It finds the landmarks on --skin, in its unit and axes, or on the mean face;
    it writes them, and draws them beside that file. Look at the picture, correct the file, give it as --landmarks.
    """

    identities: str = option("anny", "identity space: anny, ict:FILE, flame:FILE or folder:DIR")
    skin: Path | None = option(
        None, "a neutral head of any topology (OBJ, PLY, STL, glTF, NPZ); default: the mean", type=FILE
    )
    unit: str | None = option(
        None,
        f"unit of --skin: {', '.join(scans.UNITS)}, or its size in millimetres, as 49; default: detected",
        type=str,
        metavar="UNIT",
    )
    up: str | None = option(None, "axis of --skin that points up; default: detected", type=click.Choice(scans.AXES))
    front: str | None = option(
        None, "axis of --skin that its face looks along; default: detected", type=click.Choice(scans.AXES)
    )
    no_repair: bool = option(False, "take the mesh as it is, or refuse it; default: repair it and list the changes")
    landmarks: Path | None = option(None, "JSON of named points on --skin, in its own unit or in mm", type=FILE)
    find_landmarks: Path | None = option(None, "write the landmarks into this JSON file, and fit nothing", type=ANY)
    template: Path | None = option(None, "template from `head template`; default: the space's own", type=FILE)
    level: int | None = option(None, LEVELS, type=LEVEL)
    regressor: Path | None = option(None, "depths from `head train-regressor`; default: a prior", type=FILE)
    seed: int | None = option(
        None, "random seed of the identity; default: --skin, or the mean face", type=click.IntRange(min=0)
    )
    out: Path = option("out/head.npz", "file of the head", type=NPZ)
    json: bool = option(False, "print the report as JSON")

    def run(self) -> int:
        """Fit, write and report."""
        self._check()
        points = None if self.landmarks is None else read_landmarks(self.landmarks)
        hints = scans.Hints(unit=self.unit, up=self.up, front=self.front, landmarks=points)
        with show_progress() as progress:
            progress("head: identity space", 0.0)
            space = identities.from_text(self.identities)
            if self.template is None:
                template = load_template(
                    space, level=DEFAULT_LEVEL if self.level is None else self.level, progress=progress
                )
            else:
                template = read_template(self.template)
                if np.array_equal(template.skin.triangles, space.triangles):
                    template = replace(template, space=space)  # its expressions and identities fit this topology
            if self.find_landmarks is not None:
                return self._find(self.find_landmarks, template, hints, progress)
            regressor = None
            if self.regressor is not None:
                regressor = DepthRegressor.load(self.regressor, template.skin_wrap)
            if self.skin is None:
                surface = space.mean if self.seed is None else space.sample(np.random.default_rng(self.seed))[1]
                fitted = fit_head(template, surface, regressor=regressor, progress=progress)
            else:
                fitted = scans.fit_scan(
                    template, self.skin, hints, repair=not self.no_repair, regressor=regressor, progress=progress
                )
            progress("head", 1.0)
        source = f"the mean of {self.identities}" if self.seed is None else f"seed {self.seed}"
        for note in fitted.notes:
            click.echo(f"softdeca: {self.skin or source}: {note}", err=True)
        save_head(self.out, fitted)
        report_gates(check_head(fitted), self.json, [self.out], notes=fitted.notes, posed=check_posed(fitted))
        return 0

    def _check(self) -> None:
        """UsageError for options that contradict one another, or that nothing would read."""
        context = click.get_current_context()
        if self.skin is not None and self.seed is not None:
            raise click.UsageError("--skin and --seed both say which skin; give one", context)
        if self.template is not None and self.level is not None:
            raise click.UsageError("--template has a level; --level is of the space's own", context)
        if self.skin is None:
            refuse_unread(self, "without --skin", "unit", "up", "front", "no_repair", "landmarks")
        if self.find_landmarks is not None:
            refuse_unread(self, "with --find-landmarks, which fits nothing", "regressor", "seed", "out", "json")

    def _find(self, out: Path, template: Template, hints: scans.Hints, progress: OnProgress) -> int:
        """Write the landmarks of the scan, or of the template, and their picture."""
        from ..animation.head_pictures import FRONT, SIDE
        from ..animation.pictures import Panel, draw_strip

        ids = landmark_ids(template.skin, template.parts)
        surface, points = template.skin, {name: template.skin.vertices[vertex] for name, vertex in ids.items()}
        places = np.array(list(points.values()))
        there = places
        if self.skin is not None:
            scan = scans.place_scan(template, self.skin, hints, repair=not self.no_repair, progress=progress)
            surface, points = scan.skin, scans.suggest_landmarks(template, scan, progress=progress)
            places = np.array(list(points.values()))
            there = scan.placement.inverse(places)
        text = {name: [float(f"{c:.6g}") for c in point] for name, point in zip(points, there, strict=True)}
        write_whole(out, json.dumps(text, indent=1).encode())
        framed = np.vstack([places.min(axis=0) - AROUND, places.max(axis=0) + AROUND])
        views = (("from the front", FRONT), ("from the subject's left", SIDE))
        panels = [Panel(caption, surface, view=view, named=points) for caption, view in views]
        picture = out.with_suffix(".png")
        write_whole(picture, draw_strip(panels, size=560, framed=framed))
        progress("head", 1.0)
        for path in (out, picture):
            click.echo(f"wrote {path}")
        return 0


@as_command(head, "template")
@dataclass(frozen=True)
class BuildTemplate:
    """Build a template from real anatomy (some two minutes), write it and check its own head."""

    identities: str = option("ict:ict_facekit.npz", "identity space of the mean head: anny or ict:FILE")
    anatomy: Path = option(None, "bones and muscles: BodyParts3D's head as .npz", type=FILE, required=True)
    level: int = option(DEFAULT_LEVEL, "1,212, 4,842 or 19,362 vertices per wrap", type=LEVEL)
    out: Path = option("out/template.npz", "file of the template, for `head fit --template`", type=NPZ)
    json: bool = option(False, "print the report as JSON")

    def run(self) -> int:
        """Build and report."""
        from ..lhm.anatomy.template import anatomical_template

        with show_progress() as progress:
            space = identities.from_text(self.identities)
            built = anatomical_template(space, self.anatomy, level=self.level, progress=progress)
            progress("template", 1.0)
        save_template(self.out, built)
        report_gates(check_head(built.head), self.json, [self.out])
        return 0


@as_command(head, "check")
@dataclass(frozen=True)
class Check:
    """Print every gate of the head in FILE with its figure; exit status 1 if it misses one."""

    file: Path = argument("FILE", type=FILE)
    json: bool = option(False, "print the report as JSON")

    def run(self) -> int:
        """Read and report."""
        given = load_head(self.file)
        report, posed = check_head(given), check_posed(given)
        report_gates(report, self.json, notes=given.notes, posed=posed)
        return 0


@as_command(head, "personalise")
@dataclass(frozen=True)
class Personalise:
    """Fit the expressions of HEAD to scans of its person; half a minute for each scan.

    WEIGHTS names the scans beside it and guesses what each shows: JSON, {"smile.obj": {"mouthSmileLeft": 1}, ...}.
    Other expressions stay as they are. Exit status 1 if the new head misses a gate that HEAD did not.
    """

    head: Path = argument("HEAD", type=FILE)
    weights: Path = argument("WEIGHTS", type=FILE)
    identities: str = option("anny", "identity space of the template that HEAD was fitted from")
    out: Path = option("out/personal.npz", "file of the new head", type=NPZ)
    json: bool = option(False, "print the result as JSON")

    def run(self) -> int:
        """Fit, write and report."""
        guesses = scans.read_guesses(self.weights)
        given = load_head(self.head)
        with show_progress() as progress:
            progress("head: template", 0.0)
            template = load_template(identities.from_text(self.identities), progress=progress)
            done = scans.personalise_head(given, template, guesses, progress=progress)
            progress("head", 1.0)
        save_head(self.out, done.head)
        before, after = (
            [figure for figure in (*check_head(each).gates, *check_posed(each)) if figure.missed]
            for each in (given, done.head)
        )
        names = [path.name for path in guesses]
        if self.json:
            fitted = {
                name: {ARKIT[k]: round(float(w), 4) for k, w in enumerate(row) if w > 0}
                for name, row in zip(names, done.rig.weights, strict=True)
            }
            result = {"weights": fitted, "rms_mm": done.rig.history.tolist(), "notes": done.notes}
            result |= {"problems": [str(figure) for figure in after], "files": [str(self.out)]}
            click.echo(json.dumps(result, indent=1))
        else:
            for line in (*done.notes, *scans.describe_rig(done.rig, names), f"wrote {self.out}"):
                click.echo(line)
        known = {figure.name for figure in before}
        new = [str(figure) for figure in after if figure.name not in known]
        if new:
            raise FitError(f"{self.out} is written, but misses {'; '.join(new)}")
        return 0


def check_posed(moved: LayeredHead) -> tuple[Figure, ...]:
    """Check the moving head; the simulator is loaded only here."""
    from ..reference.face.check import check_posed_head

    return check_posed_head(moved)


def report_gates(
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
