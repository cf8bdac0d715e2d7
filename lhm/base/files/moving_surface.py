"""Moving surfaces: glTF 2.0 (.glb, metres) with morph targets, and temporal VTKHDF (millimetres)."""

from __future__ import annotations

import io
import json
import os
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..mesh import Floats, Ints, Surface
from .atomic import write_whole

METRES = 1e-3
FLOAT, UNSIGNED = 5126, 5125
ARRAY, ELEMENTS = 34962, 34963
COLOUR = (0.69, 0.37, 0.27, 1.0)  # linear, as glTF has it


@dataclass(frozen=True, eq=False)
class Morphs:
    """A motion as neutral + weights · targets: weights (k, t), targets (t, n, 3) [mm], greatest error [mm]."""

    weights: Floats
    targets: NDArray[np.float32]
    error: float


def reduce_to_morphs(motion: NDArray[np.float32], *, tolerance: float, most: int = 256) -> Morphs:
    """Find as few morph targets as bring every vertex of every frame within `tolerance` [mm], at most `most`.

    motion (k, n, 3) [mm]: displacements from neutral. The targets are chosen greedily: the displacement that is worst
    represented so far, less what the earlier targets have of it (a reduced basis, with its bound on the worst case
    that principal components lack). Each weight reaches 1 at the frame that its target is taken from.
    """
    remainder = np.array(motion, dtype=np.float32).reshape(len(motion), -1)
    targets: list[NDArray[np.float32]] = []
    columns: list[Floats] = []
    while True:
        off = np.sqrt((remainder.reshape(len(remainder), -1, 3) ** 2).sum(axis=2).max(axis=1))
        worst = int(np.argmax(off))
        if off[worst] <= tolerance or len(targets) == min(most, len(motion)):
            weights = np.stack(columns, axis=1) if columns else np.zeros((len(motion), 0))
            stacked = np.array(targets, dtype=np.float32).reshape(len(targets), motion.shape[1], 3)
            return Morphs(weights, stacked, float(off[worst]))
        target = remainder[worst].copy()
        column = (remainder @ target) / np.float32(target @ target)
        remainder -= column[:, None] * target
        targets.append(target)
        columns.append(column.astype(np.float64))


def write_gltf(
    path: str | os.PathLike[str],
    neutral: Surface,
    times: Floats,
    motion: NDArray[np.float32],
    *,
    tolerance: float = 0.05,
) -> Morphs:
    """Write a skin [mm] whose displacements from neutral are `motion` (k, n, 3) [mm] at `times` (k,) [s], rising.

    Normals move by morph targets too, fitted to those of the frames by least squares. Returns the morphs, with their
    error; both stand in the mesh's `extras`. InputError for other shapes, or a file that cannot be written.
    """
    if motion.shape != (len(times), *neutral.vertices.shape):
        raise InputError(f"glTF: motion of shape {motion.shape} for {len(times)} times and {neutral.vertices.shape}")
    reduced = reduce_to_morphs(motion, tolerance=tolerance)
    _write(path, neutral, times, reduced, _normal_targets(neutral, motion, reduced.weights), name="skin")
    return reduced


def write_rig(
    path: str | os.PathLike[str],
    neutral: Surface,
    times: Floats,
    rig: Morphs,
    usual: Floats,
) -> None:
    """Write a skin [mm] with given morph targets, played by their weights at `times` (k,) [s], rising.

    usual: weights (u, t) of usual motions, for which the normals of the targets are fitted by least squares. Raises
    InputError for a file that cannot be written.
    """
    motion = np.tensordot(usual, rig.targets, axes=1).astype(np.float32)
    _write(path, neutral, times, rig, _normal_targets(neutral, motion, usual), name="rig")


def _write(
    path: str | os.PathLike[str],
    neutral: Surface,
    times: Floats,
    reduced: Morphs,
    normals: Floats,
    *,
    name: str,
) -> None:
    """Write a skin [mm], its morph targets with what they add to the normals (t, n, 3), and their weights over time."""
    binary = _Binary()
    attributes = {
        "POSITION": binary.vectors(METRES * neutral.vertices, ARRAY),
        "NORMAL": binary.vectors(neutral.vertex_normals, ARRAY),
    }
    indices = binary.scalars(neutral.triangles.ravel().astype("<u4"), UNSIGNED, ELEMENTS)
    targets = [
        {"POSITION": binary.vectors(METRES * moved, ARRAY), "NORMAL": binary.vectors(turned, ARRAY)}
        for moved, turned in zip(reduced.targets, normals, strict=True)
    ]
    primitive = {"attributes": attributes, "indices": indices, "material": 0}
    mesh: dict[str, Any] = {"name": name, "primitives": [primitive | ({"targets": targets} if targets else {})]}
    mesh["extras"] = {"greatest_error_mm": reduced.error, "morph_targets": len(targets)}
    content: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "softdeca"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": name, "mesh": 0}],
        "materials": [
            {"doubleSided": True, "pbrMetallicRoughness": {"baseColorFactor": COLOUR, "metallicFactor": 0.0}}
        ],
        "meshes": [mesh],
    }
    if targets:
        mesh["weights"] = [0.0] * len(targets)
        sampler = {
            "input": binary.scalars((times - times[0]).astype("<f4"), FLOAT),
            "output": binary.scalars(reduced.weights.ravel().astype("<f4"), FLOAT),
            "interpolation": "LINEAR",
        }
        channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
        content["animations"] = [{"name": "take", "samplers": [sampler], "channels": [channel]}]
    write_whole(path, binary.glb(content))


def _normal_targets(neutral: Surface, motion: NDArray[np.float32], weights: Floats) -> Floats:
    """Fit what each morph target adds to the normals, (t, n, 3), by least squares over a sample of the frames."""
    count = weights.shape[1]
    some = np.unique(np.linspace(0, len(motion) - 1, min(len(motion), 4 * count + 8)).astype(int))
    turned = np.array([neutral.with_vertices(neutral.vertices + motion[k]).vertex_normals for k in some])
    turned -= neutral.vertex_normals
    fitted = np.linalg.lstsq(weights[some], turned.reshape(len(some), -1), rcond=1e-6)[0]
    return fitted.reshape(count, *neutral.vertices.shape)


class _Binary:
    """The binary chunk under construction, with its views and accessors."""

    def __init__(self):
        self._bytes = bytearray()
        self._views: list[dict] = []
        self._accessors: list[dict] = []

    def vectors(self, values, target: int) -> int:
        """Add (n, 3) floats; return the accessor's number."""
        array = np.ascontiguousarray(values, dtype="<f4")
        limits = {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        return self._add(array, len(array), FLOAT, "VEC3", limits, target)

    def scalars(self, array, kind: int, target: int | None = None) -> int:
        """Add (n,) numbers; return the accessor's number."""
        limits = {"min": [array.min().item()], "max": [array.max().item()]}
        return self._add(array, len(array), kind, "SCALAR", limits, target)

    def _add(self, array, count: int, kind: int, shape: str, limits: dict, target: int | None) -> int:
        view = {"buffer": 0, "byteOffset": len(self._bytes), "byteLength": array.nbytes}
        self._views.append(view | ({} if target is None else {"target": target}))
        self._bytes += array.tobytes()
        accessor = {"bufferView": len(self._views) - 1, "componentType": kind, "count": count, "type": shape}
        self._accessors.append(accessor | limits)
        return len(self._accessors) - 1

    def glb(self, content: dict) -> bytes:
        """Return the file: header, JSON chunk padded by spaces, binary chunk; all numbers are of four bytes."""
        whole = content | {
            "buffers": [{"byteLength": len(self._bytes)}],
            "bufferViews": self._views,
            "accessors": self._accessors,
        }
        text = json.dumps(whole, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self._bytes), b"BIN\0") + bytes(self._bytes)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


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
