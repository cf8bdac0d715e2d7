"""Scans: read from a file, repaired, put upright in millimetres, and fitted; notes say what was done."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arkit import find_arkit_morphs
from ..base.errors import InputError, MeshError, SoftdecaError, one_line
from ..base.files.surface_file import Scan, read_scan
from ..base.geometry.bvh import TriangleTree
from ..base.geometry.topology import find_openings
from ..base.mesh import Floats, Ints, Surface
from ..base.progress import OnProgress, silent
from ..fit import fit_registered, is_upright
from ..head import LayeredHead
from ..registration.landmarks import Pairs, landmark_ids, pair_landmarks
from ..registration.registration import find_face, register
from ..regressor.depths import DepthRegressor
from ..skin import check_skin
from ..template import Template
from .placing import Placement, find_placement, millimetres
from .repair import Repaired, repair_scan
from .seals import keep_seals, mark_rig, open_seals

ENOUGH = 5
"""So many of a mesh's own morph targets have to be ARKit's for them to count as its rig."""
OFF = 0.08
"""Landmarks in a file's own coordinates lie within this share of its extent off the mesh."""


@dataclass(frozen=True, eq=False)
class HeadScan:
    """A scan ready to be fitted: `skin` [mm], upright, +z the front; what was done on the way stands in `notes`.

    `own`: displacements [mm], shape (n, 3), of the morph targets that have ARKit names; `landmarks`: pairs of template
    vertices and points on the skin [mm], or None; `origin` (n,): the file's vertex that each of the skin's is.
    """

    skin: Surface
    own: Mapping[str, Floats] = field(repr=False)
    landmarks: Pairs | None = field(repr=False)
    origin: Ints = field(repr=False)
    placement: Placement = field(repr=False)
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Hints:
    """A scan's place as far as the user gives it, rather than found: `unit`, `up`, `front` as in `find_placement`.

    `landmarks`: points by the names of `landmark_ids`, in the file's coordinates, or in millimetres along its axes.
    """

    unit: str | None = None
    up: str | None = None
    front: str | None = None
    landmarks: Mapping[str, Any] | None = None


def read_head_scan(
    path: str | os.PathLike[str],
    template: Template,
    hints: Hints = Hints(),  # noqa: B008 (frozen)
    *,
    repair: bool = True,
    progress: OnProgress = silent,
) -> HeadScan:
    """Read a scan (OBJ, PLY, STL, glTF, NPZ) of a head in any unit and orientation.

    What the `hints` leave open is found; without `repair` the mesh is taken as it is. Raises InputError that names the
    file for what cannot be read, is no head, or needs a hint.
    """
    scan = read_scan(path)
    try:
        done = repair_scan(scan) if repair else Repaired.of(scan)
        return _upright(done, template, hints, progress)
    except SoftdecaError as error:
        raise InputError(str(error) if one_line(str(path)) in str(error) else f"{Path(path)}: {error}") from None


def read_same_topology(
    path: str | os.PathLike[str],
    template: Template,
    hints: Hints = Hints(),  # noqa: B008 (frozen)
) -> tuple[Surface, tuple[str, ...]] | None:
    """Read the skin [mm] of a file whose triangles are the template's, and notes; None if they are others.

    It is taken as it stands where it has a head's size and looks along +z, else put upright in millimetres. Raises
    InputError that names the file for a skin that is no head in any unit.
    """
    scan = read_scan(path)
    if not np.array_equal(scan.triangles, template.skin.triangles) or scan.morphs:
        return None
    try:
        skin, notes = scan.surface, tuple[str, ...]()
        if not np.ptp(skin.vertices, axis=0).max() > 0:
            raise MeshError("skin: all its vertices are in one place")
        if (hints.unit, hints.up, hints.front) != (None, None, None) or not is_upright(template.skin, skin):
            rest = template.skin.vertices
            where = find_placement(
                skin, (rest, rest), landmarks=(rest, skin.vertices), unit=hints.unit, up=hints.up, front=hints.front
            )
            skin, notes = Surface(where.motion(skin.vertices), skin.triangles), where.notes
        check_skin(skin)
    except SoftdecaError as error:
        raise InputError(f"{Path(path)}: {error}") from None
    return skin, notes


def fit_scan(
    path: str | os.PathLike[str],
    template: Template,
    hints: Hints = Hints(),  # noqa: B008 (frozen)
    *,
    repair: bool = True,
    unseal: bool = True,
    progress: OnProgress = silent,
) -> LayeredHead:
    """Fit the layered head of a scan with its own expressions: `read_head_scan`, then `fit_head_scan`."""
    scan = read_head_scan(path, template, hints, repair=repair, progress=progress)
    return fit_head_scan(scan, template, unseal=unseal, progress=progress)


def _upright(done: Repaired, template: Template, hints: Hints, progress: OnProgress) -> HeadScan:
    skin = done.scan.surface
    _, face = find_face(template.skin, template.parts)
    points, normals = template.skin.vertices[face], template.skin.vertex_normals[face]
    pairs = None
    if hints.landmarks is not None:
        pairs = _in_file(pair_landmarks(template.skin, template.parts, hints.landmarks), done.scan, hints.unit)
    known = None if pairs is None else (template.skin.vertices[pairs[0]], pairs[1])
    where = find_placement(
        skin, (points, normals), landmarks=known, unit=hints.unit, up=hints.up, front=hints.front, progress=progress
    )
    notes = [*done.notes, *where.notes, _told_openings(skin)]
    own = {}
    morphs = find_arkit_morphs(done.scan.morphs)
    if len(morphs) >= ENOUGH:
        turn = where.motion.scale * where.motion.rotation
        own = {name: delta @ turn.T for name, delta in morphs.items()}
        notes.append(f"expressions: {len(own)} of the file's {len(done.scan.morphs)} morph targets are ARKit's")
    if pairs is not None:
        pairs = pairs[0], where.motion(pairs[1])
    upright = Surface(where.motion(skin.vertices), skin.triangles)
    return HeadScan(upright, own, pairs, done.origin, where, tuple(notes))


def fit_head_scan(
    scan: HeadScan,
    template: Template,
    *,
    regressor: DepthRegressor | None = None,
    unseal: bool = True,
    progress: OnProgress = silent,
) -> LayeredHead:
    """Fit the head of a scan that was read, with its notes; `regressor` and what is raised as in `fit_head`.

    With `unseal` a mouth that is sealed is opened; closed and solid eyes, and a mouth that stays sealed, are named in
    the notes with the expressions that will not work, which the head's rig names too.
    """
    laid = register(template.skin, template.parts, scan.skin, landmarks=scan.landmarks, progress=progress)
    open_ = open_seals if unseal else keep_seals
    done = open_(template, laid, scan.skin, scan.own)
    head = fit_registered(template, done.skin, done.laid, regressor=regressor, own=done.own)
    if head.rig is not None:
        head = replace(head, rig=mark_rig(head.rig, done, head))
    return replace(head, notes=(*scan.notes, *done.notes))


def _in_file(pairs: Pairs, scan: Scan, unit: str | None) -> Pairs:
    """Landmarks in the file's own coordinates, where they may have been given in millimetres along its axes."""
    ids, points = pairs
    extent = float(np.ptp(scan.vertices[np.unique(scan.triangles)], axis=0).max())
    tree = TriangleTree(scan.vertices, scan.triangles)
    tried = {"the file's unit": 1.0}
    if unit is not None:
        tried["millimetres"] = 1.0 / millimetres(unit)
    else:
        tried |= {"millimetres": 0.1, "mm": 1e-3}
    off = {name: float(np.median(tree.closest(points * factor)[2])) for name, factor in tried.items()}
    name = min(off, key=lambda key: off[key])
    if off[name] > OFF * extent:
        raise InputError(
            f"landmarks: they lie {off[name]:.3g} off the mesh, which is {extent:.4g} large; expected in the file's "
            "own coordinates, or in millimetres along its axes"
        )
    return ids, points * tried[name]


def _told_openings(skin: Surface) -> str:
    try:
        loops = find_openings(skin.triangles)
    except MeshError:
        return "openings: not counted, the mesh is not a manifold"
    if not loops:
        return "openings: none, the surface is closed"
    sizes = [float(np.linalg.norm(np.ptp(skin.vertices[loop], axis=0))) for loop in loops]
    extent = float(np.ptp(skin.vertices, axis=0).max())
    large = sum(size > 0.05 * extent for size in sizes)
    return f"openings: {len(loops)} ({large} of them large); they stay open"


def suggest_landmarks(scan: HeadScan, template: Template, *, progress: OnProgress = silent) -> dict[str, Floats]:
    """Find the landmarks [mm] of an upright skin, by the names of `landmark_ids` (half a minute).

    They are where the registered template's are: on Lee Perry-Smith's scan .7 to 6 mm from those picked by hand. For a
    person to look at, correct and give back to `fit`; given back as they are they say nothing new.
    """
    laid = register(template.skin, template.parts, scan.skin, landmarks=scan.landmarks, progress=progress)
    ids = landmark_ids(template.skin, template.parts)
    return {name: laid.vertices[vertex] for name, vertex in ids.items()}
