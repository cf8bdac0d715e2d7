"""glTF 2.0 and GLB: the meshes of a scene as one, in the scene's axes, with their morph targets; Draco."""

from __future__ import annotations

import base64
import binascii
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..checks import finite, in_range, indices_below, rotations_from_quaternions, shape, texts
from ..errors import InputError, MissingDependencyError, escape, quote
from ..limits import (
    CORNERS,
    FILE_BYTES,
    GLTF_DEPTH,
    GLTF_NODES,
    GLTF_PRIMITIVES,
    MORPH_TARGETS,
    MORPH_VALUES,
    TRIANGLES,
    VERTICES,
)
from ..mesh import Floats, Ints
from .text import find_beside, parse_json, read_bytes, read_json

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
FLOAT = 5126
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_KNOWN = {"KHR_draco_mesh_compression", "KHR_mesh_quantization"}
_MESHOPT = {"EXT_meshopt_compression", "KHR_meshopt_compression"}
LARGEST = 1e12
"""Of a number in a transform."""
QUANTISED = 0.02
"""Of a mesh's size: how far Draco's quantisation moves its extent, with 5 bits or more."""
FLAT = 1e-9
"""Of a transform's largest number, cubed: a determinant below leaves no volume."""
ENDED = "the file is shorter than it says: is its end missing?"


def read_gltf(path: Path) -> tuple[Floats, Ints, dict[str, Floats]]:
    """Read vertices (n, 3), triangles (m, 3) and what each named morph target adds, shape (n, 3), in the scene's axes.

    Nodes' transforms and skins (as they are posed in the file) are applied; materials and textures are left out.
    InputError says what is damaged, or which extension is not known.
    """
    with _naming_damage():
        return _Document(path).mesh()


@contextmanager
def _naming_damage() -> Iterator[None]:
    """Make every error of a damaged document an InputError."""
    try:
        with np.errstate(all="ignore"):  # numbers that overflow are refused where the mesh is made
            yield
    except InputError:
        raise
    except KeyError as error:
        raise InputError(f"not a sound glTF file ({quote(str(error.args[0]))} is missing)") from None
    except (IndexError, TypeError, ValueError, AttributeError, struct.error, OverflowError) as error:
        raise InputError(f"not a sound glTF file ({type(error).__name__}: {escape(str(error))[:60]})") from None


def read_gltf_picture(path: Path) -> tuple[bytes, Floats] | None:
    """Read a base colour's picture and where in it the corners of `read_gltf`'s triangles lie, shape (m, 3, 2).

    None without one. Of several the one counts that most triangles have; others' corners are NaN. InputError as there.
    """
    with _naming_damage():
        return _Document(path).picture()


@dataclass(frozen=True)
class _Primitive:
    """Vertices (n, 3), triangles (m, 3), named targets (n, 3), and joints and weights (n, 4) of a skin.

    entry: what the document says of it.
    """

    entry: dict[str, Any]
    vertices: Floats
    triangles: Ints
    targets: dict[str, Floats]
    joints: Ints | None = None
    weights: Floats | None = None


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
        self._joints: dict[int, Floats] = {}
        listed = [_bytes("byteLength", buffer["byteLength"]) for buffer in self._json.get("buffers", ())]
        FILE_BYTES.check("its buffers have", sum(listed))

    def mesh(self) -> tuple[Floats, Ints, dict[str, Floats]]:
        """Return all instances of meshes in the scene, one after another."""
        vertices: list[Floats] = []
        triangles: list[Ints] = []
        morphs: list[dict[str, Floats]] = []
        first = 0
        for primitive, corners, linear, shift in self._instances():
            vertices.append(np.einsum("nij,nj->ni", linear, primitive.vertices) + shift)
            triangles.append(corners + first)
            morphs.append({k: np.einsum("nij,nj->ni", linear, deltas) for k, deltas in primitive.targets.items()})
            first += len(primitive.vertices)
        if not vertices:
            raise InputError("no triangles found; is there a mesh in its scene?")
        counts = [len(x) for x in vertices]
        all_names = dict.fromkeys(name for targets in morphs for name in targets)
        MORPH_TARGETS.check("its scene has", len(all_names))
        MORPH_VALUES.check("its scene has", 3 * first * len(all_names))
        joined = {
            name: np.vstack([t.get(name, np.zeros((k, 3))) for t, k in zip(morphs, counts, strict=True)])
            for name in all_names
        }
        return np.vstack(vertices), np.vstack(triangles), joined

    def _instances(self) -> Iterator[tuple[_Primitive, Ints, Floats, Floats]]:
        """Give each primitive in the scene, its triangles as they are placed, and its map (1 or n, 3, 3) and shift."""
        read: dict[int, list[_Primitive]] = {}
        for node, matrix in self._place_meshes():
            if node["mesh"] not in read:
                read[node["mesh"]] = self._primitives(self._item("meshes", node["mesh"]))
            for primitive in read[node["mesh"]]:
                linear, shift = self._transforms(primitive, node, matrix)
                grown = np.linalg.det(linear)
                if np.abs(grown).max() <= FLAT * np.abs(linear).max() ** 3:
                    raise InputError("a node's transform flattens its mesh")
                # A mirrored mesh would be inside out.
                corners = primitive.triangles[:, ::-1] if np.median(grown) < 0.0 else primitive.triangles
                yield primitive, corners, linear, shift

    def picture(self) -> tuple[bytes, Floats] | None:
        """Return the bytes of the picture that most triangles have, and all their corners' places, shape (m, 3, 2)."""
        if not self._json.get("images"):
            return None
        instances = [(self._image(primitive.entry), primitive, corners) for primitive, corners, *_ in self._instances()]
        counts: Counter[int] = Counter()
        for image, _, corners in instances:
            if image is not None:
                counts[image] += len(corners)
        if not counts:
            return None
        chosen = max(counts, key=lambda image: counts[image])
        places = [
            self._places(primitive)[corners] if image == chosen else np.full((*corners.shape, 2), np.nan)
            for image, primitive, corners in instances
        ]
        entry = self._item("images", chosen)
        content = self._view(entry["bufferView"]) if "bufferView" in entry else self._resource(entry["uri"])
        return bytes(content), np.vstack(places)

    def _image(self, primitive: dict) -> int | None:
        """Return the number of the image that colours a primitive, if one does by its first texture coordinates."""
        if "material" not in primitive or "TEXCOORD_0" not in primitive["attributes"]:
            return None
        look = self._item("materials", primitive["material"]).get("pbrMetallicRoughness", {})
        texture = look.get("baseColorTexture", {"texCoord": 1})
        if texture.get("texCoord", 0) != 0:
            return None
        return self._item("textures", texture["index"]).get("source")

    def _places(self, primitive: _Primitive) -> Floats:
        """Return where in its picture the vertices of a primitive lie, shape (n, 2)."""
        packed = primitive.entry.get("extensions", {}).get("KHR_draco_mesh_compression")
        if packed is not None:
            content = bytes(self._view(packed["bufferView"]))
            places = decode_draco(content, packed["attributes"]["TEXCOORD_0"], width=2)[0]
        else:
            places = self._accessor(primitive.entry["attributes"]["TEXCOORD_0"], "VEC2")
        shape("TEXCOORD_0", places, (len(primitive.vertices), 2))
        return places

    def _check_sizes(self, meshes: Sequence[dict]) -> None:
        """Check the sums over all instances by the counts that accessors state, before any is read."""
        GLTF_PRIMITIVES.check("its scene has", sum(len(mesh["primitives"]) for mesh in meshes))
        vertices = triangles = values = 0
        for primitive in (each for mesh in meshes for each in mesh["primitives"] if _is_surface(each)):
            count = self._count(primitive["attributes"]["POSITION"])
            vertices += count
            corners = self._count(primitive["indices"]) if "indices" in primitive else count
            triangles += corners // 3 if primitive.get("mode", 4) == 4 else corners
            values += 3 * count * MORPH_TARGETS.check("a mesh has", len(primitive.get("targets", ())))
        VERTICES.check("its scene has", vertices)
        TRIANGLES.check("its scene has", triangles)
        MORPH_VALUES.check("its scene has", values)

    def _count(self, number: int) -> int:
        accessor = self._item("accessors", number)
        # Zeros, where no view is named, take no place in the file.
        return (CORNERS if accessor["type"] == "SCALAR" else VERTICES).check(f"accessor {number}", accessor["count"])

    def _item(self, kind: str, number: Any) -> Any:
        """Return an object by its number in one of the document's lists."""
        listed = self._json[kind]
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(listed):
            raise InputError(f"{kind}: {quote(number)} is none of its {len(listed)}")
        return listed[number]

    def _place_meshes(self) -> list[tuple[dict, Floats]]:
        """Return nodes that have a mesh, with their global transform (4, 4)."""
        nodes = self._json.get("nodes", [])
        GLTF_NODES.check("it has", len(nodes))
        parents: dict[int, int | None] = {}
        scenes = self._json.get("scenes")
        children = {child for node in nodes for child in node.get("children", ())}
        roots = [k for k in range(len(nodes)) if k not in children]
        shown_nodes = self._item("scenes", self._json.get("scene", 0)).get("nodes", []) if scenes else roots

        def walk(k: int, parent: int | None, depth: int) -> None:
            GLTF_DEPTH.check("it has", depth)
            node = self._item("nodes", k)
            if k in parents:
                raise InputError(f"its nodes are no tree: node {k} is reached twice")
            parents[k] = parent
            for child in node.get("children", ()):
                walk(child, k, depth + 1)

        for root in shown_nodes:
            walk(root, None, 0)
        if not any("mesh" in nodes[k] for k in parents):
            for root in roots:
                if root not in parents:
                    walk(root, None, 0)
        self._check_sizes([self._item("meshes", nodes[k]["mesh"]) for k in parents if "mesh" in nodes[k]])
        self._global: dict[int, Floats] = {}
        for k, parent in parents.items():
            local = _local(nodes[k])
            self._global[k] = local if parent is None else self._global[parent] @ local
        # A scale of zeros hides a node.
        shown = [k for k in parents if "skin" in nodes[k] or self._global[k][:3, :3].any()]
        return [(nodes[k], self._global[k]) for k in shown if "mesh" in nodes[k]]

    def _transforms(self, primitive: _Primitive, node: dict, matrix: Floats) -> tuple[Floats, Floats]:
        """Return the linear map (1, 3, 3) and shift (1, 3) of a node, or those of a skin for each vertex (n, ...)."""
        if "skin" not in node or primitive.joints is None or primitive.weights is None:
            transforms = matrix[None, :3]
        else:
            joints = self._joints_of_skin(node["skin"])
            which = indices_below("JOINTS_0", primitive.joints, len(joints))
            transforms = np.zeros((len(which), 3, 4))
            for k in range(4):
                transforms += primitive.weights[:, k, None, None] * joints[which[:, k], :3]
        finite("a node's transform", transforms)
        return transforms[:, :, :3], transforms[:, :, 3]

    def _joints_of_skin(self, number: int) -> Floats:
        """Return what a skin's joints do to its vertices, (joints, 4, 4)."""
        skin = self._item("skins", number)
        if number not in self._joints:
            listed = skin["joints"]
            for joint in listed:
                self._item("nodes", joint)
            joints = np.array([self._global.get(j, np.eye(4)) for j in listed])
            if "inverseBindMatrices" in skin:
                bound = self._accessor(skin["inverseBindMatrices"], "MAT4")
                shape("inverseBindMatrices", bound, (len(listed), 16))
                joints = joints @ _affine("inverseBindMatrices", bound)
            self._joints[number] = joints
        return self._joints[number]

    def _primitives(self, mesh: dict) -> list[_Primitive]:
        """Return what a mesh has of triangles; points and lines are left out."""
        extras = mesh.get("extras")
        names = texts("targetNames", extras.get("targetNames", [])) if isinstance(extras, dict) else ()
        return [self._primitive(each, names) for each in mesh["primitives"] if _is_surface(each)]

    def _primitive(self, primitive: dict, names: Sequence[str]) -> _Primitive:
        attributes = primitive["attributes"]
        packed = primitive.get("extensions", {}).get("KHR_draco_mesh_compression")
        if packed is not None:
            x, triangles = decode_draco(bytes(self._view(packed["bufferView"])), packed["attributes"]["POSITION"])
            shape("Draco's vertices", x, (self._count(attributes["POSITION"]), 3))
            shape("Draco's corners", triangles.ravel(), (self._count(primitive["indices"]),))
            self._check_extent(attributes["POSITION"], x)
        else:
            x = self._accessor(attributes["POSITION"], "VEC3", stored=True)
            ids = np.arange(len(x))
            if "indices" in primitive:
                ids = self._accessor(primitive["indices"], "SCALAR", integer=True, stored=True)[:, 0].astype(np.int64)
            triangles = _triangles(ids, primitive.get("mode", 4))
        triangles = indices_below("triangles", triangles, len(x), (None, 3))
        targets: dict[str, Floats] = {}
        for k, target in enumerate(primitive.get("targets", ())):
            name = escape(names[k])[:200] if k < len(names) else f"target {k}"
            if name in targets:
                raise InputError(f"morph target {quote(name)!r} stands there twice")
            if "POSITION" in target:
                targets[name] = self._accessor(target["POSITION"], "VEC3")
                shape(f"morph target {name!r}", targets[name], (len(x), 3))
        if "JOINTS_0" not in attributes:
            return _Primitive(primitive, x, triangles, targets)
        joints = self._accessor(attributes["JOINTS_0"], "VEC4", integer=True).astype(np.int64)
        shape("JOINTS_0", joints, (len(x), 4))
        weights = in_range("WEIGHTS_0", self._accessor(attributes["WEIGHTS_0"], "VEC4"), 0.0, 1e3, (len(x), 4))
        total = weights.sum(axis=1, keepdims=True)
        if not total.all():
            raise InputError(f"WEIGHTS_0: vertex {np.argmin(total)} hangs on no joint")
        return _Primitive(primitive, x, triangles, targets, joints, weights / total)

    def _check_extent(self, number: int, x: Floats) -> None:
        """Check that vertices (n, 3) which were decoded lie where their accessor states."""
        accessor = self._item("accessors", number)
        if "min" in accessor and "max" in accessor and len(x):
            least, most = (finite(name, accessor[name], (3,)) for name in ("min", "max"))
            off = max(np.abs(x.min(axis=0) - least).max(), np.abs(x.max(axis=0) - most).max())
            if off > QUANTISED * np.ptp(x, axis=0).max():
                raise InputError(f"Draco's vertices lie {off:.3g} off the extent that the file states")

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
            values = np.zeros((count, width))
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


def _is_surface(primitive: dict) -> bool:
    return primitive.get("mode", 4) in (4, 5, 6) and "POSITION" in primitive["attributes"]


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


def _triangles(ids: Ints, mode: int) -> Ints:
    """Return triangles of a list (mode 4), a strip (5) or a fan (6)."""
    if mode == 4:
        if len(ids) % 3:
            raise InputError(f"triangles: {len(ids):,} corners, no multiple of 3")
        return ids.reshape(-1, 3)
    if len(ids) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    if mode == 6:
        return np.stack([np.full(len(ids) - 2, ids[0]), ids[1:-1], ids[2:]], axis=1)
    triangles = np.stack([ids[:-2], ids[1:-1], ids[2:]], axis=1)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


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


def decode_draco(content: bytes, number: int, *, width: int = 3) -> tuple[Floats, Ints]:
    """Return an attribute of vertices (n, width) and triangles (m, 3) of a Draco buffer; `number`: its unique id.

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
            if attribute.get("unique_id") == number and np.shape(attribute.get("data"))[1:] == (width,):
                points = np.asarray(attribute["data"], dtype=np.float64)
        return points, np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # the C++ library raises whatever the damage makes it raise
        raise InputError(f"its Draco data are damaged ({str(error)[:60]})") from None
