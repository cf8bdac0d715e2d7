"""An identity space from a folder of meshes that share their topology: their mean and principal components."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ..base.checks import integers
from ..base.errors import InputError
from ..base.files.npz import read_npy
from ..base.files.surface_file import SUFFIXES, read_surface
from ..base.files.text import list_files, naming_file, read_json
from ..base.geometry.warp import rigid_motion
from ..base.mesh import Floats, Ints, Surface
from .arkit import ARKIT, arkit_name
from .space import CAP, OUTSIDE, LinearSpace, check_extent

CODE_SIZE = 50


def load(path: str | os.PathLike[str], *, unit: str = "mm") -> LinearSpace:
    """Load mean and principal components of the neutral skins in a folder: OBJ, PLY, STL or NPZ [`unit`: mm, cm or m].

    The skins are moved rigidly onto the first by name; codes are standard normal, none for a single skin. Optional:
    `expressions/NAME.obj` and so on with ARKit's names, each a shape of the same topology, beside the
    `expressions/neutral.obj` that they depart from and stand like; those that are not there are in `missing`;
    `parts.npy` or `parts.json`, a number 0 to 3 per vertex (OUTSIDE, MOUTH, EYES, CAP), all OUTSIDE without.
    Raises InputError that names the folder if it holds no mesh or its mean is no head in mm, and the file whose
    topology differs or that is bad.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder")
    files = _meshes(folder)
    if not files:
        raise InputError(f"{folder}: no mesh in it; expected {', '.join(SUFFIXES)}")
    first = read_surface(files[0], unit=unit)
    skins = [first.vertices]
    for file in files[1:]:
        skin = _alike(file, first, files[0], unit).vertices
        rotation, shift = rigid_motion(skin, first.vertices)
        skins.append(skin @ rotation.T + shift)
    mean, identity = _components(np.stack(skins))
    expressions, missing = _expressions(folder / "expressions", first, files[0], unit)
    mean_skin = first.with_vertices(mean)
    with naming_file(folder):
        check_extent(mean_skin)
    return LinearSpace(folder.name, mean_skin, identity, expressions, _parts(folder, len(mean)), missing)


def _meshes(folder: Path) -> list[Path]:
    return [file for file in list_files(folder) if file.suffix.lower() in SUFFIXES]


def _alike(file: Path, first: Surface, first_file: Path, unit: str) -> Surface:
    skin = read_surface(file, unit=unit)
    if len(skin.vertices) != len(first.vertices) or not np.array_equal(skin.triangles, first.triangles):
        raise InputError(
            f"{file}: another topology ({len(skin.vertices)} vertices, {len(skin.triangles)} triangles) than "
            f"{first_file.name} ({len(first.vertices)}, {len(first.triangles)})"
        )
    return skin


def _components(skins: Floats) -> tuple[Floats, Floats]:
    mean = skins.mean(axis=0)
    flat = (skins - mean).reshape(len(skins), -1) / np.sqrt(max(len(skins) - 1, 1))
    _, sizes, components = np.linalg.svd(flat, full_matrices=False)
    kept = np.flatnonzero(sizes > 1e-6 * max(sizes[0], 1.0))[: min(len(skins) - 1, CODE_SIZE)]
    return mean, (sizes[kept, None] * components[kept]).reshape(len(kept), *mean.shape)


def _expressions(folder: Path, first: Surface, first_file: Path, unit: str) -> tuple[Floats, tuple[str, ...]]:
    deltas = np.zeros((len(ARKIT), *first.vertices.shape))
    files = {file.stem: file for file in _meshes(folder)} if folder.is_dir() else {}
    if files and "neutral" not in files:
        raise InputError(f"{folder}: 'neutral' is missing, the face that the expressions depart from")
    named: dict[str, Path] = {}
    for stem, file in files.items():
        name = "neutral" if stem == "neutral" else arkit_name(stem)
        if name is None or name in named:
            words = "is none of ARKit's expressions, nor 'neutral'" if name is None else f"is {name} a second time"
            raise InputError(f"{file}: {stem!r} {words}")
        named[name] = file
    if named:
        neutral = _alike(named.pop("neutral"), first, first_file, unit).vertices
        rotation, _ = rigid_motion(neutral, first.vertices)
        for name, file in named.items():
            deltas[ARKIT.index(name)] = (_alike(file, first, first_file, unit).vertices - neutral) @ rotation.T
    return deltas, tuple(name for name in ARKIT if name not in named)


def _parts(folder: Path, n: int) -> Ints:
    for file in (folder / "parts.npy", folder / "parts.json"):
        if not file.is_file():
            continue
        content = read_npy(file) if file.suffix == ".npy" else read_json(file, "a list of parts")
        try:
            return integers("parts", content, OUTSIDE, CAP, (n,))
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
    return np.full(n, OUTSIDE)
