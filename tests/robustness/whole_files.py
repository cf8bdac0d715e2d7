"""Whole files, as small as they can be: meshes as bytes where trimesh does not write them so, heads, and spaces."""

from __future__ import annotations

import json
import struct

import numpy as np
import trimesh
from scipy.sparse import identity

from softdeca.lhm import LayeredHead, Surface, Template
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.expressions.rig import Rig
from softdeca.lhm.identities.arkit import ARKIT
from softdeca.lhm.template.depths.depths import DepthPairs, DepthRegressor


def exported(kind: str, x: np.ndarray, triangles: np.ndarray, **more) -> bytes:
    """A file as trimesh writes it."""
    out = trimesh.Trimesh(x, triangles, process=False).export(file_type=kind, **more)
    return out.encode() if isinstance(out, str) else out


def obj(x: np.ndarray, triangles: np.ndarray) -> str:
    lines = [f"v {a:.9g} {b:.9g} {c:.9g}" for a, b, c in x]
    return "\n".join(lines + [f"f {a} {b} {c}" for a, b, c in np.asarray(triangles) + 1]) + "\n"


def grouped_obj(x: np.ndarray, triangles: np.ndarray, groups: int = 1, comment: str = "") -> str:
    """As modelling programs write it: comments, materials that take turns, corners with texture coordinates."""
    lines = [*(f"# {line}" for line in comment.splitlines()), "", "mtllib model.mtl"]
    lines += [*(f"v {a:.8g} {b:.8g} {c:.8g}" for a, b, c in x), "vt 0 0", "vt 1 0", "vt 0 1"]
    for number, part in enumerate(np.array_split(triangles, groups)):
        lines += [f"g part_{number}", f"usemtl M_{number % 3}", *(f"f {a}/1 {b}/2 {c}/3" for a, b, c in part + 1)]
    return "\n".join(lines) + "\n"


def stl(x: np.ndarray, triangles: np.ndarray, header: bytes = b"solid") -> bytes:
    """A binary STL, whose header may begin as a text's."""
    rows = np.zeros(len(triangles), dtype=[("n", "<f4", 3), ("x", "<f4", (3, 3)), ("a", "<u2")])
    rows["x"] = x[triangles]
    return header.ljust(80, b"\0") + struct.pack("<I", len(rows)) + rows.tobytes()


def ply_header(form: str, vertices: int, elements: str, more: str = "") -> bytes:
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    listed = f"element {elements} vertex_indices\n"
    return f"ply\nformat {form} 1.0\ncomment x\nelement vertex {vertices}\n{axes}{more}{listed}end_header\n".encode()


def big_endian_ply(x: np.ndarray, triangles: np.ndarray) -> bytes:
    rows = np.zeros(len(triangles), dtype=[("k", "u1"), ("v", ">i4", 3)])
    rows["k"], rows["v"] = 3, triangles
    header = ply_header("binary_big_endian", len(x), f"face {len(triangles)}\nproperty list uchar int")
    return header + x.astype(">f4").tobytes() + rows.tobytes()


def glb(words: dict, chunk: bytes) -> bytes:
    text = json.dumps(words).encode()
    text, chunk = text + b" " * (-len(text) % 4), chunk + bytes(-len(chunk) % 4)
    body = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(chunk)) + b"BIN\0" + chunk
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def glb_words(content: bytes) -> tuple[dict, bytes]:
    """The JSON of a GLB file, and the bytes of its binary chunk."""
    length = struct.unpack("<I", content[12:16])[0]
    return json.loads(content[20 : 20 + length]), content[28 + length :]


class Gltf:
    """The words of a glTF file of one mesh, and the bytes of its buffer, to which arrays are added."""

    COMPONENTS = {"u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}

    def __init__(self, **words):
        self.chunk = b""
        self.words = {"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}], "bufferViews": [], "accessors": [], **words}

    def view(self, content: bytes) -> int:
        """Add bytes; the number of their view."""
        views = self.words["bufferViews"]
        views.append({"buffer": 0, "byteOffset": len(self.chunk), "byteLength": len(content)})
        self.chunk += content + bytes(-len(content) % 4)
        self.words["buffers"] = [{"byteLength": len(self.chunk)}]
        return len(views) - 1

    def add(self, array: np.ndarray, **more) -> int:
        """Add an array of a row an element; the number of its accessor."""
        kind = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}[array.shape[1:]]
        accessor = {"bufferView": self.view(array.tobytes()), "count": len(array), "type": kind}
        return self.access(accessor | {"componentType": self.COMPONENTS[array.dtype.str[1:]]} | more)

    def access(self, accessor: dict) -> int:
        self.words["accessors"].append(accessor)
        return len(self.words["accessors"]) - 1

    def mesh(self, *primitives: dict, **more) -> None:
        self.words["meshes"] = [{"primitives": list(primitives), **more}]

    def glb(self) -> bytes:
        return glb(self.words, self.chunk)


def sphere(frequency: int = 3) -> tuple[np.ndarray, np.ndarray]:
    unit, triangles = geodesic_sphere(frequency)
    return 100.0 * unit, triangles


def head() -> LayeredHead:
    x, triangles = sphere()
    wraps = [Surface(k * x, triangles) for k in (1.0, 0.92, 0.85)]
    bone = np.where(x[:, 1] > 0.0, 1, np.where(x[:, 1] < -70, 2, 0))
    weights = identity(len(x), format="csr")
    deltas = np.zeros((52, len(x), 3))
    deltas[ARKIT.index("jawOpen"), :9] = 1.0
    rig = Rig(deltas, "a test", ("cheekPuff",))
    regions = {"lips": x[:, 2] > 80, "face": x[:, 2] > 0}
    return LayeredHead(
        wraps[0], *wraps, bone, weights, weights, regions, muscles=wraps[1], skull=wraps[2], rig=rig, notes=("a note",)
    )


def template() -> Template:
    whole = head()
    stack = np.vstack([wrap.vertices for wrap in (whole.skin_wrap, whole.muscle_wrap, whole.skull_wrap)])
    n = len(whole.bone)
    ties = (whole.wrap_from_skin, whole.skin_from_wrap)
    return Template(
        "test", whole.skin, np.zeros(n, int), whole.skin.triangles, stack, np.full(n, 9.0), whole.bone, *ties,
        whole.regions, skull=whole.skull, skull_bone=whole.bone,
    )  # fmt: skip


def regressor(wrap: Surface) -> DepthRegressor:
    rng = np.random.default_rng(0)
    wraps = wrap.vertices * (1 + 0.05 * rng.normal(size=(6, 1, 3)))
    names = tuple("abcdef")
    return DepthRegressor.fit(DepthPairs("test", names, wraps, rng.uniform(3, 9, (6, len(wrap.vertices)))), wrap)
