"""Where the face of a scan is: its size, which way it looks, and the motion that puts it upright in millimetres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from scipy.spatial import cKDTree

from ..base.errors import FitError, InputError
from ..base.geometry.warp import Similarity, fit_similarity
from ..base.mesh import Floats, Surface, unit
from ..base.progress import OnProgress, silent
from ..head.skin import FARTHEST_OFF
from ..template.registration.alignment import Target, icp, score_start

UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
"""Millimetres in a unit."""
AXES = ("x", "y", "z", "-x", "-y", "-z")


@dataclass(frozen=True)
class PlacingPolicy:
    """Constants of the search for a face in a scan; sizes are relative to the template's."""

    usual_sizes: tuple[float, float] = (0.75, 1.35)  # of a face, by which a known unit is taken
    named_sizes: tuple[float, float] = (0.55, 1.8)  # of a face in the unit that is said
    head: float = 250.0  # [mm] the template's largest extent
    busts: tuple[float, ...] = (1.0, 1.5, 2.2)  # extents of a scan that are tried: a bust is some twice a head
    worst_score: float = 3.2  # [mm of the template] up to which a face is found
    most_tilt: float = 20.0  # [degrees] up to which a head's own axes are kept
    sieves: tuple[tuple[int, int, int], ...] = (  # points of the face, how many starts are kept, and steps of each
        (50, 200, 3),
        (50, 60, 4),
        (120, 12, 6),
        (250, 4, 10),
    )
    last_points: int = 400  # of the face that the last starts lay upon the surface itself
    scan_points: int = 4000  # of the scan, in sieves
    turned: float = 25.0  # [mm] that a unit of difference between normals counts beside a distance
    farthest: float = 30.0  # [mm] that a point counts in a sieve
    least_scale: float = 0.4
    most_scale: float = 2.5


POLICY = PlacingPolicy()
"""The constants as they were measured."""


@dataclass(frozen=True, eq=False)
class Placement:
    """x -> `motion`(x) takes a file's points to a head's: mm, +z the front, +y up. `notes` say what was found."""

    motion: Similarity
    notes: tuple[str, ...]

    def inverse(self, points: Floats) -> Floats:
        """Take points (n, 3) of the head [mm] back to the file's own unit and axes."""
        return (points - self.motion.shift) @ self.motion.rotation / self.motion.scale


def find_placement(
    skin: Surface,
    face: tuple[Floats, Floats],
    *,
    landmarks: tuple[Floats, Floats] | None = None,
    unit: str | None = None,
    up: str | None = None,
    front: str | None = None,
    progress: OnProgress = silent,
) -> Placement:
    """Find the face of a skin that is given in any unit and orientation.

    `face`: points [mm] and normals (k, 3) of the template's face, which looks along +z with +y up. `landmarks`: points
    of the template [mm] and of the skin that belong together, in the skin's own coordinates; they decide alone. `unit`:
    mm, cm, m, in, or millimetres in the file's unit as a number; `up` and `front`: x, y, z, -x, -y or -z. What is not
    said is found by laying the face upon the skin from all sides. A head less than 20° off its axes is not tilted.
    Raises InputError for an unknown unit or axis, and FitError if no face is found.
    """
    given = None if unit is None else millimetres(unit)
    rotations = _rotations(up, front)
    used = skin.vertices[np.unique(skin.triangles)]
    if landmarks is not None:
        motion = fit_similarity(*landmarks)
        off = float(np.linalg.norm(motion(landmarks[0]) - landmarks[1], axis=1).mean() / motion.scale)
    else:
        motion, off = _search(skin, used, face, given, rotations, progress)
        if off > POLICY.worst_score:
            raise FitError(
                f"skin: no face found in it (the template's face fits it to {off:.1f} mm, at most "
                f"{POLICY.worst_score:g}); is it a head, with its face? --up, --front and --unit, or --landmarks, say "
                "where it is"
            )
    about_unit, scale = _unit(given, 1.0 / motion.scale, float(np.ptp(used, axis=0).max()))
    rotation, about_axes = _upright(motion.rotation.T, known=up is not None and front is not None)
    return place_near(Similarity(scale, rotation, np.zeros(3)), used, about_unit, about_axes)


def place_near(motion: Similarity, points: Floats, *notes: str) -> Placement:
    """Return a motion [mm] that brings points (n, 3) of a file to the origin, too, where they would lie far off."""
    middle = motion(points).mean(axis=0)
    off = float(np.abs(middle).max())
    if off <= FARTHEST_OFF:
        return Placement(motion, notes)
    moved = Similarity(motion.scale, motion.rotation, motion.shift - middle)
    return Placement(moved, (*notes, f"place: {off / 1000.0:.6g} m from the origin, where it was moved to"))


def millimetres(unit: str) -> float:
    """Read a unit, by its name or as a number, in millimetres; InputError for others."""
    if unit in UNITS:
        return UNITS[unit]
    try:
        value = float(unit)
    except ValueError:
        value = float("nan")
    if not (np.isfinite(value) and value > 0):
        raise InputError(f"unit {unit!r}: expected one of {', '.join(UNITS)}, or how many millimetres it has, as 49")
    return value


def _rotations(up: str | None, front: str | None) -> list[Floats]:
    """The rotations from the template's axes to the file's that are possible, by axes; up to 24."""
    for name, axis in (("up", up), ("front", front)):
        if axis is not None and axis not in AXES:
            raise InputError(f"{name} {axis!r}: expected one of {', '.join(AXES)}")
    directions = {axis: (-1 if axis.startswith("-") else 1) * np.eye(3)["xyz".index(axis[-1])] for axis in AXES}
    rotations = []
    for high, ahead in permutations(AXES, 2):
        if high[-1] != ahead[-1] and (up in (None, high)) and (front in (None, ahead)):
            y, z = directions[high], directions[ahead]
            rotations.append(np.stack([np.cross(y, z), y, z], axis=1))
    if not rotations:
        raise InputError(f"up {up!r} and front {front!r}: expected two different axes")
    # The usual ones first: of equals the first counts.
    usual = (("y", "z"), ("z", "-y"), ("y", "-z"), ("z", "y"), ("z", "x"))
    rank = {pair: k for k, pair in enumerate(usual)}
    keys = [(_axis(r[:, 1]), _axis(r[:, 2])) for r in rotations]
    return [rotations[k] for k in sorted(range(len(rotations)), key=lambda k: rank.get(keys[k], len(usual)))]


def _axis(direction: Floats) -> str:
    k = int(np.abs(direction).argmax())
    return ("-" if direction[k] < 0 else "") + "xyz"[k]


def _search(
    skin: Surface,
    used: Floats,
    face: tuple[Floats, Floats],
    given: float | None,
    rotations: Sequence[Floats],
    progress: OnProgress,
) -> tuple[Similarity, float]:
    """The similarity from the template's face to the skin in its file's unit, and its score [mm of the template]."""
    free = [size * POLICY.head / float(np.ptp(used, axis=0).max()) for size in POLICY.busts]

    def search(sizes: Sequence[float], turns: Sequence[Floats], done: float) -> tuple[float, Similarity]:
        best: tuple[float, Similarity] = (np.inf, Similarity(1.0, np.eye(3), np.zeros(3)))
        for number, size in enumerate(sizes):
            progress("finding the face", done + 0.5 * number / len(sizes))
            target = Target(Surface(skin.vertices * size, skin.triangles))
            motion, off = _best(target, used * size, face, turns)
            if off < best[0]:
                best = off, Similarity(motion.scale / size, motion.rotation, motion.shift / size)
        return best

    off, motion = search([given] if given else free, rotations, 0.0)
    if off > POLICY.worst_score:
        # A unit that is said and in which there is no face may be the wrong one: then the right one can be told.
        tilted, other = search(free, [turn @ tilt for turn in rotations for tilt in _tilts()], 0.5)
        off, motion = (tilted, other) if tilted < off else (off, motion)
    progress("finding the face", 1.0)
    return motion, off


def _tilts() -> list[Floats]:
    """Half-way turns between the axes: 45° about each, and about pairs of them."""
    angles = [(a, b, c) for a, b, c in product((-1, 0, 1), repeat=3) if (a, b, c) != (0, 0, 0) and 0 in (a, b, c)]
    return [_turn(np.radians(36.0) * np.array(angle)) for angle in angles]


def _turn(vector: Floats) -> Floats:
    angle = float(np.linalg.norm(vector))
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _best(
    target: Target, used: Floats, face: tuple[Floats, Floats], turns: Sequence[Floats]
) -> tuple[Similarity, float]:
    """The best of many starts: sieved by points and normals alone, the last few laid upon the surface itself."""
    points, normals = face
    starts = [start for turn in turns for start in _starts(used, points, turn)]
    sieve = Sieve.from_surface(target.skin)
    for count, kept, steps in POLICY.sieves:
        some = np.unique(np.linspace(0, len(points) - 1, count).astype(int))
        starts = sieve.best(starts, points[some], normals[some], kept, steps)
    more = np.unique(np.linspace(0, len(points) - 1, POLICY.last_points).astype(int))
    fine = []
    for number, start in enumerate(starts):
        motion = icp(start, points[more], normals[more], target, 20)
        if 0.3 < motion.scale < 3.0:
            fine.append((score_start(motion, points[more], normals[more], target), number, motion))
    if not fine:
        return Similarity(1.0, np.eye(3), np.zeros(3)), np.inf
    motion = icp(min(fine, key=lambda item: item[:2])[2], points, normals, target, 10)
    return motion, score_start(motion, points, normals, target)


def _starts(used: Floats, points: Floats, turn: Floats) -> list[Similarity]:
    """The template's foremost point on the skin's foremost in the upper part of it, at some heights."""
    upright = used @ turn  # in the template's axes
    top, low = upright[:, 1].max(), upright[:, 1].min()
    tip = points[points[:, 2].argmax()]
    starts = []
    for reach in (0.45, 0.7, 1.0):
        part = upright[upright[:, 1] >= top - reach * (top - low)]
        goal = part[part[:, 2].argmax()]
        for height in (-18.0, 12.0):
            starts.append(Similarity(1.0, turn, (goal + [0.0, height, 0.0]) @ turn.T - turn @ tip))
    return starts


def _unit(given: float | None, guess: float, extent: float) -> tuple[str, float]:
    """Return a sentence about the unit, and the millimetres in it."""
    if given is not None:
        size = given / guess
        if not POLICY.named_sizes[0] <= size <= POLICY.named_sizes[1]:
            raise FitError(f"skin: in that unit its face is {size:.3g} times the template's size: another --unit?")
        return f"unit: {given:g} mm, as said (its face is {size:.2f} times the template's)", given
    for name, known in UNITS.items():
        size = known / guess
        if POLICY.usual_sizes[0] <= size <= POLICY.usual_sizes[1]:
            return f"unit: taken for {name}, in which its face is {size:.2f} times the template's", known
    return (
        f"unit: none known; taken for {guess:.4g} mm, by which its face has the template's size (--unit says else)",
        guess,
    )


def _upright(rotation: Floats, *, known: bool) -> tuple[Floats, str]:
    """A rotation from the file's axes to the head's: the nearest by axes where that is near, and what is said of it."""
    nearest = max(_rotations(None, None), key=lambda turn: float(np.trace(turn @ rotation))).T
    angle = np.degrees(np.arccos(np.clip((np.trace(nearest.T @ rotation) - 1) / 2, -1, 1)))
    up, front = _axis(nearest[1]), _axis(nearest[2])
    if angle <= POLICY.most_tilt or known:
        return nearest, f"axes: {up} is up, {front} the front"
    return rotation, f"axes: turned upright ({angle:.0f}° from {up} up and {front} the front)"


@dataclass(frozen=True, eq=False)
class Sieve:
    """Points (n, 3) [mm] of a surface and normals, evenly chosen by area, in a tree over both."""

    points: Floats
    tree: cKDTree

    @classmethod
    def from_surface(cls, skin: Surface) -> Sieve:
        """Choose up to `scan_points` of the surface's triangles, by their centres."""
        along = np.cumsum(skin.areas)
        count = POLICY.scan_points
        chosen = np.unique(np.searchsorted(along, (np.arange(count) + 0.5) / count * along[-1]))
        chosen = np.minimum(chosen, len(along) - 1)
        normals = unit(skin.face_normals[chosen])
        points = skin.vertices[skin.triangles[chosen]].mean(axis=1)
        return cls(points, cKDTree(np.hstack([points, POLICY.turned * normals])))

    def best(
        self, starts: Sequence[Similarity], points: Floats, normals: Floats, kept: int, steps: int
    ) -> list[Similarity]:
        """Keep the `kept` best of `starts` after so many steps each; `points` (k, 3) [mm] and `normals` are laid."""
        scale = np.array([start.scale for start in starts])
        turn = np.array([start.rotation for start in starts])
        shift = np.array([start.shift for start in starts])
        for step in range(steps + 1):
            places = scale[:, None, None] * np.einsum("sij,kj->ski", turn, points) + shift[:, None]
            turned = np.einsum("sij,kj->ski", turn, normals)
            query = np.concatenate([places, POLICY.turned * turned], axis=2).reshape(-1, 6)
            distance, nearest = self.tree.query(query)
            distance = distance.reshape(len(starts), -1)
            if step == steps:
                break
            weight = 1.0 / (1.0 + (distance / 10.0) ** 2)
            scale, turn, shift = _fits(points, self.points[nearest].reshape(places.shape), weight, scale)
        off = np.minimum(distance, POLICY.farthest).mean(axis=1) / scale
        off[(scale <= POLICY.least_scale * 1.001) | (scale >= POLICY.most_scale * 0.999)] = np.inf
        order = np.argsort(off, kind="stable")[:kept]
        return [Similarity(float(scale[k]), turn[k], shift[k]) for k in order]


def _fits(points: Floats, goals: Floats, weight: Floats, before: Floats) -> tuple[Floats, Floats, Floats]:
    """Weighted similarities from points (k, 3) to goals (s, k, 3), as `fit_similarity`, for all s at once."""
    share = weight / weight.sum(axis=1, keepdims=True)
    a = points[None] - (share @ points)[:, None]
    middle = np.einsum("sk,skd->sd", share, goals)
    b = goals - middle[:, None]
    u, _, v = np.linalg.svd(np.einsum("sk,ski,skj->sij", share, b, a))
    flip = np.ones((len(goals), 3))
    flip[:, 2] = np.sign(np.linalg.det(u @ v))
    turn = (u * flip[:, None]) @ v
    size = np.einsum("sk,ski,sij,skj->s", share, b, turn, a) / np.einsum("sk,skd->s", share, a**2)
    scale = np.clip(size, np.maximum(POLICY.least_scale, 0.8 * before), np.minimum(POLICY.most_scale, 1.25 * before))
    return scale, turn, middle - scale[:, None] * np.einsum("sij,sj->si", turn, share @ points)
