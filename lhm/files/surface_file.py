"""Surfaces from files, and what a skin has to be before a head is fitted to it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from ..checked import checked
from ..errors import InputError, MeshError
from ..mesh import Ints, Surface
from .scan_file import read_scan

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
LEAST_EXTENT, GREATEST_EXTENT = 100.0, 600.0


@checked
def read_surface(path: str | os.PathLike[str], *, unit: str = "mm") -> Surface:
    """A triangle mesh from OBJ, PLY, STL, glTF, or NPZ with `vertices` and `triangles`; vertices keep their order.

    `unit` is the file's: mm, cm or m. Raises InputError, one line that names the file, if it is missing, empty,
    damaged, no mesh, or holds values that are not finite.
    """
    path = Path(path)
    if unit not in MILLIMETRES:
        raise InputError(f"unit {unit!r}: expected one of {', '.join(MILLIMETRES)}")
    scan = read_scan(path)
    try:
        return Surface(scan.vertices * MILLIMETRES[unit], scan.triangles)
    except MeshError as error:
        raise InputError(f"{path}: {error}") from None


def check_skin(surface: Surface, *, openings: int = 0) -> None:
    """Raise MeshError unless a skin is one closed, consistently oriented surface of a head's size.

    Up to `openings` holes are let pass: a scan is open at the neck.

    The message says how many holes there are, which edge has more than two triangles, how many pieces, or what the
    extent [mm] is where the unit seems wrong.
    """
    triangles = surface.triangles
    edges = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    unique, count = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    if (count > 2).any():
        first = unique[count > 2][0]
        raise MeshError(f"skin: {(count > 2).sum()} edges have more than two triangles, the first is {first.tolist()}")
    holes = _pieces(unique[count == 1])
    if holes > openings:
        wanted = "it must be closed" + (f" but for {openings}" if openings else "")
        raise MeshError(f"skin: the surface is open, with {holes} {'hole' if holes == 1 else 'holes'}; {wanted}")
    if len(np.unique(edges, axis=0)) != len(edges):
        raise MeshError("skin: neighbouring triangles are oriented against one another")
    pieces = _pieces(unique)
    if pieces > 1:
        raise MeshError(f"skin: {pieces} separate pieces; it must be one (leave out eyeballs, teeth and tongue)")
    extent = np.ptp(surface.vertices[np.unique(triangles)], axis=0)
    if extent.min() < LEAST_EXTENT or extent.max() > GREATEST_EXTENT:
        size = " x ".join(f"{length:.4g}" for length in extent)
        raise MeshError(
            f"skin: its extent is {size} mm, a head's lies within {LEAST_EXTENT:g}..{GREATEST_EXTENT:g}: units off?"
        )


def _pieces(edges: Ints) -> int:
    used, number = np.unique(edges, return_inverse=True)
    ends = number.reshape(edges.shape)
    graph = csr_matrix((np.ones(len(ends)), ends.T), shape=(len(used), len(used)))
    return int(connected_components(graph, directed=False)[0])
