"""ICT-FaceKit's identity space (MIT; Li et al., CVPR 2020), from one .npz file.

Arrays read: `vertices` (n, 3) [cm], `triangles`, `triangle_part` into `part_names`, `identity_deltas` (k, n, 3),
scaled so that codes are standard normal, `expression_deltas`, and their ARKit names in `expression_arkit`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..base.checks import indices_below
from ..base.errors import InputError
from ..base.files.npz import read_arrays
from ..base.files.surface_file import read_scan
from ..base.files.text import list_files
from ..base.mesh import Floats, Ints, Surface
from ..base.progress import OnProgress, silent
from .arkit import ARKIT, arkit_name
from .cut import cut_and_close, keep_lips_together, largest_piece
from .space import CAP, EYES, MOUTH, OUTSIDE, LinearSpace, check_extent

MM = 10.0
CODE_SIZE = 50
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
NEUTRAL = "generic_neutral_mesh.obj"
DIGITS = 6
"""Decimals [cm] of the files: differences have no more, but for rounding."""
KIT_VERTICES = 26719
KIT_PARTS = (
    ("face", 18460),
    ("head_neck", 3828),
    ("mouth_socket", 4164),
    ("eye_socket_l", 808),
    ("eye_socket_r", 808),
    ("gums_tongue", 5808),
    ("teeth", 8696),
    ("eyeball_l", 3132),
    ("eyeball_r", 3132),
    ("lacrimal_l", 326),
    ("lacrimal_r", 326),
    ("eyeblend_l", 30),
    ("eyeblend_r", 30),
    ("eyeocc_l", 256),
    ("eyeocc_r", 256),
    ("eyelash_l", 1080),
    ("eyelash_r", 1080),
)
"""Parts of the mesh and their triangles (its polygons as fans), one after another: the README's table of topology."""


def load(path: str | os.PathLike[str]) -> LinearSpace:
    """Load face, head, neck, mouth lining and eye sockets, closed at the neck; teeth, gums, tongue and eyes left out.

    Raises InputError naming the file if it is missing, damaged or lacks an array.
    """
    return space_from_arrays(read_arrays(path, *_NEEDED, kind="ICT-FaceKit's data"), path)


def space_from_arrays(data: Mapping[str, np.ndarray], path: str | os.PathLike[str]) -> LinearSpace:
    """Make the space of the arrays of a file or folder; InputError naming it if they do not fit together."""
    try:
        return _space(data)
    except (ValueError, IndexError, TypeError, KeyError) as error:
        raise InputError(f"{path}: not ICT-FaceKit's data ({error})") from None


def _space(data: Mapping[str, np.ndarray]) -> LinearSpace:
    names = data["part_names"].tolist()
    part_of = np.array([_SKIN.get(name, -1) for name in names])[data["triangle_part"]]
    if not (part_of >= 0).any():
        raise InputError(f"no triangle is of {', '.join(_SKIN)}")
    triangles = indices_below("triangles", data["triangles"], len(data["vertices"]), (None, 3))
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
    identity = keep_lips_together(mean.vertices, closed, parts, shapes)
    return LinearSpace("ict", mean, identity, expressions, parts, missing)


def _inside(triangles: Ints, part_of: Ints, part: int) -> Ints:
    """Vertices that only triangles of `part` have."""
    return np.setdiff1d(triangles[part_of == part], triangles[(part_of != part) & (part_of >= 0)])


def read_folder(path: str | os.PathLike[str], *, progress: OnProgress = silent) -> dict[str, np.ndarray]:
    """Read the arrays that `ict.load` reads [cm], from the folder FaceXModel or the one that holds it (20 seconds).

    Files of ARKit's names are the expressions and `identityNNN.obj` the identities, as many as `ict` uses, each less
    the neutral mesh; others are left out. `license` is the comment at the top of that mesh.
    Raises InputError that names the folder or the file that is missing, damaged or of another topology.
    """
    folder = _with_neutral(Path(path))
    neutral, triangles = _read(folder / NEUTRAL)
    expected = KIT_VERTICES, sum(count for _, count in KIT_PARTS)
    if (len(neutral), len(triangles)) != expected:
        raise InputError(
            f"{folder / NEUTRAL}: not ICT-FaceKit's light model: expected {expected[0]} vertices and {expected[1]} "
            f"triangles, found {len(neutral)} and {len(triangles)}"
        )
    shapes = {file.stem: name for file in list_files(folder, "*.obj") if (name := arkit_name(file.stem)) is not None}
    identities = [f"identity{number:03d}" for number in range(CODE_SIZE)]
    if not shapes:
        raise InputError(f"{folder}: no expression in it, such as jawOpen.obj")
    stems = [*shapes, *identities]
    deltas = np.zeros((len(stems), *neutral.shape), np.float32)
    for number, stem in enumerate(stems):
        progress("ICT-FaceKit's shapes", number / len(stems))
        deltas[number] = _delta(folder / f"{stem}.obj", neutral, triangles)
    progress("ICT-FaceKit's shapes", 1.0)
    return {
        "vertices": neutral.astype(np.float32),
        "triangles": triangles.astype(np.int32),
        "triangle_part": np.repeat(np.arange(len(KIT_PARTS)), [count for _, count in KIT_PARTS]).astype(np.uint8),
        "part_names": np.array([name for name, _ in KIT_PARTS]),
        "expression_names": np.array(list(shapes)),
        "expression_arkit": np.array(list(shapes.values())),
        "expression_deltas": deltas[: len(shapes)],
        "identity_deltas": deltas[len(shapes) :],
        "license": np.array(_comment(folder / NEUTRAL)),
    }


def _with_neutral(path: Path) -> Path:
    if not path.is_dir():
        raise InputError(f"{path}: no such folder")
    for folder in (path, path / "FaceXModel"):
        if (folder / NEUTRAL).is_file():
            return folder
    raise InputError(f"{path}: no {NEUTRAL} in it or in its FaceXModel; expected ICT-FaceKit's folder")


def _read(file: Path) -> tuple[Floats, Ints]:
    scan = read_scan(file)
    return scan.vertices, scan.triangles


def _delta(file: Path, neutral: Floats, triangles: Ints) -> Floats:
    vertices, own = _read(file)
    if vertices.shape != neutral.shape or not np.array_equal(own, triangles):
        raise InputError(f"{file}: another topology than {NEUTRAL}")
    return np.round(vertices - neutral, DIGITS)


def _comment(file: Path) -> str:
    """The lines before the first that is no comment, without their frame of hashes."""
    lines = []
    with file.open(encoding="utf-8", errors="replace") as text:
        for line in text:
            if not line.startswith("#"):
                break
            lines.append(line.strip("# \n"))
    return "\n".join(lines).strip()
