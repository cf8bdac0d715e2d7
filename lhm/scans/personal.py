"""A head whose expressions are the person's: scans of them are laid upon the head, and its rig is fitted to these.

`read_guesses` reads which expressions the scans show, by guess, from JSON; the scans lie beside that file:

{"smile.obj": {"mouthSmileLeft": 1, "mouthSmileRight": 1}, "open.ply": {"jawOpen": 0.8}}
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..base.errors import FitError, InputError, SoftdecaError
from ..base.files.surface_file import read_scan
from ..base.files.text import find_beside, read_json
from ..base.geometry.warp import fit_similarity, rigid_motion
from ..base.mesh import Floats, Surface
from ..base.progress import OnProgress, silent
from ..expressions.rig import Rig
from ..expressions.rigging import PersonalRig, personalise
from ..head.head import LayeredHead
from ..head.skin import check_registrable
from ..identities.arkit import ARKIT, weights_of
from ..template.fit import has_triangles_of
from ..template.registration.alignment import Target, find_start, tukey_weights
from ..template.registration.nonrigid import lay_onto
from ..template.registration.registration import BOUNDS, find_face
from ..template.template import Template
from ..template.wraps.landmarks import Landmarks
from .placing import UNITS, find_placement
from .repair import repair_scan

CALM = 0.5
"""The share of the face, where the guessed expressions move it least, by which a scan is aligned."""
SAME_SIZE = 0.03
"""A scan of the same person differs from the head by less than this; what is beyond is its unit."""
STEPS = 30


@dataclass(frozen=True, eq=False)
class Personal:
    """`head` with its new rig; `rig`: shapes, weights as fitted and history; `notes`: a line for each scan."""

    head: LayeredHead
    rig: PersonalRig
    notes: tuple[str, ...]


def personalise_head(
    head: LayeredHead,
    template: Template,
    guesses: Mapping[Path, Floats],
    *,
    progress: OnProgress = silent,
) -> Personal:
    """Fit the head's rig to scans of its person, files as `read_scan` reads (half a minute each).

    `guesses`: by file the ARKit weights (52,) that the person may be making in it; expressions that none of them has
    stay as they are. A scan with the triangles of the head's skin is aligned to it where they move it least; upon any
    other the head is laid, from the expression guessed. Raises InputError, naming the file, for a scan that cannot be
    read or holds no face of that expression, and for a head or template that cannot serve.
    """
    if head.rig is None:
        raise InputError("head: it has no expressions to start from; fit it anew")
    if not guesses:
        raise InputError("scans: none given")
    if not np.array_equal(head.skin.triangles, template.skin.triangles):
        raise InputError(f"head: it was not fitted from the template {template.name!r}; name its --identities")
    used = np.flatnonzero(np.any(list(guesses.values()), axis=0))
    laying = _Laying(head.skin, head.rig.deltas.astype(np.float64), template, used)
    examples, notes = [], []
    for number, (path, weights) in enumerate(guesses.items()):
        progress(f"laying the head upon {path.name}", number / len(guesses))
        try:
            example, note = laying.example(path, weights)
        except SoftdecaError as error:
            raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
        examples.append(example)
        notes.append(f"{path.name}: {note}")
    progress("fitting the expressions", 1.0)
    fitted = personalise(head.skin, head.rig.deltas, examples, np.array(list(guesses.values())))
    source = f"personalised from {len(examples)} scans, {len(used)} of {len(ARKIT)} shapes; else {head.rig.source}"
    missing = tuple(name for name in head.rig.missing if ARKIT.index(name) not in used)
    rig = Rig(fitted.deltas.astype(np.float32), source, missing)
    return Personal(replace(head, rig=rig, notes=(*head.notes, source)), fitted, tuple(notes))


@dataclass(frozen=True, eq=False)
class _Laying:
    """Lays a head's `skin` [mm] upon scans; its rig's `deltas` [mm], shape (52, n, 3), those `used` by the guesses."""

    skin: Surface
    deltas: Floats
    template: Template
    used: np.ndarray

    def example(self, path: Path, weights: Floats) -> tuple[Floats, str]:
        """Make the head's skin [mm] in a scan's expression, and what is said of it."""
        scan = read_scan(path)
        places, face = find_face(self.template.skin, self.template.parts)
        if has_triangles_of(self.template, scan):
            return self._align(scan.vertices, face)
        return self._lay(repair_scan(scan).scan.surface, weights, places, face)

    def _align(self, points: Floats, face: np.ndarray) -> tuple[Floats, str]:
        """Points of the skin's own triangles, in any unit and place, where the expressions move the skin least."""
        skin = self.skin
        calm = _calm(self.deltas[self.used], face)
        similarity = fit_similarity(points[calm], skin.vertices[calm])
        scale = min(UNITS.values(), key=lambda unit: abs(np.log(unit / similarity.scale)))
        scale = scale if abs(scale / similarity.scale - 1) < SAME_SIZE else similarity.scale
        rotation, shift = rigid_motion(scale * points[calm], skin.vertices[calm])
        aligned = scale * points @ rotation.T + shift
        off = float(np.linalg.norm(aligned[calm] - skin.vertices[calm], axis=1).mean())
        if off > BOUNDS.worst_start:
            raise FitError(f"it has the head's triangles, but is {off:.1f} mm off where the expressions are calm")
        return aligned, f"the head's own triangles; {off:.2f} mm off where the expressions are calm"

    def _lay(self, scan: Surface, weights: Floats, places: Landmarks, face: np.ndarray) -> tuple[Floats, str]:
        """The skin, laid upon the scan from the guessed expression."""
        start = self.skin.with_vertices(self.skin.vertices + np.tensordot(weights, self.deltas, axes=1))
        shape, normals = start.vertices, start.vertex_normals
        where = find_placement(scan, (shape[face], normals[face]))
        upright = check_registrable(Surface(where.motion(scan.vertices), scan.triangles))
        motion, score = find_start(shape[face], normals[face], Target(upright))
        if score > BOUNDS.worst_start:
            raise FitError(f"skin: the head's face is {score:.1f} mm off it, at most {BOUNDS.worst_start:g}")
        size = motion.scale if abs(motion.scale - 1) > SAME_SIZE else 1.0
        moved = (upright.vertices - motion.shift) @ motion.rotation / size
        calm = _calm(self.deltas[self.used], face)
        target = Target(Surface(_settle(moved, upright, shape[calm], normals[calm]), upright.triangles))
        x, _ = lay_onto(start, self.template.parts, places, target, None, silent)
        off = float(target.tree.closest(x[face])[2].mean())
        if off > BOUNDS.worst_face:
            raise FitError(
                f"skin: the face laid upon it is {off:.1f} mm off, at most {BOUNDS.worst_face:g}; another guess?"
            )
        return x, f"{where.notes[0]}; laid upon it to {off:.2f} mm"


def _calm(deltas: Floats, face: np.ndarray) -> np.ndarray:
    """The vertices of a face, mask (n,), that shapes (k, n, 3) move least."""
    most = np.linalg.norm(deltas, axis=2).max(axis=0)
    return face & (most <= np.quantile(most[face], CALM))


def _settle(points: Floats, skin: Surface, calm: Floats, normals: Floats) -> Floats:
    """A scan's points [mm] after the rigid motions that bring it closest to the calm points of a face."""
    for limit in np.geomspace(10.0, 2.0, STEPS):
        closest, distance, weight = Target(Surface(points, skin.triangles)).match(calm, normals)
        near = (weight * tukey_weights(distance, limit)) > 0.2
        if near.sum() < 0.25 * len(calm):
            break
        rotation, shift = rigid_motion(closest[near], calm[near])
        points = points @ rotation.T + shift
    return points


def describe_rig(rig: PersonalRig, names: Sequence[str]) -> list[str]:
    """Describe what was fitted, a line each: expressions found in each scan, and how far the rig is from the scans."""
    lines = []
    for name, weights in zip(names, rig.weights, strict=True):
        largest = sorted(np.flatnonzero(weights > 0.01), key=lambda k: -weights[k])
        lines.append(f"{name}: " + (", ".join(f"{ARKIT[k]} {weights[k]:.2f}" for k in largest) or "neutral"))
    lines.append(f"rig to scans: {rig.history[0]:.2f} mm with the shapes before, {rig.history[-1]:.2f} mm with these")
    return lines


def read_guesses(path: str | os.PathLike[str]) -> dict[Path, Floats]:
    """Read weights (52,) by scan, in the file's order; InputError names the file, the scan and the expression."""
    path = Path(path)
    rows = read_json(path, "a JSON file of guesses")
    try:
        return _weights(rows, path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _weights(rows: object, path: Path) -> dict[Path, Floats]:
    if not isinstance(rows, dict):
        raise InputError('expected weights by scan, {"smile.obj": {"mouthSmileLeft": 1}, ...}')
    by_scan: dict[Path, Floats] = {}
    for name, named in rows.items():
        scan = find_beside(path, name)
        if scan in by_scan:
            raise InputError(f"{name:.80}: it stands there twice")
        try:
            by_scan[scan] = weights_of(named)
        except InputError as error:
            raise InputError(f"{name:.80}: {error}") from None
    if not any(weights.any() for weights in by_scan.values()):
        raise InputError("no scan shows an expression; expected weights as {'smile.obj': {'mouthSmileLeft': 1}}")
    return by_scan
