"""Scans: read from a file, repaired, put upright in millimetres, and fitted; notes say what was done."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..base.errors import FitError, InputError, MeshError
from ..base.files.surface_file import Scan, read_scan
from ..base.files.text import naming_file
from ..base.files.texture import Texture, read_texture
from ..base.geometry.bvh import TriangleTree
from ..base.geometry.warp import Similarity
from ..base.mesh import Floats, Surface
from ..base.progress import OnProgress, silent
from ..head.detail import Detail, count_fine_vertices
from ..head.head import LayeredHead
from ..head.skin import check_skin
from ..identities.arkit import arkit_name, find_arkit_morphs
from ..template.depths.depths import DepthRegressor
from ..template.fit import fit_head, has_triangles_of, is_upright
from ..template.registration.landmarks import Pairs, landmark_ids, pair_landmarks
from ..template.registration.registration import find_face, register
from ..template.template import Template
from .detail import find_colours, lay_detail
from .placing import Placement, find_placement, millimetres, place_near
from .repair import Repaired, repair_pieces

ENOUGH = 5
"""So many of a mesh's own morph targets have to be ARKit's for them to count as its rig."""
OFF = 0.08
"""Landmarks in a file's own coordinates lie within this share of its extent off the mesh."""


@dataclass(frozen=True)
class Hints:
    """A scan's place as far as the user gives it, rather than found: `unit`, `up`, `front` as in `find_placement`.

    `landmarks`: points by the names of `landmark_ids`, in the file's coordinates, or in millimetres along its axes.
    """

    unit: str | None = None
    up: str | None = None
    front: str | None = None
    landmarks: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class PlacedScan:
    """A scan ready to be fitted: `skin` [mm], upright, +z the front; what was done on the way stands in `notes`.

    `own`: displacements [mm], shape (n, 3), of the morph targets that have ARKit names; `landmarks`: pairs of template
    vertices and points on the skin [mm], or None; `texture`: its file's, in the head's place [mm], where there is one.
    """

    skin: Surface
    own: Mapping[str, Floats] = field(repr=False)
    landmarks: Pairs | None = field(repr=False)
    placement: Placement = field(repr=False)
    notes: tuple[str, ...]
    texture: Texture | None = field(default=None, repr=False)


def fit_scan(
    template: Template,
    scan: str | os.PathLike[str] | Surface,
    hints: Hints = Hints(),  # noqa: B008 (frozen)
    *,
    repair: bool = True,
    regressor: DepthRegressor | None = None,
    progress: OnProgress = silent,
) -> LayeredHead:
    """Fit the layered head of a scan, in the template's triangles, with the scan's own expressions where it has some.

    scan: a file (OBJ, PLY, STL, glTF, NPZ) or a surface of a head, of any topology, unit and orientation; `hints` and
    `repair` as in `place_scan`, `regressor` as in `fit_head`. The template's skin is laid onto the scan; a scan in the
    template's triangles and order is taken vertex by vertex. What the scan has beyond the template's triangles is kept
    as the head's `detail`, for drawing, with its texture's colours. The head's notes say what was found and changed.

    Raises InputError that names the file for what cannot be read, is no head, or needs a hint, and FitError as in
    `fit_head`.
    """
    placed = place_scan(template, scan, hints, repair=repair, progress=progress)
    head = fit_head(
        template, placed.skin, regressor=regressor, landmarks=placed.landmarks, own=placed.own, progress=progress
    )
    progress("detail", 0.0)
    detail = None
    if not has_triangles_of(template, placed.skin):
        detail = lay_detail(template, head.skin, placed.skin)
    if detail is None and (placed.texture is not None or placed.placement.motion.shift.any()):
        detail = Detail(np.zeros(count_fine_vertices(head.skin), np.float32))
    if detail is not None and placed.texture is not None:
        detail = replace(detail, colours=find_colours(head.skin, detail, placed.texture))
    if detail is not None:
        motion = placed.placement.motion
        detail = replace(detail, place=np.column_stack([motion.scale * motion.rotation, motion.shift]))
    progress("detail", 1.0)
    return replace(head, detail=detail, notes=(*placed.notes, *head.notes))


def place_scan(
    template: Template,
    scan: str | os.PathLike[str] | Surface,
    hints: Hints = Hints(),  # noqa: B008 (frozen)
    *,
    repair: bool = True,
    progress: OnProgress = silent,
) -> PlacedScan:
    """Read and repair a scan, and put it upright in millimetres; what the `hints` leave open is found.

    Without `repair` the mesh is taken as it is. A scan in the template's triangles is not repaired; it stays where it
    stands if it has a head's size and looks along +z. Raises InputError that names the file.
    """
    if isinstance(scan, Surface):
        return _place(template, Scan(scan.vertices, scan.triangles), hints, repair, progress)
    read, notes = read_at_rest(scan)
    with naming_file(scan):
        placed = _place(template, read, hints, repair, progress)
    return _paint(replace(placed, notes=(*notes, *placed.notes)), scan, read.vertices)


def read_at_rest(path: str | os.PathLike[str]) -> tuple[Scan, tuple[str, ...]]:
    """Read a scan without the ARKit expressions that its file shows, and notes on it; InputError as `read_scan`."""
    scan = read_scan(path)
    expressed = [name for name in scan.shown if arkit_name(name) is not None]
    if not expressed:
        return scan, scan.notes
    rest = scan.vertices - sum(scan.shown[name] for name in expressed)
    note = f"expressions that the file shows were taken out: {', '.join(expressed)}"
    return replace(scan, vertices=rest), (*scan.notes, note)


def _paint(placed: PlacedScan, path: str | os.PathLike[str], vertices: Floats) -> PlacedScan:
    """Add a scan's texture; one that cannot be read is no reason to refuse a scan, and is told in the notes."""
    try:
        texture = read_texture(path, placed.placement.motion(vertices))
    except (InputError, ValueError) as error:
        return replace(placed, notes=(*placed.notes, f"texture: left out; {error}"))
    if texture is None:
        return placed
    width, height = texture.picture.size
    note = f"texture: a picture of {width} x {height}"
    if texture.others:
        note += f"; {texture.others} more, of fewer triangles, are left out"
    return replace(placed, texture=texture, notes=(*placed.notes, note))


def suggest_landmarks(template: Template, scan: PlacedScan, *, progress: OnProgress = silent) -> dict[str, Floats]:
    """Find the landmarks [mm] of an upright skin, by the names of `landmark_ids` (half a minute).

    They are where the registered template's are: on Lee Perry-Smith's scan .7 to 6 mm from those picked by hand. For a
    person to look at, correct and give back to `fit_scan`; given back as they are they say nothing new.
    """
    laid = register(
        template.skin, template.parts, scan.skin, landmarks=scan.landmarks, stiff_lids=True, progress=progress
    )
    ids = landmark_ids(template.skin, template.parts)
    return {name: laid.vertices[vertex] for name, vertex in ids.items()}


def _place(template: Template, scan: Scan, hints: Hints, repair: bool, progress: OnProgress) -> PlacedScan:
    notes: list[str] = []
    pairs = None
    if same := has_triangles_of(template, scan):
        where = _place_same(template, scan, hints)
        if hints.landmarks is not None:
            notes.append("landmarks: not read, since the scan has the template's own triangles")
    else:
        refused: list[InputError | FitError] = []
        for done in repair_pieces(scan) if repair else [Repaired(scan)]:
            try:
                where, pairs = _find(template, done.scan, hints, progress)
            except (InputError, FitError) as error:
                refused.append(error)
            else:
                scan, notes = done.scan, [*done.notes]
                break
        else:
            more = f" ({len(refused)} of its separate pieces were tried)" if len(refused) > 1 else ""
            raise FitError(f"{refused[0]}{more}")
    notes += where.notes
    skin = Surface(where.motion(scan.vertices), scan.triangles)
    if same:
        check_skin(skin)
    own = {}
    morphs = find_arkit_morphs(scan.morphs)
    if len(morphs) >= ENOUGH:
        turn = where.motion.scale * where.motion.rotation
        own = {name: delta @ turn.T for name, delta in morphs.items()}
        notes.append(f"expressions: {len(own)} of the file's {len(scan.morphs)} morph targets are ARKit's")
    elif scan.morphs:
        notes.append(
            f"expressions: the template's; {len(morphs) or 'none'} of the file's {len(scan.morphs)} morph targets is "
            f"ARKit's by name, {ENOUGH} are needed"
        )
    if pairs is not None:
        pairs = pairs[0], where.motion(pairs[1])
    return PlacedScan(skin, own, pairs, where, tuple(notes))


def _find(template: Template, scan: Scan, hints: Hints, progress: OnProgress) -> tuple[Placement, Pairs | None]:
    """Find where a piece of a scan has its face, and the pairs of landmarks on it."""
    pairs = None
    if hints.landmarks is not None:
        pairs = _in_file(pair_landmarks(template.skin, template.parts, hints.landmarks), scan, hints.unit)
    _, face = find_face(template.skin, template.parts)
    where = find_placement(
        scan.surface,
        (template.skin.vertices[face], template.skin.vertex_normals[face]),
        landmarks=None if pairs is None else (template.skin.vertices[pairs[0]], pairs[1]),
        unit=hints.unit,
        up=hints.up,
        front=hints.front,
        progress=progress,
    )
    return where, pairs


def _place_same(template: Template, scan: Scan, hints: Hints) -> Placement:
    """Where a scan of the template's triangles stands: as it is, or by all its vertices."""
    rest = template.skin.vertices
    if not np.ptp(scan.vertices, axis=0).max() > 0:
        raise MeshError("skin: all its vertices are in one place")
    if (hints.unit, hints.up, hints.front) == (None, None, None) and is_upright(template.skin, scan.surface):
        return place_near(Similarity(1.0, np.eye(3), np.zeros(3)), scan.vertices)
    return find_placement(
        scan.surface, (rest, rest), landmarks=(rest, scan.vertices), unit=hints.unit, up=hints.up, front=hints.front
    )


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
