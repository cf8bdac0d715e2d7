"""Moving surfaces as temporal VTKHDF, in millimetres."""

from __future__ import annotations

import io
import os
from collections.abc import Iterable

import h5py
import numpy as np

from ..errors import InputError
from ..mesh import Floats, Ints
from .atomic import write_whole

VERSION = (2, 0)
CELLS = ("Vertices", "Lines", "Polygons", "Strips")


def write_vtkhdf(path: str | os.PathLike[str], triangles: Ints, times: Floats, frames: Iterable[Floats]) -> None:
    """Write a surface of triangles (m, 3) at `times` [s], shape (k,), by k frames of vertices [mm], each (n, 3).

    Positions are kept as float32. The same input makes the same bytes. Raises InputError for frames of different
    shapes, another count than that of times, or a file that cannot be written; then it is as it was.
    """
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", track_order=False) as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array(VERSION, dtype=np.int64)
        root.attrs.create("Type", b"PolyData", dtype=h5py.string_dtype("ascii", 8))
        n = _points(root, times, frames)
        root["NumberOfPoints"] = np.array([n], dtype=np.int64)
        for kind in CELLS:
            corners = np.asarray(triangles if kind == "Polygons" else np.zeros((0, 3)), dtype=np.int64)
            cells = root.create_group(kind)
            cells["NumberOfCells"] = np.array([len(corners)], dtype=np.int64)
            cells["NumberOfConnectivityIds"] = np.array([corners.size], dtype=np.int64)
            cells["Offsets"] = 3 * np.arange(len(corners) + 1, dtype=np.int64)
            cells["Connectivity"] = corners.ravel()
        _steps(root, times, n)
    write_whole(path, buffer.getvalue())


def _points(root: h5py.Group, times: Floats, frames: Iterable[Floats]) -> int:
    """Write the vertices of all frames, one chunk each; return how many a frame has."""
    points, count = None, 0
    for count, frame in enumerate(frames, start=1):
        values = np.asarray(frame, dtype=np.float32)
        if points is None:
            shape = (len(times) * len(values), 3)
            points = root.create_dataset(
                "Points", shape, np.float32, chunks=(max(len(values), 1), 3), compression="gzip", shuffle=True
            )
            n = len(values)
        if values.shape != (n, 3) or count > len(times):
            raise InputError(f"VTKHDF: frame {count - 1} of shape {values.shape}; {len(times)} of ({n}, 3) expected")
        points[(count - 1) * n : count * n] = values
    if points is None or count != len(times):
        raise InputError(f"VTKHDF: {count} frames for {len(times)} times")
    return n


def _steps(root: h5py.Group, times: Floats, n: int):
    """Write where each step's part of the arrays begins: its own points, and always the same triangles."""
    count = len(times)
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(count)
    steps["Values"] = np.asarray(times, dtype=np.float64)
    steps["NumberOfParts"] = np.ones(count, dtype=np.int64)
    steps["PointOffsets"] = n * np.arange(count, dtype=np.int64)
    steps["PartOffsets"] = np.zeros(count, dtype=np.int64)
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        steps[name] = np.zeros((count, len(CELLS)), dtype=np.int64)
