"""ICT-FaceKit as its project publishes it, a folder of OBJ files, made the arrays that `ict` reads."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..base.errors import InputError
from ..base.files.surface_file import read_obj
from ..base.mesh import Floats, Ints
from ..base.progress import OnProgress, silent
from ..expressions.naming import arkit_name
from . import ict

NEUTRAL = "generic_neutral_mesh.obj"
DIGITS = 6
"""Decimals [cm] of the files: differences have no more, but for rounding."""
VERTICES = 26719
PARTS = (
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


def read_folder(path: str | os.PathLike[str], *, progress: OnProgress = silent) -> dict[str, np.ndarray]:
    """The arrays that `ict.load` reads [cm], from the folder FaceXModel or the one that holds it (some 20 seconds).

    Files of ARKit's names are the expressions and `identityNNN.obj` the identities, as many as `ict` uses, each less
    the neutral mesh; others are left out. `license` is the comment at the top of that mesh.
    Raises InputError that names the folder or the file that is missing, damaged or of another topology.
    """
    folder = _with_neutral(Path(path))
    neutral, triangles = _read(folder / NEUTRAL)
    expected = VERTICES, sum(count for _, count in PARTS)
    if (len(neutral), len(triangles)) != expected:
        raise InputError(
            f"{folder / NEUTRAL}: not ICT-FaceKit's light model: expected {expected[0]} vertices and {expected[1]} "
            f"triangles, found {len(neutral)} and {len(triangles)}"
        )
    shapes = {file.stem: name for file in sorted(folder.glob("*.obj")) if (name := arkit_name(file.stem)) is not None}
    identities = [f"identity{number:03d}" for number in range(ict.CODE_SIZE)]
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
        "triangle_part": np.repeat(np.arange(len(PARTS)), [count for _, count in PARTS]).astype(np.uint8),
        "part_names": np.array([name for name, _ in PARTS]),
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
    if not file.is_file():
        raise InputError(f"{file}: no such file")
    try:
        vertices, triangles = read_obj(file)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    return vertices, triangles


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
