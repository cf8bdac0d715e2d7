"""Damaged files of every format that `lhm` reads: bytes cut, flipped and moved; fields swapped; numbers made extreme.

    python tests/robustness/file_mutants.py [mutants of each format [seed [format ...]]]

A mutant is refused by a SoftdecaError of one line, or read as something finite and in range. Anything else is a defect:
another exception, a crash, more than `SECONDS` of work, or more than `MEMORY` bytes. The mutants of a seed are always
the same. The process limits its own memory, so that it is run as a child of a test (`test_bad_inputs.py`), and says
on stdout which mutant it is at, so that the one that ends it is known.
"""

from __future__ import annotations

import io
import json
import pickle
import re
import resource
import signal
import struct
import sys
import tempfile
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mesh_bytes import big_endian_ply, exported, glb, glb_words, obj, stl, strips_ply
from scipy.sparse import csc_matrix, identity

from softdeca.lhm import LayeredHead, SoftdecaError, Surface, Template, head_file, identities, template_file
from softdeca.lhm.anatomy import bodyparts
from softdeca.lhm.arkit import ARKIT
from softdeca.lhm.base.files import moving_surface, surface_file, tet_file
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.head_file import tets_from_head
from softdeca.lhm.registration import read_landmarks
from softdeca.lhm.regressor.depths import DepthPairs, DepthRegressor
from softdeca.lhm.rig import Rig
from softdeca.lhm.scans import read_guesses

SECONDS, PATIENCE = 5, 60
"""Of work that a mutant may take, and of time: on a busy machine a second of work takes many."""
MEMORY = 1_500_000_000
"""Bytes that reading may add to the process' address space: the files have 100 kB."""
LARGE = 1e7
"""[mm] Of a number of an accepted head, template, tet mesh or space."""

NUMBERS = (b"nan", b"-inf", b"-1", b"0", b"1e400", b"1e30", b"-1e6", b"9" * 40, b"9" * 400, b"2147483648", b"-9", b"")
VALUES = (-1, 0, 1, 2, 3, 255, 65536, 2**31, 2**40, 2**62, 10**17, -(2**31), 0.5, 1e9, 1e30, 1e308, True, None, "", "x")
VALUES += ([], {}, [1, 2, 3], [0] * 16, {"a": 1}, "\x1b[31m", "../../../../dev/zero", "data:,AAAA")
FLOATS = (np.nan, np.inf, -np.inf, 1e30, -1e300, 1e-300, 1e6, -1.0, 0.0, 1e3)
INTEGERS = (-1, -(2**31), 2**31 - 1, 2**62, 10**6, 0)
KINDS = ("c16", "?", "U3", "S2", "f4", "f8", "i1", "u8", "i8", "f2", ">f8", ">i4", "O")


@dataclass(frozen=True)
class Format:
    """A whole file by its name, what reads it to arrays and numbers, and how it can be damaged beside bytes."""

    name: str
    content: bytes
    read: Callable[[Path], list[np.ndarray]]
    mutate: Callable[[bytes, np.random.Generator], bytes] | None = None
    others: tuple[str, ...] = ()
    """Names, one of which an error may have in place of the file's."""


def flipped(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four damages of bytes."""
    data = bytearray(content)
    for _ in range(rng.integers(1, 5)):
        # Half of them at the beginning, where headers are.
        at = int(rng.integers(0, max(1, min(len(data), 400) if rng.random() < 0.5 else len(data))))
        size = int(rng.integers(1, 9))
        how = rng.integers(0, 7)
        if how == 0:
            del data[at:]
        elif how == 1:
            data[at : at + 1] = bytes([(data[at] if at < len(data) else 0) ^ (1 << int(rng.integers(0, 8)))])
        elif how == 2:
            data[at : at + size] = rng.bytes(size)
        elif how == 3:
            del data[at : at + int(rng.integers(1, 200))]
        elif how == 4:
            data[at : at + size] = bytes(size) if rng.random() < 0.5 else b"\xff" * size
        elif how == 5:
            other = int(rng.integers(0, max(1, len(data))))
            data[at:at] = data[other : other + int(rng.integers(1, 300))]
        else:
            data[at : at + 4] = struct.pack("<I", int(rng.choice([2**31, 2**32 - 1, 10**6, 10**9])))
    return bytes(data)


def renumbered(content: bytes, rng: np.random.Generator) -> bytes:
    """A text with some of its numbers made extreme, or two of its words swapped."""
    words = list(re.finditer(rb"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?", content))
    if not words:
        return flipped(content, rng)
    # Half of them among the first, where counts are.
    pool = words[:12] if rng.random() < 0.5 else words
    chosen = sorted(rng.choice(len(pool), size=min(len(pool), int(rng.integers(1, 4))), replace=False), reverse=True)
    for k in chosen:
        a, b = pool[k].span()
        content = content[:a] + NUMBERS[rng.integers(len(NUMBERS))] + content[b:]
    if rng.random() < 0.2:
        lines = content.splitlines(keepends=True)
        i, j = rng.integers(0, len(lines), 2)
        lines[i], lines[j] = lines[j], lines[i]
        content = b"".join(lines)
    return b"\xef\xbb\xbf" + content if rng.random() < 0.05 else content


def changed(tree: object, rng: np.random.Generator) -> object:
    """A tree of JSON with one to three of its values replaced, removed, doubled or nested."""
    tree = json.loads(json.dumps(tree))
    for _ in range(rng.integers(1, 4)):
        places: list[tuple] = []

        def walk(node, places=places) -> None:
            for key in list(node) if isinstance(node, dict) else range(len(node)):
                places.append((node, key))
                if isinstance(node[key], (dict, list)):
                    walk(node[key])

        walk(tree)
        if not places:
            break
        node, key = places[rng.integers(len(places))]
        how = rng.random()
        if how < 0.7:
            node[key] = json.loads(json.dumps(VALUES[rng.integers(len(VALUES))]))
        elif how < 0.8:
            del node[key]
        elif how < 0.9:
            other, name = places[rng.integers(len(places))]
            node[key] = json.loads(json.dumps(other[name]))
        elif isinstance(node[key], list):
            node[key] = node[key] * int(rng.choice([0, 2, 40]))
        else:
            node[key] = [node[key]]
    return tree


def of_json(content: bytes, rng: np.random.Generator) -> bytes:
    if rng.random() < 0.1:
        return b"[" * int(rng.choice([10, 100, 100_000])) + content
    if rng.random() < 0.4:
        return renumbered(content, rng)
    return json.dumps(changed(json.loads(content), rng)).encode()


def of_glb(content: bytes, rng: np.random.Generator) -> bytes:
    words, chunk = glb_words(content)
    return glb(changed(words, rng), flipped(chunk, rng) if rng.random() < 0.2 else chunk)


def one_array_changed(arrays: dict[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Arrays of which one or two are of another kind, shape or place, or have extreme values."""
    arrays = dict(arrays)
    for _ in range(rng.integers(1, 3)):
        name = list(arrays)[rng.integers(len(arrays))]
        array = np.array(arrays[name])
        how = rng.integers(0, 9)
        with np.errstate(all="ignore"):
            if how <= 2 and array.size and array.dtype.kind in "fiu":
                flat = array.reshape(-1).copy()
                some = rng.integers(0, flat.size, int(rng.choice([1, 1, 3, flat.size])))
                flat[some] = np.array(rng.choice(FLOATS if array.dtype.kind == "f" else INTEGERS)).astype(array.dtype)
                array = flat.reshape(array.shape)
            elif how == 3 and array.dtype.kind in "fiu":
                array = array * array.dtype.type(rng.choice([0, 1000, 1e6 if array.dtype.itemsize > 2 else 100]))
            elif how == 4 and array.dtype.kind in "fiub?":
                try:
                    array = array.astype(KINDS[rng.integers(len(KINDS))])
                except (TypeError, ValueError, OverflowError):
                    continue
            elif how == 5:
                shapes = (array[None], array.ravel(), array.T, array[:0] if array.ndim else array, array[..., None])
                array = shapes[rng.integers(len(shapes))]
            elif how == 6 and array.ndim:
                array = array[:-1] if rng.random() < 0.5 else np.concatenate([array, array[-1:]])
            elif how == 7:
                other = list(arrays)[rng.integers(len(arrays))]
                arrays[other], array = array, arrays[other]
            elif how == 8 and array.ndim and len(array):
                array = array[rng.permutation(len(array))]
            elif array.dtype.kind == "U":
                array = np.array(
                    rng.choice(["", "{", "[1]", "{}", "\x1b[2J", "[" * 200, '["\\u001b"]', "null", "[NaN]"])
                )
        if rng.random() < 0.1:
            del arrays[name]
            if not arrays:
                return {name: array}
        else:
            arrays[name] = array
    return arrays


def of_npz(content: bytes, rng: np.random.Generator) -> bytes:
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    if rng.random() < 0.85:
        buffer = io.BytesIO()
        np.savez(buffer, **one_array_changed(arrays, rng))
        return buffer.getvalue()
    # Headers of arrays, with the archive's checksums right.
    with zipfile.ZipFile(io.BytesIO(content)) as old:
        members = {name: old.read(name) for name in old.namelist()}
    name = list(members)[rng.integers(len(members))]
    head, body = members[name][:128], members[name][128:]
    members[name] = renumbered(head, rng) + body if rng.random() < 0.7 else flipped(head, rng) + body
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as new:
        for each, data in members.items():
            new.writestr(each, data)
    return buffer.getvalue()


def of_pickle(content: bytes, rng: np.random.Generator) -> bytes:
    arrays = {name: np.asarray(value) for name, value in pickle.loads(content).items() if name != "J_regressor"}
    state = one_array_changed(arrays | {"J_regressor": pickle.loads(content)["J_regressor"].toarray()}, rng)
    return pickle.dumps(state, protocol=int(rng.choice([0, 2, 4])))


# Whole files, as small as they can be


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
    rig = Rig(deltas, "a test", ("cheekPuff",), {"jawForward": "no teeth"})
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


def ict() -> dict[str, np.ndarray]:
    x, triangles = sphere(6)
    centre = x[triangles].mean(axis=1)
    part = np.zeros(len(triangles), np.uint8)
    for k, place in enumerate(([0, -40, 90], [35, 30, 88], [-35, 30, 88]), start=1):
        part[np.linalg.norm(centre - place, axis=1) < 25] = k
    deltas = np.random.default_rng(0).normal(size=(4, *x.shape)) * 0.1
    return {
        "vertices": (x * [0.1, 0.2, 0.1]).astype(np.float32),
        "triangles": triangles.astype(np.int32),
        "triangle_part": part,
        "part_names": np.array(["face", "mouth_socket", "eye_socket_l", "eye_socket_r"]),
        "identity_deltas": deltas[:2].astype(np.float32),
        "expression_deltas": deltas[2:].astype(np.float32),
        "expression_arkit": np.array(["jawOpen", "eyeBlinkLeft"]),
    }


def flame() -> dict[str, np.ndarray]:
    x, triangles = sphere(5)
    x = x / 1000
    rng = np.random.default_rng(0)
    cut = x[triangles].mean(axis=1)[:, 1] < -0.08
    weights = np.zeros((len(x), 5))
    weights[:, 1] = 1.0
    return {
        "v_template": x,
        "f": triangles[~cut].astype(np.uint32),
        "shapedirs": 0.001 * rng.normal(size=(len(x), 3, 110)),
        "posedirs": np.zeros((len(x), 3, 36)),
        "weights": weights,
        "J_regressor": np.full((5, len(x)), 1 / len(x)),
    }


def anatomy() -> dict[str, np.ndarray]:
    corners = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9.0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3]])
    parts = [("skull", "frontal bone"), ("skull", "mandible"), ("teeth", "right upper central incisor")]
    parts += [("teeth", "left lower canine"), ("expression", "risorius"), ("jaw", "mylohyoid")]
    parts += [("other", "right eyeball"), ("other", "left eyeball")]
    shifts = [[0, 9 * k, 0] for k in range(6)] + [[-40, 30, 60], [40, 30, 60]]
    return {
        "vertices": np.vstack([corners + shift for shift in shifts]).astype(np.float32),
        "faces": np.vstack([faces + 4 * k for k in range(len(parts))]).astype(np.int32),
        "face_part": np.repeat(np.arange(len(parts)), 3).astype(np.uint8),
        "part_group": np.array([group for group, _ in parts]),
        "part_name": np.array([name for _, name in parts]),
    }


def regressor(wrap: Surface) -> DepthRegressor:
    rng = np.random.default_rng(0)
    wraps = wrap.vertices * (1 + 0.05 * rng.normal(size=(6, 1, 3)))
    names = tuple("abcdef")
    return DepthRegressor.fit(DepthPairs("test", names, wraps, rng.uniform(3, 9, (6, len(wrap.vertices)))), wrap)


def rigged_glb() -> bytes:
    """A sphere with a skin of one joint, a morph target, sparse and normalised accessors."""
    x, triangles = (a for a in sphere(2))
    n = len(x)
    parts = [
        x.astype("<f4").tobytes(), triangles.astype("<u2").tobytes(), np.eye(4, dtype="<f4").tobytes(),
        np.zeros((n, 4), "u1").tobytes(), np.tile([255, 0, 0, 0], (n, 1)).astype("u1").tobytes(),
        np.array([1, 2], "<u2").tobytes(), np.ones((2, 3), "<f4").tobytes(),
    ]  # fmt: skip
    parts = [part + bytes(-len(part) % 4) for part in parts]
    starts = np.cumsum([0, *map(len, parts[:-1])]).tolist()
    views = [{"buffer": 0, "byteOffset": s, "byteLength": len(p)} for s, p in zip(starts, parts, strict=True)]
    sparse = {"count": 2, "indices": {"bufferView": 5, "componentType": 5123}, "values": {"bufferView": 6}}
    words = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "buffers": [{"byteLength": sum(map(len, parts))}],
        "nodes": [
            {"children": [1, 2], "rotation": [0, 0, 0, 1]}, {"mesh": 0, "skin": 0, "scale": [1, 1, 1]},
            {"translation": [0, 1, 0]},
        ],
        "skins": [{"joints": [2], "inverseBindMatrices": 2}], "bufferViews": views,
        "meshes": [{"extras": {"targetNames": ["jawOpen"]}, "primitives": [{
            "attributes": {"POSITION": 0, "JOINTS_0": 3, "WEIGHTS_0": 4}, "indices": 1, "mode": 4,
            "targets": [{"POSITION": 5}],
        }]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": n, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": triangles.size, "type": "SCALAR"},
            {"bufferView": 2, "componentType": 5126, "count": 1, "type": "MAT4"},
            {"bufferView": 3, "componentType": 5121, "count": n, "type": "VEC4"},
            {"bufferView": 4, "componentType": 5121, "count": n, "type": "VEC4", "normalized": True},
            {"componentType": 5126, "count": n, "type": "VEC3", "sparse": sparse},
        ],
    }  # fmt: skip
    return glb(words, b"".join(parts))


def packed_glb() -> bytes:
    """Triangles packed by meshoptimizer, of `tests/unit/test_meshopt.py`, over a grid."""
    packed = bytes.fromhex(
        "e1fefefefefefefefefefefefefefefefefffffffffffffffffffffffffefefefeffff0f0af202f202f2025f045f025f020f"
        "026f046f025f020f026f046f025f020f02ff2b0a01f2050af1070af1070aff050a01f2050af1070af1070aff050a01f2050a"
        "f1070af1070a80171615fe0a292f050e007687566778a9866589689801690000"
    )
    x = np.stack([*np.divmod(np.arange(25), 5), np.arange(25) % 3], axis=1).astype("<f4").tobytes()
    extension = {"buffer": 0, "byteOffset": 300, "byteLength": len(packed), "byteStride": 4, "count": 102}
    extension |= {"mode": "TRIANGLES", "filter": "NONE"}
    words = {
        "asset": {"version": "2.0"}, "extensionsRequired": ["EXT_meshopt_compression"],
        "buffers": [{"byteLength": 300 + len(packed)}, {"byteLength": 408}], "nodes": [{"mesh": 0}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 300},
            {"buffer": 1, "byteLength": 408, "extensions": {"EXT_meshopt_compression": extension}},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 25, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5125, "count": 102, "type": "SCALAR"},
        ],
    }  # fmt: skip
    return glb(words, x + packed)


def draco_glb() -> bytes | None:
    """A sphere compressed by Draco; None without the package."""
    try:
        import DracoPy
    except ModuleNotFoundError:
        return None
    x, triangles = sphere(2)
    packed = DracoPy.encode(x.astype(np.float32), triangles.astype(np.uint32))
    extension = {"bufferView": 0, "attributes": {"POSITION": 0}}
    primitive = {"attributes": {"POSITION": 0}, "extensions": {"KHR_draco_mesh_compression": extension}}
    words = {
        "asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"], "nodes": [{"mesh": 0}],
        "buffers": [{"byteLength": len(packed)}], "bufferViews": [{"buffer": 0, "byteLength": len(packed)}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": [{"componentType": 5126, "count": len(x), "type": "VEC3"}],
    }  # fmt: skip
    return glb(words, packed)


# What is read, as arrays that have to be finite and in range


def of_surface(surface: Surface | None) -> list[np.ndarray]:
    if surface is None:
        return []
    assert not surface.triangles.size or 0 <= surface.triangles.min() <= surface.triangles.max() < len(surface.vertices)
    return [surface.vertices]


def read_head(path: Path) -> list[np.ndarray]:
    """The parts, the head of them, and what it does with an expression."""
    made, report = head_file.load_head(path), head_file.check_head_file(path)
    assert all(text.isprintable() for text in (*made.notes, *map(str, report.figures)))
    weights = np.zeros(52)
    weights[ARKIT.index("jawOpen")] = 1.0
    expression = made.skin.vertices if made.rig is None else made.expression(weights)
    moved = [expression, made.wrap_targets(expression), made.skin_after(expression, made.skin_wrap.vertices)]
    surfaces = (made.skin, made.skin_wrap, made.muscle_wrap, made.skull_wrap, made.muscles, made.skull, made.registered)
    return [*moved, *(array for each in surfaces for array in of_surface(each)), made.bone]


def read_template(path: Path) -> list[np.ndarray]:
    made = template_file.read_template(path)
    carried = [made.wrap_from_skin @ made.skin.vertices, made.skin_from_wrap @ made.skin_wrap.vertices]
    return [*carried, *of_surface(made.skin), *of_surface(made.skull), made.stack, made.room, made.parts, made.bone]


def read_scan(path: Path) -> list[np.ndarray]:
    scan = surface_file.read_scan(path)
    assert np.abs(scan.vertices).max() <= surface_file.FARTHEST
    assert 0 <= scan.triangles.min() and scan.triangles.max() < len(scan.vertices)
    assert all(delta.shape == scan.vertices.shape for delta in scan.morphs.values())
    return [x / surface_file.FARTHEST for x in (scan.vertices, *scan.morphs.values())]


def read_space(read: Callable[[Path], identities.LinearSpace]) -> Callable[[Path], list[np.ndarray]]:
    def arrays(path: Path) -> list[np.ndarray]:
        space = read(path)
        code, skin = space.sample(np.random.default_rng(0))
        return [code, *of_surface(skin), space.expressions, space.identity, space.parts]

    return arrays


def read_anatomy(path: Path) -> list[np.ndarray]:
    made = bodyparts.load(path)
    surfaces = (made.cranium, made.mandible, *made.muscles.values())
    return [made.eyes, made.bite, *(array for each in surfaces for array in of_surface(each))]


def read_tets(path: Path) -> list[np.ndarray]:
    tagged = tet_file.read_tets(path)
    assert len(tagged.tags) == len(tagged.mesh.tets)
    return [tagged.mesh.vertices, tagged.mesh.volumes, *tagged.surfaces.values()]


def read_points(path: Path) -> list[np.ndarray]:
    return [np.array(list(read_landmarks(path).values()), dtype=float) / surface_file.FARTHEST]


def formats(folder: Path) -> list[Format]:
    """Every format, by the name of its whole file."""
    sphere_head, sphere_template = head(), template()
    head_file.save_head(folder / "head.npz", sphere_head)
    template_file.save_template(folder / "template.npz", sphere_template)
    wrap = sphere_template.skin_wrap
    regressor(wrap).save(folder / "depths.npz")
    for name, arrays in (("ict", ict()), ("flame", flame()), ("anatomy", anatomy())):
        np.savez(folder / f"{name}.npz", **arrays)
    np.savez(folder / "skin.npz", vertices=wrap.vertices, triangles=wrap.triangles)
    tets = tets_from_head(sphere_head)
    for suffix in tet_file.FORMATS:
        tet_file.write_tets(folder / f"head{suffix}", tets)
    x = wrap.vertices
    motion = np.stack([0 * x, 0.1 * x, 0.2 * x]).astype(np.float32)
    moving_surface.write_gltf(folder / "take.glb", wrap, np.arange(3) / 30, motion)
    ball = sphere(2)
    (folder / "smile.obj").write_text(obj(*ball))
    pickled = pickle.dumps(flame() | {"J_regressor": csc_matrix(flame()["J_regressor"])}, protocol=2)
    landmarks = json.dumps({"nose tip": [0, 1.5, 90], "chin": [0, -50, 70]}).encode()
    guesses = json.dumps({"smile.obj": {"mouthSmileLeft": 1, "mouthSmileRight": 0.5}}).encode()

    def depths(path: Path) -> list[np.ndarray]:
        read = DepthRegressor.load(path, wrap)
        return [read.predict(wrap.vertices), read.reference]

    def weights(path: Path) -> list[np.ndarray]:
        return list(read_guesses(path).values())

    def parts(path: Path) -> list[np.ndarray]:
        return [identities.MeshFolder(path.parent).parts]

    read_ict, read_flame = read_space(identities.ICTFaceKit), read_space(identities.FLAME)
    (folder / "people").mkdir()
    np.savez(folder / "people" / "0.npz", vertices=wrap.vertices, triangles=wrap.triangles)
    whole = folder / "people" / "parts.npy"
    np.save(whole, np.zeros(len(x), int))
    numbers, written = json.dumps([0] * len(x)).encode(), lambda name: (folder / name).read_bytes()
    all_formats = [
        Format("head.npz", written("head.npz"), read_head, of_npz),
        Format("template.npz", written("template.npz"), read_template, of_npz),
        Format("depths.npz", written("depths.npz"), depths, of_npz),
        Format("ict.npz", written("ict.npz"), read_ict, of_npz),
        Format("flame.npz", written("flame.npz"), read_flame, of_npz),
        Format("flame.pkl", pickled, read_flame, of_pickle),
        Format("anatomy.npz", written("anatomy.npz"), read_anatomy, of_npz),
        Format("skin.npz", written("skin.npz"), read_scan, of_npz),
        Format("skin.obj", obj(*ball).encode(), read_scan, renumbered),
        Format("skin.ply", big_endian_ply(*ball), read_scan, lambda c, r: renumbered(c[:210], r) + c[210:]),
        Format("text.ply", exported("ply", *ball, encoding="ascii"), read_scan, renumbered),
        Format("strips.ply", strips_ply(*ball), read_scan, renumbered),
        Format("skin.stl", stl(*ball), read_scan),
        Format("text.stl", exported("stl_ascii", *ball), read_scan, renumbered),
        Format("take.glb", written("take.glb"), read_scan, of_glb),
        Format("rigged.glb", rigged_glb(), read_scan, of_glb),
        Format("packed.glb", packed_glb(), read_scan, of_glb),
        Format("head.msh", written("head.msh"), read_tets, renumbered),
        Format("head.vtu", written("head.vtu"), read_tets, renumbered),
        Format("head.xdmf", written("head.xdmf"), read_tets, renumbered),
        Format("head.mesh", written("head.mesh"), read_tets, renumbered),
        Format("landmarks.json", landmarks, read_points, of_json),
        Format("guesses.json", guesses, weights, of_json),
        Format("guesses.csv", b"scan,jawOpen,mouthSmileLeft\nsmile.obj,,1\n", weights, renumbered),
        Format("people/parts.npy", whole.read_bytes(), parts),
        Format("people/parts.json", numbers, parts, of_json),
    ]
    draco = draco_glb()
    return all_formats + ([] if draco is None else [Format("draco.glb", draco, read_scan, of_glb)])


class TooLong(BaseException):
    """A mutant had its time; not an Exception, so that nothing on its way catches it."""


def outcome(each: Format, path: Path) -> str:
    """ "refused" or "accepted"; anything else is a defect, in words."""
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    signal.alarm(PATIENCE)
    try:
        for array in each.read(path):
            if array.size and not np.abs(array).max() <= LARGE:  # NaN is neither
                return f"accepted with {np.abs(array).max()}"
        return "accepted"
    except SoftdecaError as error:
        said = str(error)
        named = any(name in said for name in (path.name, *each.others))
        good = "\n" not in said and said.isprintable() and named and len(said) < 600
        return "refused" if good else f"refused in other than one line that names the file: {said!r}"
    except BaseException as error:
        return f"{type(error).__name__}: {str(error)[:200]}"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.alarm(0)


def _too_long(*_: object) -> None:
    raise TooLong


def main(arguments: list[str], formats: Callable[[Path], list[Format]] = formats) -> int:
    """Read the mutants of formats; the number of defects, each told by format, seed and number of the mutant."""
    count, seed = (int(arguments[k]) if len(arguments) > k else default for k, default in enumerate((100, 0)))
    warnings.simplefilter("error", RuntimeWarning)  # which a command would print
    signal.signal(signal.SIGVTALRM, _too_long)
    signal.signal(signal.SIGALRM, _too_long)
    defects = refused = accepted = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        chosen = [each for each in formats(folder) if not arguments[2:] or each.name in arguments[2:]]
        for each in chosen:
            path = folder / each.name
            kept = path.exists()  # others are read with it
            path.write_bytes(each.content)
            each.read(path)  # what is whole is accepted; and what is slow once is compiled
            if not kept:
                path.unlink()
        size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, size + MEMORY))
        for each in chosen:
            path = folder / each.name
            kept = path.exists()
            for number in range(count):
                print(f"at {each.name} {seed} {number}", flush=True)
                rng = np.random.default_rng([seed, number])
                mutate = flipped if each.mutate is None or rng.random() < 0.3 else each.mutate
                path.write_bytes(mutate(each.content, rng))
                ended = outcome(each, path)
                refused, accepted = refused + (ended == "refused"), accepted + (ended == "accepted")
                if ended not in ("refused", "accepted"):
                    defects += 1
                    print(f"DEFECT {each.name} {seed} {number}: {ended}", flush=True)
            if kept:
                path.write_bytes(each.content)
            else:
                path.unlink()
    print(json.dumps({"mutants": count * len(chosen), "refused": refused, "accepted": accepted, "defects": defects}))
    return min(defects, 100)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
