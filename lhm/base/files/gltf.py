"""glTF 2.0 and GLB: the meshes of a scene as one, in the scene's axes, with their morph targets; Draco and meshopt."""

from __future__ import annotations

import base64
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..checks import finite, in_range, indices_below, shape
from ..errors import InputError, MissingDependencyError, escape, quote
from ..limits import CORNERS, GLTF_DEPTH, GLTF_NODES, MORPH_TARGETS, MORPH_VALUES, TRIANGLES, UNPACKED_BYTES, VERTICES
from ..mesh import Floats, Ints
from .meshopt import decode_meshopt
from .text import parse_json, read_bytes, read_json

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_KNOWN = {
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_mesh_quantization",
}
LARGEST = 1e12
"""Of a number in a transform."""
LONGEST_STRIDE = 65536
"""Bytes; the specification has 252."""
LONGEST_NAME = 200
ENDED = "the file is shorter than it says: is its end missing?"


def read_gltf(path: Path) -> tuple[Floats, Ints, dict[str, Floats]]:
    """Read vertices (n, 3), triangles (m, 3) and what each named morph target adds, shape (n, 3), in the scene's axes.

    Nodes' transforms and skins (as they are posed in the file) are applied; materials and textures are left out.
    InputError says what is damaged, or which extension is not known.
    """
    try:
        with np.errstate(all="ignore"):  # numbers that overflow are refused where the mesh is made
            return _Document(path).mesh()
    except InputError:
        raise
    except KeyError as error:
        raise InputError(f"not a sound glTF file ({quote(str(error.args[0]))} is missing)") from None
    except (IndexError, TypeError, ValueError, AttributeError, struct.error, OverflowError) as error:
        raise InputError(f"not a sound glTF file ({type(error).__name__}: {escape(str(error))[:60]})") from None


class _Document:
    def __init__(self, path: Path):
        self._folder = path.parent
        binary = path.suffix.lower() == ".glb"
        self._json, self._chunk = _glb(read_bytes(path)) if binary else (read_json(path, "a glTF file"), None)
        if not isinstance(self._json, dict) or not str(self._json.get("asset", {}).get("version", "")).startswith("2"):
            raise InputError("not a glTF 2.0 file")
        needed = {name for name in self._json.get("extensionsRequired", ()) if not name.startswith("KHR_materials_")}
        unknown = sorted(needed - _KNOWN - {"KHR_texture_basisu", "KHR_texture_transform", "EXT_texture_webp"})
        if unknown:
            raise InputError(f"it needs the glTF extension {unknown[0]!r}, which is not read; export it without")
        self._buffers: dict[int, bytes] = {}
        self._views: dict[int, bytes] = {}

    def mesh(self) -> tuple[Floats, Ints, dict[str, Floats]]:
        """Return all instances of meshes in the scene, one after another."""
        vertices: list[Floats] = []
        triangles: list[Ints] = []
        morphs: list[dict[str, Floats]] = []
        first = corners_in_all = values = 0
        for node, matrix in self._placed():
            mesh = self._item("meshes", node["mesh"])
            names = mesh.get("extras", {}).get("targetNames", []) if isinstance(mesh.get("extras"), dict) else []
            for primitive in mesh["primitives"]:
                parts = self._primitive(primitive, names)
                if parts is None:
                    continue
                x, corners, targets = parts
                first += len(x)
                corners_in_all += len(corners)
                values += 3 * len(x) * len(targets)
                VERTICES.check("its scene has", first)
                TRIANGLES.check("its scene has", corners_in_all)
                MORPH_VALUES.check("its scene has", values)
                linear, shift = self._transforms(primitive, node, matrix, len(x))
                vertices.append(np.einsum("nij,nj->ni", linear, x) + shift)
                triangles.append(corners + first - len(x))
                morphs.append({name: np.einsum("nij,nj->ni", linear, moved) for name, moved in targets.items()})
        if not vertices:
            raise InputError("no triangles found; is there a mesh in its scene?")
        counts = [len(x) for x in vertices]
        all_names = dict.fromkeys(name for targets in morphs for name in targets)
        MORPH_TARGETS.check("its scene has", len(all_names))
        MORPH_VALUES.check("its scene has", 3 * sum(counts) * len(all_names))
        joined = {
            name: np.vstack([t.get(name, np.zeros((k, 3))) for t, k in zip(morphs, counts, strict=True)])
            for name in all_names
        }
        return np.vstack(vertices), np.vstack(triangles), joined

    def _item(self, kind: str, number: Any) -> Any:
        """Return an object by its number in one of the document's lists."""
        listed = self._json[kind]
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(listed):
            raise InputError(f"{kind}: {quote(number)} is none of its {len(listed)}")
        return listed[number]

    def _placed(self) -> Iterator[tuple[dict, Floats]]:
        """Return nodes that have a mesh, with their global transform (4, 4)."""
        nodes = self._json.get("nodes", [])
        GLTF_NODES.check("it has", len(nodes))
        self._global: dict[int, Floats] = {}
        scenes = self._json.get("scenes")
        children = {child for node in nodes for child in node.get("children", ())}
        roots = [k for k in range(len(nodes)) if k not in children]
        shown_nodes = self._item("scenes", self._json.get("scene", 0)).get("nodes", []) if scenes else roots

        def walk(k: int, above: Floats, depth: int) -> Iterator[int]:
            GLTF_DEPTH.check("it has", depth)
            node = self._item("nodes", k)
            if k in self._global:
                raise InputError(f"its nodes are no tree: node {k} is reached twice")
            self._global[k] = above @ _local(node)
            yield k
            for child in node.get("children", ()):
                yield from walk(child, self._global[k], depth + 1)

        order = [k for root in shown_nodes for k in walk(root, np.eye(4), 0)]
        if not any("mesh" in nodes[k] for k in order):
            order += [k for root in roots if root not in self._global for k in walk(root, np.eye(4), 0)]
        return ((nodes[k], self._global[k]) for k in order if "mesh" in nodes[k])

    def _transforms(self, primitive: dict, node: dict, matrix: Floats, count: int) -> tuple[Floats, Floats]:
        """Return per vertex the linear map (n, 3, 3) and the shift (n, 3) by node or skin."""
        attributes = primitive["attributes"]
        skin = self._item("skins", node["skin"]) if "skin" in node else None
        if skin is None or "JOINTS_0" not in attributes or "inverseBindMatrices" not in skin:
            return np.broadcast_to(matrix[:3, :3], (count, 3, 3)), np.broadcast_to(matrix[:3, 3], (count, 3))
        listed = skin["joints"]
        for joint in listed:
            self._item("nodes", joint)
        bound = self._accessor(skin["inverseBindMatrices"], "MAT4")
        shape("inverseBindMatrices", bound, (len(listed), 16))
        inverse = bound.reshape(-1, 4, 4).transpose(0, 2, 1)
        joints = np.array([self._global.get(j, np.eye(4)) for j in listed]) @ inverse
        which = self._accessor(attributes["JOINTS_0"], "VEC4").astype(np.int64)
        which = indices_below("JOINTS_0", which, len(joints), (count, 4))
        weights = in_range("WEIGHTS_0", self._accessor(attributes["WEIGHTS_0"], "VEC4"), 0.0, 1e3, (count, 4))
        weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
        blended = np.zeros((count, 3, 4))
        for k in range(4):
            blended += weights[:, k, None, None] * joints[which[:, k], :3]
        return blended[:, :, :3], blended[:, :, 3]

    def _primitive(self, primitive: dict, names: list) -> tuple[Floats, Ints, dict[str, Floats]] | None:
        """Return vertices, triangles and named targets; None for points and lines."""
        mode = primitive.get("mode", 4)
        if mode not in (4, 5, 6) or "POSITION" not in primitive["attributes"]:
            return None
        packed = primitive.get("extensions", {}).get("KHR_draco_mesh_compression")
        if packed is not None:
            position = packed["attributes"]["POSITION"]
            x, triangles = decode_draco(self._view(packed["bufferView"]), position)
        else:
            x = self._accessor(primitive["attributes"]["POSITION"], "VEC3")
            ids = np.arange(len(x))
            if "indices" in primitive:
                ids = self._accessor(primitive["indices"], "SCALAR")[:, 0].astype(np.int64)
            triangles = _triangles(ids, mode)
        VERTICES.check("a mesh has", len(x))
        shape("POSITION", x, (None, 3))
        triangles = indices_below("triangles", triangles, len(x), (None, 3))
        listed = primitive.get("targets", ())
        MORPH_TARGETS.check("a mesh has", len(listed))
        MORPH_VALUES.check("a mesh has", 3 * len(x) * len(listed))
        targets = {}
        for k, target in enumerate(listed):
            name = escape(str(names[k]))[:LONGEST_NAME] if k < len(names) else f"target {k}"
            if "POSITION" in target:
                targets[name] = self._accessor(target["POSITION"], "VEC3")
                shape(f"morph target {name!r}", targets[name], (len(x), 3))
        return x, triangles, targets

    def _accessor(self, number: int, kind_of: str) -> Floats:
        """Return an accessor's values as floats, shape (count, width); it has to be of that type, as "VEC3"."""
        accessor = self._item("accessors", number)
        if accessor["type"] != kind_of:
            raise InputError(f"accessor {number}: of type {quote(accessor['type'])}, expected {kind_of}")
        kind, width = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[kind_of]
        # Zeros, where no view is named, take no place in the file.
        count = (CORNERS if width == 1 else VERTICES).check(f"accessor {number}", accessor["count"])
        view, offset = accessor.get("bufferView"), accessor.get("byteOffset", 0)
        if view is None:
            values = np.zeros((count, width))
        else:
            stride = self._item("bufferViews", view).get("byteStride", width * kind.itemsize)
            values = _strided(self._view(view), offset, kind, count, width, stride).astype(np.float64)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            ids = self._sparse(sparse, "indices", np.dtype(_TYPES[sparse["indices"]["componentType"]]), 1)[:, 0]
            values[indices_below("sparse indices", ids, count)] = self._sparse(sparse, "values", kind, width)
        if accessor.get("normalized") and kind.kind != "f":
            values = np.maximum(values / np.iinfo(kind).max, -1.0)
        return finite(f"accessor {number}", values)

    def _sparse(self, sparse: dict, which: str, kind: np.dtype, width: int) -> np.ndarray:
        offset = sparse[which].get("byteOffset", 0)
        count = VERTICES.check("sparse", sparse["count"])
        return _strided(self._view(sparse[which]["bufferView"]), offset, kind, count, width, width * kind.itemsize)

    def _view(self, number: int) -> bytes:
        if number not in self._views:
            view = self._item("bufferViews", number)
            extensions = view.get("extensions", {})
            packed = extensions.get("EXT_meshopt_compression") or extensions.get("KHR_meshopt_compression")
            source = view if packed is None else packed
            whole = self._buffer(source["buffer"])
            start = _within("byteOffset", source.get("byteOffset", 0), len(whole))
            size = _within("byteLength", source["byteLength"], len(whole) - start)
            content = whole[start : start + size]
            if packed is not None:
                count = CORNERS.check("its meshopt data have", packed["count"])
                stride = _within("byteStride", packed["byteStride"], 256)
                UNPACKED_BYTES.check("its meshopt data have", count * stride + sum(map(len, self._views.values())))
                content = decode_meshopt(content, count, stride, packed["mode"], packed.get("filter", "NONE"))
            self._views[number] = content
        return self._views[number]

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            uri = self._item("buffers", number).get("uri")
            if uri is None:
                if self._chunk is None:
                    raise InputError("its binary chunk is missing")
                self._buffers[number] = self._chunk
            elif uri.startswith("data:"):
                self._buffers[number] = base64.b64decode(uri.partition(",")[2])
            else:
                file = self._folder / unquote(uri)
                if not file.is_file():
                    raise InputError(f"its data file {quote(uri)!r} is not beside it")
                self._buffers[number] = read_bytes(file)
        return self._buffers[number]


def _glb(content: bytes) -> tuple[Any, bytes | None]:
    """Return the JSON and the binary chunk of a GLB file."""
    if content[:4] != b"glTF":
        raise InputError("not a GLB file (it does not begin with 'glTF')")
    if struct.unpack("<I", content[8:12])[0] > len(content):
        raise InputError(ENDED)
    chunks: dict[bytes, bytes] = {}
    place = 12
    while place + 8 <= len(content) and len(chunks) < 2:
        length, kind = struct.unpack("<I4s", content[place : place + 8])
        if place + 8 + length > len(content):
            raise InputError(ENDED)
        chunks.setdefault(kind, content[place + 8 : place + 8 + length])
        place += 8 + length
    if b"JSON" not in chunks:
        raise InputError("not a GLB file (it has no chunk of JSON)")
    return parse_json(chunks[b"JSON"].rstrip(b"\0 ")), chunks.get(b"BIN\0")


def _within(name: str, number: Any, most: int) -> int:
    """Return a count of bytes, at most `most`."""
    if isinstance(number, bool) or not isinstance(number, int) or number < 0:
        raise InputError(f"{name}: {quote(number)} is no count of bytes")
    if number > most:
        raise InputError(ENDED)
    return number


def _strided(content: bytes, offset: Any, kind: np.dtype, count: int, width: int, stride: Any) -> np.ndarray:
    size = width * kind.itemsize
    if not size <= _within("byteStride", stride, LONGEST_STRIDE):
        raise InputError(f"byteStride: {stride}, below the {size} bytes of an element")
    if _within("byteOffset", offset, len(content)) + max(count - 1, 0) * stride + size * (count > 0) > len(content):
        raise InputError("an accessor reaches beyond its buffer: is the file's end missing?")
    raw = np.frombuffer(content, dtype=np.uint8)
    rows = np.lib.stride_tricks.as_strided(raw[offset:], (count, size), (stride, 1), writeable=False)
    return np.ascontiguousarray(rows).view(kind).reshape(count, width)


def _triangles(ids: Ints, mode: int) -> Ints:
    """Return triangles of a list (mode 4), a strip (5) or a fan (6)."""
    if mode == 4:
        return ids[: len(ids) // 3 * 3].reshape(-1, 3)
    if len(ids) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    if mode == 6:
        return np.stack([np.full(len(ids) - 2, ids[0]), ids[1:-1], ids[2:]], axis=1)
    triangles = np.stack([ids[:-2], ids[1:-1], ids[2:]], axis=1)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


def _local(node: dict) -> Floats:
    """Return a node's own transform (4, 4)."""
    if "matrix" in node:
        return finite("matrix", node["matrix"], (16,), most=LARGEST).reshape(4, 4).T
    x, y, z, w = finite("rotation", node.get("rotation", (0.0, 0.0, 0.0, 1.0)), (4,), most=1.0 + 1e-3)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= finite("scale", node.get("scale", (1.0, 1.0, 1.0)), (3,), most=LARGEST)
    matrix[:3, 3] = finite("translation", node.get("translation", (0.0, 0.0, 0.0)), (3,), most=LARGEST)
    return matrix


def decode_draco(content: bytes, position: int) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) and triangles (m, 3) of a Draco buffer; `position`: the unique id of its positions.

    MissingDependencyError without DracoPy, InputError for a damaged buffer.
    """
    try:
        import DracoPy
    except ModuleNotFoundError:
        raise MissingDependencyError(
            "this file is compressed by Draco: pip install 'softdeca[draco]', or export it without compression"
        ) from None
    try:
        mesh = DracoPy.decode(content)
        points = np.asarray(mesh.points, dtype=np.float64)
        for attribute in getattr(mesh, "attributes", ()):
            if attribute.get("unique_id") == position and np.shape(attribute.get("data"))[1:] == (3,):
                points = np.asarray(attribute["data"], dtype=np.float64)
        return points, np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # the C++ library raises whatever the damage makes it raise
        raise InputError(f"its Draco data are damaged ({str(error)[:60]})") from None
