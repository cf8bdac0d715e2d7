"""glTF 2.0 (.glb, metres): a rig of morph targets, and the take that it plays."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from .atomic import write_whole
from .morphs import MorphedSurface, MorphRig

METRES = 1e-3
FLOAT, UNSIGNED = 5126, 5125
ARRAY, ELEMENTS = 34962, 34963


def write_glb(path: str | os.PathLike[str], rig: MorphRig) -> None:
    """Write a rig: a node for each surface below one of the whole head, and an animation where a take plays.

    Target names stand in each mesh's `extras`, where three.js and Blender look for them, the rig's notes in those of
    the asset. Raises InputError for a file that cannot be written.
    """
    binary = _Binary()
    nodes, meshes, materials = [], [], []
    for k, surface in enumerate(rig.surfaces):
        place = (METRES * np.asarray(surface.place)).tolist()
        nodes.append({"name": surface.name, "mesh": k, "translation": place})
        meshes.append(_mesh(binary, k, surface, rig.names))
        base = [1.0, 1.0, 1.0] if np.ndim(surface.colour) > 1 else list(surface.colour)
        look = {"baseColorFactor": [*base, 1.0], "metallicFactor": 0.0}
        materials.append({"name": surface.name, "doubleSided": True, "pbrMetallicRoughness": look})
    content: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "softdeca", "extras": dict(rig.notes)},
        "scene": 0,
        "scenes": [{"nodes": [len(nodes)]}],
        "nodes": [*nodes, {"name": "head", "children": list(range(len(nodes)))}],
        "materials": materials,
        "meshes": meshes,
    }
    if rig.weights.size:
        sampler = {
            "input": binary.scalars((rig.times - rig.times[0]).astype("<f4"), FLOAT),
            "output": binary.scalars(rig.weights.ravel().astype("<f4"), FLOAT),
            "interpolation": "LINEAR",
        }
        moved = [k for k, surface in enumerate(rig.surfaces) if len(surface.targets)]
        channels = [{"sampler": 0, "target": {"node": k, "path": "weights"}} for k in moved]
        content["animations"] = [{"name": "take", "samplers": [sampler], "channels": channels}]
    write_whole(path, binary.glb(content))


def _mesh(binary: _Binary, number: int, surface: MorphedSurface, names: Sequence[str]) -> dict[str, Any]:
    """Add a surface's numbers; return its mesh."""
    rest = surface.rest
    attributes = {
        "POSITION": binary.vectors(METRES * rest.vertices, ARRAY),
        "NORMAL": binary.vectors(rest.vertex_normals, ARRAY),
    }
    if np.ndim(surface.colour) > 1:
        attributes["COLOR_0"] = binary.vectors(surface.colour, ARRAY)
    indices = binary.scalars(rest.triangles.ravel().astype("<u4"), UNSIGNED, ELEMENTS)
    primitive = {"attributes": attributes, "indices": indices, "material": number}
    if not len(surface.targets):
        return {"name": surface.name, "primitives": [primitive]}
    primitive["targets"] = [
        {"POSITION": binary.vectors(METRES * moved, ARRAY), "NORMAL": binary.vectors(turned, ARRAY)}
        for moved, turned in zip(surface.targets, surface.normals, strict=True)
    ]
    return {
        "name": surface.name,
        "primitives": [primitive],
        "weights": [0.0] * len(surface.targets),
        "extras": {"targetNames": list(names)},
    }


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
