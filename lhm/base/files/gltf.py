"""glTF 2.0 and GLB: the meshes of a scene as one, in the scene's axes, with their morph targets; Draco."""

from __future__ import annotations

import base64
import binascii
import struct
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np

from ..checks import finite, indices_below, number, rotations_from_quaternions, shape, texts
from ..errors import InputError, MissingDependencyError, escape, quote
from ..limits import FILE_BYTES, MORPH_VALUES, VERTICES
from ..mesh import Floats, Ints
from .painted import CLAMP, MIRROR, REPEAT, Painted
from .text import find_beside, parse_json, read_bytes, read_json

_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
FLOAT = 5126
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "MAT4": 16}
_KNOWN = {"KHR_draco_mesh_compression", "KHR_mesh_quantization"}
_MESHOPT = {"EXT_meshopt_compression", "KHR_meshopt_compression"}
LARGEST = 1e12
"""Largest number in a transform."""
FLAT = 1e-9
"""Least determinant over the cube of a transform's largest number: below it no volume is left."""
SAME_POSE = 1e-4
"""Share of a joint's largest number within which joints move a mesh alike."""
STRIPS = (5, 6)
"""Modes of primitives that are strips and fans of triangles."""
WRAPS = {10497: REPEAT, 33071: CLAMP, 33648: MIRROR}
"""How a picture goes on beyond its edges, by the number of a sampler."""
ENDED = "the file is shorter than it says: is its end missing?"


Read = tuple[Floats, Ints, dict[str, Floats], dict[str, Floats], tuple[str, ...]]


def read_gltf(path: Path) -> Read:
    """Read a scene's meshes as a `Scan` has them, in the scene's axes.

    Nodes' transforms and default weights of morph targets are applied, and a skeleton's where all its joints move
    alike. Other poses of it, strips, fans, materials and textures are left out. InputError says what is damaged, or
    which extension is not known.
    """
    with _naming_damage():
        return _Document(path).mesh()


def read_gltf_pictures(path: Path) -> list[Painted]:
    """Read which triangles of `read_gltf` have a picture as base colour, and where in it they lie; InputError alike."""
    with _naming_damage():
        return list(_Document(path).find_pictures())


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
    except (IndexError, TypeError, ValueError, AttributeError, struct.error, OverflowError, RecursionError) as error:
        raise InputError(f"not a sound glTF file ({type(error).__name__}: {escape(str(error))[:60]})") from None


class _Part(NamedTuple):
    """Triangles (m, 3) over vertices (n, 3), with named morph targets (n, 3); `entry` is the document's primitive."""

    entry: dict[str, Any]
    vertices: Floats
    triangles: Ints
    targets: dict[str, Floats]


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
        self._notes: list[str] = []
        listed = [_bytes("byteLength", buffer["byteLength"]) for buffer in self._json.get("buffers", ())]
        FILE_BYTES.check("its buffers have", sum(listed))

    def mesh(self) -> Read:
        """Return all instances of meshes in the scene, one after another."""
        vertices: list[Floats] = []
        triangles: list[Ints] = []
        morphs: list[dict[str, Floats]] = []
        shown: list[dict[str, Floats]] = []
        first = 0
        for part, weights, linear, shift in self._instances():
            x = np.einsum("ij,nj->ni", linear, part.vertices) + shift
            targets = {name: np.einsum("ij,nj->ni", linear, deltas) for name, deltas in part.targets.items()}
            added = {name: weights[name] * targets[name] for name in targets if weights.get(name)}
            vertices.append(x + sum(added.values()))
            triangles.append(first + part.triangles)
            morphs.append(targets)
            shown.append(added)
            first = VERTICES.check("its scene has", first + len(x))
        if not vertices:
            raise InputError("no triangles found; is there a mesh in its scene?")
        counts = [len(x) for x in vertices]
        MORPH_VALUES.check("its scene has", 3 * first * len({name for targets in morphs for name in targets}))

        def join(parts: list[dict[str, Floats]]) -> dict[str, Floats]:
            return {
                name: np.vstack([part.get(name, np.zeros((k, 3))) for part, k in zip(parts, counts, strict=True)])
                for name in dict.fromkeys(name for part in parts for name in part)
            }

        notes = tuple(dict.fromkeys(self._notes))
        return np.vstack(vertices), np.vstack(triangles), join(morphs), join(shown), notes

    def find_pictures(self) -> Iterator[Painted]:
        """Yield which triangles have a picture, each instance of a mesh by itself; none where places are missing."""
        first = 0
        for part, *_ in self._instances():
            found = self._picture(part)
            if found is not None:
                name, read, places, wraps, factor = found
                corners = part.triangles[np.isfinite(places[part.triangles]).all(axis=(1, 2))]
                yield Painted(name, read, first + corners, places[corners], wraps, factor)
            first += len(part.vertices)

    def _instances(self) -> Iterator[tuple[_Part, dict[str, float], Floats, Floats]]:
        """Yield each part of a mesh in the scene, its targets' default weights, and its linear map and shift.

        Triangles of a mesh that the map mirrors, which would be inside out, are turned round.
        """
        read: dict[int, list[_Part]] = {}
        for node, matrix in self._place_meshes():
            mesh = self._item("meshes", node["mesh"])
            if node["mesh"] not in read:
                read[node["mesh"]] = list(self._parts(mesh))
            linear, shift = matrix[:3, :3], finite("a node's transform", matrix[:3, 3])
            grown = np.linalg.det(finite("a node's transform", linear))
            if np.abs(grown) <= FLAT * np.abs(linear).max() ** 3:
                raise InputError("a node's transform flattens its mesh")
            weights = finite("weights", node.get("weights", mesh.get("weights", [])), (None,), most=LARGEST)
            for part in read[node["mesh"]]:
                if grown < 0.0:
                    part = part._replace(triangles=part.triangles[:, ::-1])
                yield part, dict(zip(part.targets, weights.tolist(), strict=False)), linear, shift

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
        there = {k: self._find_pose(nodes[k], placed, placed[k]) for k in parents if "mesh" in nodes[k]}
        # A scale of zeros hides a node.
        return [(nodes[k], matrix) for k, matrix in there.items() if matrix[:3, :3].any()]

    def _find_pose(self, node: dict, placed: dict[int, Floats], matrix: Floats) -> Floats:
        """Return the transform of a node's mesh: its own, or with a skin that of the first joint; others are noted."""
        if "skin" not in node:
            return matrix
        skin = self._item("skins", node["skin"])
        joints = np.array([placed.get(joint, np.eye(4)) for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            bound = self._accessor(skin["inverseBindMatrices"], "MAT4")
            shape("inverseBindMatrices", bound, (len(joints), 16))
            joints = joints @ _affine("inverseBindMatrices", bound)
        if np.abs(joints - joints[0]).max() > SAME_POSE * np.abs(joints[0]).max():
            self._notes.append("its skeleton poses it, which is left out; apply the pose and export it again")
        return joints[0]

    def _parts(self, mesh: dict) -> Iterator[_Part]:
        """Yield what a mesh has of triangles; only lists of them are read."""
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", 4)
            if mode in STRIPS:
                self._notes.append("strips and fans of triangles are left out; export lists of triangles")
            if mode != 4 or "POSITION" not in primitive["attributes"]:
                continue
            x, triangles = self._triangles(primitive)
            listed = primitive.get("targets", ())
            MORPH_VALUES.check("a mesh has", x.size * len(listed))
            targets: dict[str, Floats] = {}
            for name, target in zip(self._target_names(mesh, primitive), listed, strict=True):
                if name in targets:
                    raise InputError(f"morph target {quote(name)!r} stands there twice")
                targets[name] = self._accessor(target["POSITION"], "VEC3") if "POSITION" in target else np.zeros_like(x)
                shape(f"morph target {name!r}", targets[name], x.shape)
            yield _Part(primitive, x, triangles, targets)

    def _target_names(self, mesh: dict, primitive: dict) -> list[str]:
        """Return the names of a primitive's targets: the mesh's, the primitive's own, or their accessors'."""
        count = len(primitive.get("targets", ()))
        listed: Sequence[str] = ()
        for extras in (mesh.get("extras"), primitive.get("extras")):
            if not listed and isinstance(extras, dict):
                listed = texts("targetNames", extras.get("targetNames", []))
        if not listed:
            used = [target["POSITION"] for target in primitive.get("targets", ()) if "POSITION" in target]
            named = [self._item("accessors", accessor).get("name") for accessor in used]
            is_told = len(named) == count == len(set(named)) and all(isinstance(name, str) for name in named)
            listed = named if is_told else ()
        return [escape(listed[k])[:200] if k < len(listed) else f"target {k}" for k in range(count)]

    def _picture(self, part: _Part) -> tuple[Hashable, Callable[[], bytes], Floats, tuple[str, str], tuple] | None:
        """Return a part's picture: its name, its bytes' reader, places (n, 2) right and up, wraps and factor."""
        if "material" not in part.entry:
            return None
        material = self._item("materials", part.entry["material"])
        older = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
        look = material.get("pbrMetallicRoughness", {})
        used = look.get("baseColorTexture", older.get("diffuseTexture"))
        if used is None:
            return None
        moved = used.get("extensions", {}).get("KHR_texture_transform", {})
        attribute = f"TEXCOORD_{moved.get('texCoord', used.get('texCoord', 0))}"
        is_placed = attribute in part.entry["attributes"]
        places = self._texture_places(part, attribute) if is_placed else np.full((len(part.vertices), 2), np.nan)
        turn = number("rotation", moved.get("rotation", 0.0))
        c, s = np.cos(turn), np.sin(turn)
        scale, offset = finite("scale", moved.get("scale", [1, 1]), (2,)), finite("offset", moved.get("offset", [0, 0]))
        places = (places * scale) @ np.array([[c, -s], [s, c]]) + offset
        texture = self._item("textures", used["index"])
        sampler = self._item("samplers", texture["sampler"]) if "sampler" in texture else {}
        wraps = tuple(WRAPS.get(sampler.get(f"wrap{axis}", 10497), REPEAT) for axis in "ST")
        usual = [1.0, 1.0, 1.0, 1.0]
        factor = look.get("baseColorFactor", usual) if "baseColorTexture" in look else older.get("diffuseFactor", usual)
        tint = tuple(finite("baseColorFactor", factor, (4,))[:3].tolist())
        image = texture.get("extensions", {}).get("EXT_texture_webp", texture).get("source")
        places = np.column_stack([places[:, 0], 1.0 - places[:, 1]])
        if image is not None:
            self._item("images", image)
        return image, lambda: self._image(image), places, (wraps[0], wraps[1]), tint

    def _image(self, image: int | None) -> bytes:
        if image is None:
            raise InputError("its texture is of Basis Universal, which is not read; export it as PNG or JPEG")
        with _naming_damage():
            entry = self._item("images", image)
            return bytes(self._view(entry["bufferView"]) if "bufferView" in entry else self._resource(entry["uri"]))

    def _texture_places(self, part: _Part, attribute: str) -> Floats:
        """Return texture coordinates (n, 2) of a part's vertices, right and down."""
        packed = part.entry.get("extensions", {}).get("KHR_draco_mesh_compression")
        if packed is not None and attribute in packed["attributes"]:
            places = decode_draco(bytes(self._view(packed["bufferView"])), packed["attributes"][attribute], width=2)[0]
        else:
            places = self._accessor(part.entry["attributes"][attribute], "VEC2")
        shape(attribute, places, (len(part.vertices), 2))
        return places

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
        if stored and not {"bufferView", "sparse"} & accessor.keys():
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


def decode_draco(content: bytes, attribute_id: int, *, width: int = 3) -> tuple[Floats, Ints]:
    """Return an attribute of vertices (n, width) and triangles (m, 3) of a Draco buffer, by the attribute's unique id.

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
            if attribute.get("unique_id") == attribute_id and np.shape(attribute.get("data"))[1:] == (width,):
                points = np.asarray(attribute["data"], dtype=np.float64)
        return points, np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    except Exception as error:  # the C++ library raises whatever the damage makes it raise
        raise InputError(f"its Draco data are damaged ({str(error)[:60]})") from None
