"""glTF 2.0 and GLB: the meshes of a scene as one, in the scene's axes, with their morph targets; Draco."""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..checks import finite, indices_below, rotations_from_quaternions, shape, texts
from ..errors import InputError, MissingDependencyError, escape, quote
from ..limits import FILE_BYTES, MORPH_VALUES, VERTICES
from ..mesh import Floats, Ints
from .text import find_beside, parse_json, read_bytes, read_json

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
FLOAT = 5126
_WIDTHS = {"SCALAR": 1, "VEC3": 3}
_KNOWN = {"KHR_draco_mesh_compression", "KHR_mesh_quantization"}
_MESHOPT = {"EXT_meshopt_compression", "KHR_meshopt_compression"}
LARGEST = 1e12
"""Largest number in a transform."""
FLAT = 1e-9
"""Least determinant over the cube of a transform's largest number: below it no volume is left."""
ENDED = "the file is shorter than it says: is its end missing?"


def read_gltf(path: Path) -> tuple[Floats, Ints, dict[str, Floats]]:
    """Read vertices (n, 3), triangles (m, 3) and what each named morph target adds, shape (n, 3), in the scene's axes.

    Nodes' transforms are applied; skeletons, strips, fans, materials and textures are left out.
    InputError says what is damaged, or which extension is not known.
    """
    try:
        with np.errstate(all="ignore"):  # numbers that overflow are refused where the mesh is made
            return _Document(path).mesh()
    except InputError:
        raise
    except KeyError as error:
        raise InputError(f"not a sound glTF file ({quote(str(error.args[0]))} is missing)") from None
    except (IndexError, TypeError, ValueError, AttributeError, struct.error, OverflowError, RecursionError) as error:
        raise InputError(f"not a sound glTF file ({type(error).__name__}: {escape(str(error))[:60]})") from None


class _Document:
    def __init__(self, path: Path):
        self._path = path
        binary = path.suffix.lower() == ".glb"
        self._json, self._chunk = _glb(read_bytes(path)) if binary else (read_json(path, "a glTF file"), None)
        if not isinstance(self._json, dict) or not str(self._json.get("asset", {}).get("version", "")).startswith("2"):
            raise InputError("not a glTF 2.0 file")
        needed = {name for name in self._json.get("extensionsRequired", ()) if not name.startswith("KHR_materials_")}
        unknown = sorted(needed - _KNOWN - {"KHR_texture_basisu", "KHR_texture_transform", "EXT_texture_webp"})
        if needed & _MESHOPT:
            raise InputError("it is compressed by meshoptimizer, which is not read; export it without, or with Draco")
        if unknown:
            raise InputError(f"it needs the glTF extension {quote(unknown[0])!r}, which is not read; export it without")
        self._buffers: dict[int, memoryview] = {}
        listed = [_bytes("byteLength", buffer["byteLength"]) for buffer in self._json.get("buffers", ())]
        FILE_BYTES.check("its buffers have", sum(listed))

    def mesh(self) -> tuple[Floats, Ints, dict[str, Floats]]:
        """Return all instances of meshes in the scene, one after another."""
        vertices: list[Floats] = []
        triangles: list[Ints] = []
        morphs: list[dict[str, Floats]] = []
        read: dict[int, list[tuple[Floats, Ints, dict[str, Floats]]]] = {}
        first = 0
        for node, matrix in self._place_meshes():
            if node["mesh"] not in read:
                read[node["mesh"]] = list(self._primitives(self._item("meshes", node["mesh"])))
            linear, shift = matrix[:3, :3], finite("a node's transform", matrix[:3, 3])
            grown = np.linalg.det(finite("a node's transform", linear))
            if np.abs(grown) <= FLAT * np.abs(linear).max() ** 3:
                raise InputError("a node's transform flattens its mesh")
            for x, corners, targets in read[node["mesh"]]:
                vertices.append(np.einsum("ij,nj->ni", linear, x) + shift)
                # A mirrored mesh would be inside out.
                triangles.append(first + (corners[:, ::-1] if grown < 0.0 else corners))
                morphs.append({name: np.einsum("ij,nj->ni", linear, deltas) for name, deltas in targets.items()})
                first = VERTICES.check("its scene has", first + len(x))
        if not vertices:
            raise InputError("no triangles found; is there a mesh in its scene?")
        counts = [len(x) for x in vertices]
        all_names = dict.fromkeys(name for targets in morphs for name in targets)
        MORPH_VALUES.check("its scene has", 3 * first * len(all_names))
        joined = {
            name: np.vstack([t.get(name, np.zeros((k, 3))) for t, k in zip(morphs, counts, strict=True)])
            for name in all_names
        }
        return np.vstack(vertices), np.vstack(triangles), joined

    def _count(self, number: int) -> int:
        return self._item("accessors", number)["count"]

    def _item(self, kind: str, number: Any) -> Any:
        """Return an object by its number in one of the document's lists."""
        listed = self._json[kind]
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(listed):
            raise InputError(f"{kind}: {quote(number)} is none of its {len(listed)}")
        return listed[number]

    def _place_meshes(self) -> list[tuple[dict, Floats]]:
        """Return nodes that have a mesh, with their global transform (4, 4)."""
        nodes = self._json.get("nodes", [])
        parents: dict[int, int | None] = {}
        scenes = self._json.get("scenes")
        children = {child for node in nodes for child in node.get("children", ())}
        roots = [k for k in range(len(nodes)) if k not in children]
        shown_nodes = self._item("scenes", self._json.get("scene", 0)).get("nodes", []) if scenes else roots

        def walk(k: int, parent: int | None) -> None:
            node = self._item("nodes", k)
            if k in parents:
                raise InputError(f"its nodes are no tree: node {k} is reached twice")
            parents[k] = parent
            for child in node.get("children", ()):
                walk(child, k)

        for root in shown_nodes:
            walk(root, None)
        if not any("mesh" in nodes[k] for k in parents):
            for root in roots:
                if root not in parents:
                    walk(root, None)
        placed: dict[int, Floats] = {}
        for k, parent in parents.items():
            local = _local(nodes[k])
            placed[k] = local if parent is None else placed[parent] @ local
        # A scale of zeros hides a node.
        return [(nodes[k], placed[k]) for k in parents if "mesh" in nodes[k] and placed[k][:3, :3].any()]

    def _primitives(self, mesh: dict) -> Iterator[tuple[Floats, Ints, dict[str, Floats]]]:
        """Yield vertices, triangles and named targets of a mesh's parts; only lists of triangles are read."""
        extras = mesh.get("extras")
        names = texts("targetNames", extras.get("targetNames", [])) if isinstance(extras, dict) else ()
        for primitive in mesh["primitives"]:
            if primitive.get("mode", 4) == 4 and "POSITION" in primitive["attributes"]:
                x, triangles = self._triangles(primitive)
                targets: dict[str, Floats] = {}
                MORPH_VALUES.check("a mesh has", x.size * len(primitive.get("targets", ())))
                for k, target in enumerate(primitive.get("targets", ())):
                    name = escape(names[k])[:200] if k < len(names) else f"target {k}"
                    if name in targets:
                        raise InputError(f"morph target {quote(name)!r} stands there twice")
                    if "POSITION" in target:
                        targets[name] = self._accessor(target["POSITION"], "VEC3")
                        shape(f"morph target {name!r}", targets[name], (len(x), 3))
                yield x, triangles, targets

    def _triangles(self, primitive: dict) -> tuple[Floats, Ints]:
        attributes = primitive["attributes"]
        packed = primitive.get("extensions", {}).get("KHR_draco_mesh_compression")
        if packed is not None:
            x, triangles = decode_draco(bytes(self._view(packed["bufferView"])), packed["attributes"]["POSITION"])
            shape("Draco's vertices", x, (self._count(attributes["POSITION"]), 3))
            shape("Draco's corners", triangles.ravel(), (self._count(primitive["indices"]),))
        else:
            x = self._accessor(attributes["POSITION"], "VEC3", stored=True)
            ids = np.arange(len(x))
            if "indices" in primitive:
                ids = self._accessor(primitive["indices"], "SCALAR", integer=True, stored=True)[:, 0].astype(np.int64)
            if len(ids) % 3:
                raise InputError(f"triangles: {len(ids):,} corners, no multiple of 3")
            triangles = ids.reshape(-1, 3)
        return x, indices_below("triangles", triangles, len(x), (None, 3))

    def _accessor(self, number: int, kind_of: str, *, integer: bool = False, stored: bool = False) -> Floats:
        """Return an accessor's values as floats, shape (count, width); it has to be of that type, as "VEC3".

        `integer`: its numbers have to be integers; `stored`: they have to be in the file, not zeros that it leaves out.
        """
        accessor = self._item("accessors", number)
        if accessor["type"] != kind_of:
            raise InputError(f"accessor {number}: of type {quote(accessor['type'])}, expected {kind_of}")
        if integer and accessor["componentType"] == FLOAT:
            raise InputError(f"accessor {number}: of floats, expected integers")
        if stored and "bufferView" not in accessor:
            raise InputError(f"accessor {number}: its numbers are not in the file")
        kind, width = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[kind_of]
        count = self._count(number)
        view, offset = accessor.get("bufferView"), accessor.get("byteOffset", 0)
        if view is None:
            # Zeros take no place in the file.
            values = np.zeros((VERTICES.check(f"accessor {number}", count), width))
        else:
            stride = self._item("bufferViews", view).get("byteStride", width * kind.itemsize)
            values = _read_strided(self._view(view), offset, kind, count, width, stride).astype(np.float64)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            ids = self._sparse(sparse, "indices", np.dtype(_TYPES[sparse["indices"]["componentType"]]), 1)[:, 0]
            ids = indices_below("sparse indices", ids, count)
            if (np.diff(ids) <= 0).any():
                raise InputError("sparse indices: they do not rise")
            values[ids] = self._sparse(sparse, "values", kind, width)
        if accessor.get("normalized") and kind.kind != "f":
            values = np.maximum(values / np.iinfo(kind).max, -1.0)
        return finite(f"accessor {number}", values)

    def _sparse(self, sparse: dict, which: str, kind: np.dtype, width: int) -> np.ndarray:
        offset = sparse[which].get("byteOffset", 0)
        count = VERTICES.check("sparse", sparse["count"])
        return _read_strided(self._view(sparse[which]["bufferView"]), offset, kind, count, width, width * kind.itemsize)

    def _view(self, number: int) -> memoryview:
        view = self._item("bufferViews", number)
        whole = self._buffer(view["buffer"])
        start = _bytes("byteOffset", view.get("byteOffset", 0), len(whole))
        return whole[start : start + _bytes("byteLength", view["byteLength"], len(whole) - start)]

    def _buffer(self, number: int) -> memoryview:
        """Return a buffer, of which no more is read than its stated length."""
        if number not in self._buffers:
            buffer = self._item("buffers", number)
            uri, size = buffer.get("uri"), _bytes("byteLength", buffer["byteLength"])
            if uri is None:
                if self._chunk is None or number > 0:
                    raise InputError("its binary chunk is missing")
                content = self._chunk
            else:
                content = self._resource(uri, size)
            _bytes("byteLength", size, len(content))
            self._buffers[number] = content[:size]
        return self._buffers[number]

    def _resource(self, uri: str, first: int | None = None) -> memoryview:
        """Return what a name in the document stands for, within it or in a file beside it, which may be cut short."""
        if uri.startswith("data:"):
            return memoryview(_from_base64(uri))
        return memoryview(read_bytes(find_beside(self._path, unquote(uri)), first=first))


def _from_base64(uri: str) -> bytes:
    kind, _, text = uri.partition(",")
    if not kind.endswith(";base64"):
        raise InputError(f"a buffer within the file is of the kind {quote(kind)!r}; expected base64")
    try:
        return base64.b64decode(text, validate=True)
    except binascii.Error as error:
        raise InputError(f"a buffer within the file is no base64 ({error})") from None


def _glb(content: bytes) -> tuple[Any, memoryview | None]:
    """Return the JSON and the binary chunk of a GLB file."""
    if content[:4] != b"glTF":
        raise InputError("not a GLB file (it does not begin with 'glTF')")
    version, size = struct.unpack("<II", content[4:12])
    if version != 2:
        raise InputError(f"a GLB file of version {version}; expected 2")
    if size > len(content):
        raise InputError(ENDED)
    chunks: dict[bytes, memoryview] = {}
    place = 12
    while place + 8 <= len(content) and len(chunks) < 2:
        length, kind = struct.unpack("<I4s", content[place : place + 8])
        if place + 8 + length > len(content):
            raise InputError(ENDED)
        chunks.setdefault(kind, memoryview(content)[place + 8 : place + 8 + length])
        place += 8 + length
    if b"JSON" not in chunks:
        raise InputError("not a GLB file (it has no chunk of JSON)")
    return parse_json(bytes(chunks[b"JSON"]).rstrip(b"\0 ")), chunks.get(b"BIN\0")


def _bytes(name: str, number: Any, most: int = FILE_BYTES.most) -> int:
    """Return a count of bytes, at most `most`."""
    if isinstance(number, bool) or not isinstance(number, int) or number < 0:
        raise InputError(f"{name}: {quote(number)} is no count of bytes")
    if number > most:
        raise InputError(ENDED)
    return number


def _read_strided(content: memoryview, offset: Any, kind: np.dtype, count: int, width: int, stride: Any) -> np.ndarray:
    size = width * kind.itemsize
    if not size <= _bytes("byteStride", stride, 65536):  # the specification has 252
        raise InputError(f"byteStride: {stride}, below the {size} bytes of an element")
    if _bytes("byteOffset", offset, len(content)) + max(count - 1, 0) * stride + size * (count > 0) > len(content):
        raise InputError("an accessor reaches beyond its buffer: is the file's end missing?")
    raw = np.frombuffer(content, dtype=np.uint8)
    rows = np.lib.stride_tricks.as_strided(raw[offset:], (count, size), (stride, 1), writeable=False)
    return np.ascontiguousarray(rows).view(kind).reshape(count, width)


def _local(node: dict) -> Floats:
    """Return a node's transform (4, 4)."""
    if "matrix" in node:
        return _affine("matrix", finite("matrix", node["matrix"], (16,), most=LARGEST))
    matrix = np.eye(4)
    if "rotation" in node:
        matrix[:3, :3] = rotations_from_quaternions("rotation", [node["rotation"]])[0]
    if "scale" in node:
        matrix[:3, :3] *= finite("scale", node["scale"], (3,), most=LARGEST)
    if "translation" in node:
        matrix[:3, 3] = finite("translation", node["translation"], (3,), most=LARGEST)
    return matrix


def _affine(name: str, columns: Floats) -> Floats:
    """Return matrices (..., 4, 4) of their columns, shape (..., 16), whose last row has to be 0 0 0 1."""
    matrices = np.swapaxes(columns.reshape(*columns.shape[:-1], 4, 4), -1, -2)
    if (np.abs(matrices[..., 3, :] - (0.0, 0.0, 0.0, 1.0)) > 1e-6).any():
        raise InputError(f"{name}: its last row is not 0, 0, 0, 1")
    return matrices


def decode_draco(content: bytes, number: int) -> tuple[Floats, Ints]:
    """Return vertices (n, 3) and triangles (m, 3) of a Draco buffer; `number`: the unique id of the attribute.

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
            if attribute.get("unique_id") == number and np.shape(attribute.get("data"))[1:] == (3,):
                points = np.asarray(attribute["data"], dtype=np.float64)
        return points, np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # the C++ library raises whatever the damage makes it raise
        raise InputError(f"its Draco data are damaged ({str(error)[:60]})") from None
