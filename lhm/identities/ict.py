"""ICT-FaceKit's identity space (MIT; Li et al., CVPR 2020), from one .npz file.

Arrays read: `vertices` (n, 3) [cm], `triangles`, `triangle_part` into `part_names`, `identity_deltas` (k, n, 3),
scaled so that codes are standard normal, `expression_deltas`, and their ARKit names in `expression_arkit`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np

from ..arkit import ARKIT
from ..base.checks import array_of_kind, finite, indices_below, real, shape
from ..base.errors import InputError, quote
from ..base.files.npz import read_arrays
from ..base.limits import PARTS, SPACE_VALUES, VERTICES
from ..base.mesh import Ints, Surface
from .cut import cut_and_close, largest_piece
from .lips import lips_together
from .space import CAP, EYES, MOUTH, OUTSIDE, LinearSpace, check_extent

MM = 10.0
CODE_SIZE = 50
LARGEST = 1e6
"""[cm] of a coordinate."""
NECK_CUT = 280.0  # [mm] below the top: above the shoulders, as the default head
_SKIN = {"face": OUTSIDE, "head_neck": OUTSIDE, "mouth_socket": MOUTH, "eye_socket_l": EYES, "eye_socket_r": EYES}
_NEEDED = (
    "vertices",
    "triangles",
    "triangle_part",
    "part_names",
    "identity_deltas",
    "expression_deltas",
    "expression_arkit",
)


def load(path: str | os.PathLike[str]) -> LinearSpace:
    """Face, head, neck, mouth lining and eye sockets, closed at the neck; teeth, gums, tongue and eyes left out.

    Raises InputError naming the file if it is missing, damaged or lacks an array.
    """
    return space_of(read_arrays(path, *_NEEDED, of="ICT-FaceKit's data"), path)


def space_of(data: Mapping[str, np.ndarray], path: str | os.PathLike[str]) -> LinearSpace:
    """The space of the arrays of a file or folder; InputError naming it if they do not fit together."""
    try:
        return _space(data)
    except (ValueError, IndexError, TypeError, KeyError) as error:
        raise InputError(f"{path}: not ICT-FaceKit's data ({error})") from None


def _checked(data: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays, each of its shape and range; InputError names one that is not."""
    vertices = finite("vertices", data["vertices"], (None, 3), most=LARGEST)
    n = VERTICES.check("it has", len(vertices))
    names = array_of_kind("part_names", data["part_names"], "U", "texts").ravel()
    PARTS.check("it has", len(names))
    triangles = indices_below("triangles", data["triangles"], n, (None, 3))
    SPACE_VALUES.check("it has", data["identity_deltas"].size + data["expression_deltas"].size)
    most = float(np.ptp(vertices, axis=0).max(initial=0.0))  # a shape moves no vertex farther than the head is large
    expressions = real("expression_deltas", data["expression_deltas"], (None, n, 3), most=most)
    arkit = array_of_kind("expression_arkit", data["expression_arkit"], "U", "texts")
    shape("expression_arkit", arkit, (len(expressions),))
    for name in arkit.tolist():
        if name not in ARKIT:
            raise InputError(f"expression_arkit: {quote(name)!r} is none of ARKit's expressions")
    return {
        "vertices": vertices,
        "triangles": triangles,
        "triangle_part": indices_below("triangle_part", data["triangle_part"], len(names), (len(triangles),)),
        "part_names": names,
        "identity_deltas": real("identity_deltas", data["identity_deltas"], (None, n, 3), most=most),
        "expression_deltas": expressions,
        "expression_arkit": arkit,
    }


def _space(given: Mapping[str, np.ndarray]) -> LinearSpace:
    data = _checked(given)
    names = data["part_names"].tolist()
    part_of = np.array([_SKIN.get(name, -1) for name in names])[data["triangle_part"]]
    if not (part_of >= 0).any():
        raise InputError(f"no triangle is of {', '.join(_SKIN)}")
    triangles = data["triangles"]
    height = data["vertices"][:, 1] * MM
    above = (height[triangles] > height[triangles[part_of >= 0]].max() - NECK_CUT).all(axis=1)
    cut, closed, kept = cut_and_close(largest_piece(triangles[(part_of >= 0) & above]), len(data["vertices"]))
    mean = Surface(cut @ data["vertices"] * MM, closed)
    check_extent(mean)
    expressions = np.zeros((len(ARKIT), *mean.vertices.shape))
    for name, delta in zip(data["expression_arkit"].tolist(), data["expression_deltas"], strict=True):
        expressions[ARKIT.index(name)] += cut @ delta.astype(np.float64) * MM
    missing = tuple(sorted(set(ARKIT) - set(data["expression_arkit"].tolist())))
    parts = np.full(len(data["vertices"]), OUTSIDE)
    for part in (MOUTH, EYES):
        parts[_inside(triangles, part_of, part)] = part
    parts = np.append(parts[kept], np.full(cut.shape[0] - len(kept), CAP))
    if not len(data["identity_deltas"]):
        raise InputError("identity_deltas: there are none")
    shapes = np.stack([cut @ delta.astype(np.float64) for delta in data["identity_deltas"][:CODE_SIZE]]) * MM
    identity = lips_together(mean.vertices, closed, parts, shapes)
    return LinearSpace("ict", mean, identity, expressions, parts, missing)


def _inside(triangles: Ints, part_of: Ints, part: int) -> Ints:
    """Vertices that only triangles of `part` have."""
    return np.setdiff1d(triangles[part_of == part], triangles[(part_of != part) & (part_of >= 0)])
