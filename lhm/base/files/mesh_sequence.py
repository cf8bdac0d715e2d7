"""Sequences of meshes of one triangulation: a folder of mesh files, or vertices over time in an .npz file."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..checks import finite, indices_below, one_of
from ..errors import InputError
from ..limits import TAKE_FRAMES
from ..mesh import Floats, Ints
from .npz import read_arrays
from .surface_file import MILLIMETRES, SUFFIXES, read_scan
from .text import list_files

IN_FOLDERS = tuple(suffix for suffix in SUFFIXES if suffix != ".npz")


@dataclass(frozen=True, eq=False)
class MeshSequence:
    """Meshes of one triangulation over time. Iterating reads each frame's vertices (n, 3) [mm] in turn.

    `names` of the frames, for messages; `triangles` (m, 3), None where the file has none; `notes` of the first file.
    """

    names: tuple[str, ...]
    triangles: Ints | None
    read: Callable[[int], Floats]
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Floats]:
        return map(self.read, range(len(self.names)))


def read_mesh_sequence(path: str | os.PathLike[str], *, unit: str = "mm") -> MeshSequence:
    """Read a folder of meshes, in the order of their names, or an .npz with `vertices` (frames, n, 3).

    Numbers in names count by value, so frame_10 comes after frame_9. The .npz may have `triangles` (m, 3). `unit` is
    the files': mm, cm or m. Raises InputError, one line that names the file, for a folder without meshes and for files
    that are missing or damaged; iterating raises it for a frame of other triangles or another count of vertices.
    """
    factor, path = MILLIMETRES[one_of("unit", unit, MILLIMETRES)], Path(path)
    return _from_folder(path, factor) if path.is_dir() else _from_npz(path, factor)


def _from_folder(folder: Path, factor: float) -> MeshSequence:
    files = [file for file in list_files(folder) if file.suffix.lower() in IN_FOLDERS]
    if not files:
        raise InputError(f"{folder}: no meshes in this folder; expected {', '.join(IN_FOLDERS)}")
    TAKE_FRAMES.check(f"{folder}: it has", len(files))
    files.sort(key=lambda file: _order_by_numbers(file.name))
    first = read_scan(files[0])

    def read(number: int) -> Floats:
        scan = read_scan(files[number])
        if len(scan.vertices) != len(first.vertices):
            raise InputError(
                f"{files[number]}: {len(scan.vertices):,} vertices, {files[0].name} has {len(first.vertices):,}"
            )
        if not np.array_equal(scan.triangles, first.triangles):
            raise InputError(f"{files[number]}: other triangles than {files[0].name}; expected one triangulation")
        return scan.vertices * factor

    return MeshSequence(tuple(file.name for file in files), first.triangles, read, first.notes)


def _order_by_numbers(name: str) -> list[tuple[int, int, str]]:
    """Return a key by which names sort, runs of digits by their value."""
    parts = re.split(r"(\d+)", name, flags=re.ASCII)
    return [(int(part), len(part), "") if part.isdigit() else (-1, 0, part) for part in parts]


def _from_npz(path: Path, factor: float) -> MeshSequence:
    if path.suffix.lower() != ".npz":
        raise InputError(f"{path}: expected a folder of meshes, or an .npz file with vertices (frames, n, 3)")
    arrays = read_arrays(path, kind="a sequence of meshes")
    if "vertices" not in arrays:
        raise InputError(f"{path}: not a sequence of meshes, array 'vertices' is missing")
    vertices = finite(f"{path}: vertices", arrays["vertices"], (None, None, 3))
    if not vertices.size:
        raise InputError(f"{path}: vertices: none, of shape {vertices.shape}")
    TAKE_FRAMES.check(f"{path}: it has", len(vertices))
    triangles = None
    if "triangles" in arrays:
        triangles = indices_below(f"{path}: triangles", arrays["triangles"], vertices.shape[1], (None, 3))
    names = tuple(f"frame {number}" for number in range(len(vertices)))
    return MeshSequence(names, triangles, lambda number: vertices[number] * factor)
