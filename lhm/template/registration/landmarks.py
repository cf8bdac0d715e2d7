"""Named places on a template's skin, and the points that a user gives for them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...base.checks import finite
from ...base.errors import InputError, MeshError, quote
from ...base.files.surface_file import FARTHEST
from ...base.files.text import read_json
from ...base.geometry.bvh import TriangleTree
from ...base.geometry.warp import fit_similarity
from ...base.mesh import Floats, Ints, Surface, as_points
from ...identities.space import MOUTH, OUTSIDE
from ..wraps.landmarks import find_landmarks

Pairs = tuple[Ints, Floats]
"""Vertices of the template, shape (k,), and the points [mm] on the skin that belong to them, shape (k, 3)."""

LEAST = 4
SCALES = (0.7, 1.5)
FAR = 20.0  # [mm] farther from the skin, or from where the others put it, a landmark is on something else


def landmark_ids(skin: Surface, parts: Ints) -> dict[str, int]:
    """Name vertices of a template's skin [mm]: corners of eyes and mouth, tip and root of the nose, chin, lips.

    "left" and "right" are the subject's, +x is the left. They follow from the rims of mouth and eyes in `parts` (n,)
    and from the profile at mid-face. Raises MeshError for a skin without a mouth or without eyes.
    """
    x = skin.vertices
    if not (parts == MOUTH).any():
        raise MeshError("landmarks: the template has no mouth among its parts")
    landmarks = find_landmarks(skin, parts)
    if not len(landmarks.lids):
        raise MeshError("landmarks: the template has no eyes among its parts")
    ids = {}
    for side, sign, centre in zip(("left", "right"), (1, -1), landmarks.eyes, strict=True):
        lids = landmarks.lids[np.abs(x[landmarks.lids, 0] - centre[0]) < 0.9 * landmarks.face_width]
        outwards = sign * x[lids, 0]
        ids[f"{side} eye outer"], ids[f"{side} eye inner"] = lids[outwards.argmax()], lids[outwards.argmin()]
        ids[f"{side} mouth corner"] = landmarks.rim[(sign * x[landmarks.rim, 0]).argmax()]
    middle = landmarks.eyes.mean(axis=0)
    drop = middle[1] - landmarks.mouth[1]
    profile = np.flatnonzero((parts == OUTSIDE) & (np.abs(x[:, 0] - middle[0]) < 0.15 * landmarks.face_width))
    profile = profile[x[profile, 2] > middle[2]]
    height = (x[profile, 1] - landmarks.mouth[1]) / drop

    def foremost(low: float, high: float) -> int:
        band = profile[(height > low) & (height < high)]
        if not len(band):
            raise MeshError("landmarks: the template's profile has no vertex where a landmark should be")
        return band[x[band, 2].argmax()]

    ids["nose tip"] = foremost(0.2, 0.9)
    root = profile[(height > 0.85) & (height < 1.25)]
    ids["nose root"] = root[(x[root, 2] + np.abs(x[root, 0] - middle[0])).argmin()] if len(root) else foremost(0.9, 1.2)
    ids["upper lip"], ids["lower lip"] = foremost(0.02, 0.2), foremost(-0.25, -0.02)
    ids["chin"] = foremost(-0.9, -0.4)
    return {name: int(vertex) for name, vertex in ids.items()}


def pair_landmarks(skin: Surface, parts: Ints, points: Mapping[str, Any]) -> Pairs:
    """Pair points [mm], given by the names of `landmark_ids`, with vertices; InputError names a bad one."""
    ids = landmark_ids(skin, parts)
    unknown = [name for name in points if name not in ids]
    if unknown:
        raise InputError(f"landmark {unknown[0]!r}: expected one of {', '.join(sorted(ids))}")
    for name, point in points.items():
        try:
            good = np.shape(point) == (3,) and bool(np.isfinite(np.asarray(point, dtype=np.float64)).all())
        except (TypeError, ValueError):
            good = False
        if not good:
            raise InputError(f"landmark {name!r}: expected three finite numbers [mm]")
    chosen = np.array([ids[name] for name in points], dtype=np.int64)
    return chosen, np.array(list(points.values()), dtype=np.float64).reshape(-1, 3)


def read_landmarks(path: str | os.PathLike[str]) -> dict[str, list[float]]:
    """Read points by name from a JSON file, {"nose tip": [x, y, z], ...}; InputError names a file that is not that."""
    read = read_json(path, "a JSON file of landmarks")
    if not isinstance(read, dict) or not read:
        raise InputError(f'{path}: expected landmarks by name, {{"nose tip": [x, y, z], ...}}')
    for name, point in read.items():
        try:
            finite(f"landmark {quote(name)!r}", point, (3,), most=FARTHEST)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    return read


def check_pairs(pairs: Pairs, n_vertices: int) -> Pairs:
    """Check pairs; InputError for fewer than four, vertices out of range or repeated, points not finite."""
    try:
        ids, points = np.asarray(pairs[0]), as_points("landmarks", pairs[1])
    except MeshError as error:
        raise InputError(str(error)) from None
    if ids.shape != (len(points),) or not np.issubdtype(ids.dtype, np.integer):
        raise InputError(f"landmarks: expected as many vertex numbers as points ({len(points)}), got {ids.shape}")
    if len(ids) < LEAST:
        raise InputError(f"landmarks: {len(ids)} given, at least {LEAST} are needed")
    bad = np.flatnonzero((ids < 0) | (ids >= n_vertices))
    if bad.size:
        raise InputError(f"landmarks: vertex {ids[bad[0]]} is outside the template's 0..{n_vertices - 1}")
    if len(np.unique(ids)) < len(ids):
        raise InputError("landmarks: a vertex of the template is given twice")
    return ids.astype(np.int64), points


def check_placed(template: Floats, pairs: Pairs, skin: Surface) -> None:
    """Raise InputError for landmarks that are mirrored, of another scale, off the skin, or that contradict each other.

    `template` (n, 3) [mm] are the template's vertices.
    """
    ids, points = pairs
    rest = template[ids]
    motion, mirrored = fit_similarity(rest, points), fit_similarity(rest * [-1.0, 1.0, 1.0], points)
    off = np.linalg.norm(motion(rest) - points, axis=1)
    as_mirrored = np.linalg.norm(mirrored(rest * [-1.0, 1.0, 1.0]) - points, axis=1)
    if as_mirrored.mean() < 0.5 * off.mean() and off.mean() > 2.0:
        raise InputError(
            f"landmarks: they fit a mirrored head ({as_mirrored.mean():.1f} mm) better than a head "
            f"({off.mean():.1f} mm): are left and right exchanged?"
        )
    if not SCALES[0] <= motion.scale <= SCALES[1]:
        raise InputError(
            f"landmarks: they are those of a head {motion.scale:.3g} times the template's size, "
            f"expected {SCALES[0]:g}..{SCALES[1]:g}: units off?"
        )
    away = TriangleTree(skin.vertices, skin.triangles).closest(points)[2]
    if away.max() > FAR:
        worst = away.argmax()
        raise InputError(
            f"landmarks: that of template vertex {ids[worst]} is {away[worst]:.0f} mm off the skin (at most {FAR:g})"
        )
    if off.max() > 2 * FAR:
        worst = off.argmax()
        raise InputError(
            f"landmarks: that of template vertex {ids[worst]} is {off[worst]:.0f} mm from where the others put it "
            f"(at most {2 * FAR:g})"
        )
