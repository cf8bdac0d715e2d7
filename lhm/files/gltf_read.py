"""glTF 2.0 and GLB: the meshes of a scene as one, in the scene's axes, with their morph targets; Draco and meshopt."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..errors import InputError
from ..mesh import Floats, Ints
from .draco import decode_draco
from .meshopt import decode_meshopt

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_KNOWN = {
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_mesh_quantization",
}
DEEPEST = 100


def read_gltf(path: Path) -> tuple[Floats, Ints, dict[str, Floats]]:
    """Vertices (n, 3), triangles (m, 3) and what each named morph target adds, shape (n, 3), in the scene's axes.

    Nodes' transforms and skins (as they are posed in the file) are applied; materials and textures are left out.
    InputError says what is damaged, or which extension is not known.
    """
    try:
        return _Document(path).mesh()
    except InputError:
        raise
    except RecursionError:
        raise InputError("its nodes form a circle") from None
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, struct.error, OverflowError) as error:
        raise InputError(f"not a sound glTF file ({type(error).__name__}: {str(error)[:60]})") from None


class _Document:
    def __init__(self, path: Path):
        self._folder = path.parent
        self._json, self._chunk = _glb(path.read_bytes()) if path.suffix.lower() == ".glb" else (_text(path), None)
        if not isinstance(self._json, dict) or not str(self._json.get("asset", {}).get("version", "")).startswith("2"):
            raise InputError("not a glTF 2.0 file")
        needed = {name for name in self._json.get("extensionsRequired", ()) if not name.startswith("KHR_materials_")}
        unknown = sorted(needed - _KNOWN - {"KHR_texture_basisu", "KHR_texture_transform", "EXT_texture_webp"})
        if unknown:
            raise InputError(f"it needs the glTF extension {unknown[0]!r}, which is not read; export it without")
        self._buffers: dict[int, bytes] = {}
        self._views: dict[int, bytes] = {}

    def mesh(self) -> tuple[Floats, Ints, dict[str, Floats]]:
        """All instances of meshes in the scene, one after another."""
        vertices: list[Floats] = []
        triangles: list[Ints] = []
        morphs: list[dict[str, Floats]] = []
        first = 0
        for node, matrix in self._placed():
            mesh = self._json["meshes"][node["mesh"]]
            names = mesh.get("extras", {}).get("targetNames", []) if isinstance(mesh.get("extras"), dict) else []
            for primitive in mesh["primitives"]:
                found = self._primitive(primitive, names)
                if found is None:
                    continue
                x, corners, targets = found
                linear, shift = self._transforms(primitive, node, matrix, len(x))
                vertices.append(np.einsum("nij,nj->ni", linear, x) + shift)
                triangles.append(corners + first)
                morphs.append({name: np.einsum("nij,nj->ni", linear, moved) for name, moved in targets.items()})
                first += len(x)
        if not vertices:
            raise InputError("no triangles found; is there a mesh in its scene?")
        counts = [len(x) for x in vertices]
        every = dict.fromkeys(name for targets in morphs for name in targets)
        joined = {
            name: np.vstack([t.get(name, np.zeros((k, 3))) for t, k in zip(morphs, counts, strict=True)])
            for name in every
        }
        return np.vstack(vertices), np.vstack(triangles), joined

    def _placed(self) -> Iterator[tuple[dict, Floats]]:
        """Nodes that have a mesh, with their global transform (4, 4)."""
        nodes = self._json.get("nodes", [])
        self._global: dict[int, Floats] = {}
        scenes = self._json.get("scenes")
        children = {child for node in nodes for child in node.get("children", ())}
        roots = [k for k in range(len(nodes)) if k not in children]
        shown = scenes[self._json.get("scene", 0)].get("nodes", []) if scenes else roots

        def walk(k: int, above: Floats, depth: int) -> Iterator[int]:
            if depth > DEEPEST:
                raise RecursionError
            self._global[k] = above @ _local(nodes[k])
            yield k
            for child in nodes[k].get("children", ()):
                yield from walk(child, self._global[k], depth + 1)

        order = [k for root in shown for k in walk(root, np.eye(4), 0)]
        if not any("mesh" in nodes[k] for k in order):
            order += [k for root in roots if root not in self._global for k in walk(root, np.eye(4), 0)]
        return ((nodes[k], self._global[k]) for k in order if "mesh" in nodes[k])

    def _transforms(self, primitive: dict, node: dict, matrix: Floats, count: int) -> tuple[Floats, Floats]:
        """Per vertex the linear map (n, 3, 3) and the shift (n, 3) by node or skin."""
        attributes = primitive["attributes"]
        skin = self._json["skins"][node["skin"]] if "skin" in node else None
        if skin is None or "JOINTS_0" not in attributes or "inverseBindMatrices" not in skin:
            return np.broadcast_to(matrix[:3, :3], (count, 3, 3)), np.broadcast_to(matrix[:3, 3], (count, 3))
        inverse = self._accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        joints = np.array([self._global.get(j, np.eye(4)) for j in skin["joints"]]) @ inverse
        which = self._accessor(attributes["JOINTS_0"]).astype(np.int64)
        weights = self._accessor(attributes["WEIGHTS_0"])
        weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
        blended = np.einsum("nk,nkij->nij", weights, joints[which])
        return blended[:, :3, :3], blended[:, :3, 3]

    def _primitive(self, primitive: dict, names: list) -> tuple[Floats, Ints, dict[str, Floats]] | None:
        """Vertices, triangles and named targets; None for points and lines."""
        mode = primitive.get("mode", 4)
        if mode not in (4, 5, 6) or "POSITION" not in primitive["attributes"]:
            return None
        packed = primitive.get("extensions", {}).get("KHR_draco_mesh_compression")
        if packed is not None:
            x, triangles = decode_draco(self._view(packed["bufferView"]), packed["attributes"]["POSITION"])
        else:
            x = self._accessor(primitive["attributes"]["POSITION"])
            ids = np.arange(len(x))
            if "indices" in primitive:
                ids = self._accessor(primitive["indices"])[:, 0].astype(np.int64)
            triangles = _triangles(ids, mode)
        targets = {}
        for k, target in enumerate(primitive.get("targets", ())):
            name = str(names[k]) if k < len(names) else f"target {k}"
            if "POSITION" in target:
                targets[name] = self._accessor(target["POSITION"])
        return x, triangles, targets

    def _accessor(self, number: int) -> Floats:
        """An accessor's values as floats, shape (count, width)."""
        accessor = self._json["accessors"][number]
        kind, width, count = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]], accessor["count"]
        values = np.zeros((count, width))
        if "bufferView" in accessor:
            view = self._json["bufferViews"][accessor["bufferView"]]
            stride = view.get("byteStride") or width * kind.itemsize
            content = self._view(accessor["bufferView"])
            values[:] = _strided(content, accessor.get("byteOffset", 0), kind, count, width, stride)
        if "sparse" in accessor:
            values[self._sparse(accessor["sparse"], "indices", 1)[:, 0].astype(np.int64)] = self._sparse(
                accessor["sparse"], "values", width, kind
            )
        if accessor.get("normalized") and kind.kind != "f":
            values = np.maximum(values / np.iinfo(kind).max, -1.0)
        return values

    def _sparse(self, sparse: dict, which: str, width: int, kind: np.dtype | None = None) -> np.ndarray:
        kind = np.dtype(_TYPES[sparse[which]["componentType"]]) if kind is None else kind
        content = self._view(sparse[which]["bufferView"])
        offset = sparse[which].get("byteOffset", 0)
        return _strided(content, offset, kind, sparse["count"], width, width * kind.itemsize)

    def _view(self, number: int) -> bytes:
        if number not in self._views:
            view = self._json["bufferViews"][number]
            extensions = view.get("extensions", {})
            packed = extensions.get("EXT_meshopt_compression") or extensions.get("KHR_meshopt_compression")
            source = view if packed is None else packed
            start = source.get("byteOffset", 0)
            content = self._buffer(source["buffer"])[start : start + source["byteLength"]]
            if len(content) < source["byteLength"]:
                raise InputError("the file is shorter than it says: is its end missing?")
            if packed is not None:
                content = decode_meshopt(
                    content, packed["count"], packed["byteStride"], packed["mode"], packed.get("filter", "NONE")
                )
            self._views[number] = content
        return self._views[number]

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            uri = self._json["buffers"][number].get("uri")
            if uri is None:
                if self._chunk is None:
                    raise InputError("its binary chunk is missing")
                self._buffers[number] = self._chunk
            elif uri.startswith("data:"):
                self._buffers[number] = base64.b64decode(uri.partition(",")[2])
            else:
                file = self._folder / unquote(uri)
                if not file.is_file():
                    raise InputError(f"its data file {uri!r} is not beside it")
                self._buffers[number] = file.read_bytes()
        return self._buffers[number]


def _glb(content: bytes) -> tuple[Any, bytes | None]:
    """The JSON and the binary chunk of a GLB file."""
    if content[:4] != b"glTF":
        raise InputError("not a GLB file (it does not begin with 'glTF')")
    if struct.unpack("<I", content[8:12])[0] > len(content):
        raise InputError("the file is shorter than it says: is its end missing?")
    chunks, place = [], 12
    while place + 8 <= len(content):
        length, kind = struct.unpack("<I4s", content[place : place + 8])
        chunks.append((kind, content[place + 8 : place + 8 + length]))
        place += 8 + length
    text = next(data for kind, data in chunks if kind == b"JSON")
    return json.loads(text), next((data for kind, data in chunks if kind == b"BIN\0"), None)


def _text(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"not a glTF file ({str(error)[:60]})") from None


def _strided(content: bytes, offset: int, kind: np.dtype, count: int, width: int, stride: int) -> np.ndarray:
    size = width * kind.itemsize
    if offset < 0 or offset + (count - 1) * stride + size > len(content):
        raise InputError("an accessor reaches beyond its buffer: is the file's end missing?")
    raw = np.frombuffer(content, dtype=np.uint8)
    rows = np.lib.stride_tricks.as_strided(raw[offset:], (count, size), (stride, 1), writeable=False)
    return np.ascontiguousarray(rows).view(kind).reshape(count, width)


def _triangles(ids: Ints, mode: int) -> Ints:
    """Triangles of a list (mode 4), a strip (5) or a fan (6)."""
    if mode == 4:
        return ids[: len(ids) // 3 * 3].reshape(-1, 3)
    if mode == 6:
        return np.stack([np.full(len(ids) - 2, ids[0]), ids[1:-1], ids[2:]], axis=1)
    triangles = np.stack([ids[:-2], ids[1:-1], ids[2:]], axis=1)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


def _local(node: dict) -> Floats:
    """A node's own transform (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix
