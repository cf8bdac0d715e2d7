"""Readers of OBJ, PLY, STL and glTF against trimesh's, packed buffers, skins, and the cache: what each refuses."""

import json
import struct

import numpy as np
import pytest
import trimesh

from softdeca.lhm import InputError, MeshError, Surface
from softdeca.lhm.base.files.cache import load_or_make
from softdeca.lhm.base.files.meshopt import decode_meshopt
from softdeca.lhm.base.files.ply import read_ply
from softdeca.lhm.base.files.surface_file import read_obj, read_scan, read_stl, read_surface
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.registration import read_landmarks
from softdeca.lhm.scans import read_guesses
from softdeca.lhm.skin import check_skin

UNIT, TRIANGLES = geodesic_sphere(4)
X = (100 * UNIT).astype(np.float32).astype(float)


def written(path, content):
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


OBJ = "".join(f"v {a} {b} {c}\n" for a, b, c in X) + "".join(f"f {a} {b} {c}\n" for a, b, c in TRIANGLES + 1)


def test_a_byte_order_mark_does_not_take_the_first_vertex(tmp_path):
    vertices, triangles = read_obj(written(tmp_path / "a.obj", b"\xef\xbb\xbf" + OBJ.encode()))
    np.testing.assert_array_equal(vertices, X)
    np.testing.assert_array_equal(triangles, TRIANGLES)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("f 1 2 -9999", "line .* is none of an OBJ file"),
        ("f 1 2 0", "line .* is none of an OBJ file"),
        (f"f 1 2 {'9' * 40}", "line .* is none of an OBJ file: 'f 1 2 9999"),
        (f"f 1 2 {'9' * 5000}", "line .* is none of an OBJ file"),
        ("f 1 2 9999", "outside 0..161"),
        ("v 1 2 nan", "1 rows are not finite"),
        (f"v 1 2 1{'0' * 400}", "1 rows are not finite"),
        ("v 1 2", "line .* is none of an OBJ file"),
        ("f 1 2 \x1b[2J", r"line .* is none of an OBJ file: .*x1b\[2J"),
    ],
)
def test_a_line_of_an_obj_that_is_wrong_is_named(tmp_path, line, message):
    with pytest.raises(InputError, match=message) as raised:
        read_obj(written(tmp_path / "a.obj", OBJ + line + "\n"))
    assert str(raised.value).isprintable() and len(str(raised.value)) < 250


QUADS = [(0, 1, 2, 3), (4, 5, 6), (7, 8, 9, 10, 11)]
FANS = [(0, 1, 2), (0, 2, 3), (4, 5, 6), (7, 8, 9), (7, 9, 10), (7, 10, 11)]


def ply(form, *, vertices=162, faces=3, body=None):
    """Vertices with a colour, elements with lists before and after the faces, polygons of three to five corners."""
    head = (
        f"ply\nformat {form} 1.0\ncomment a\nelement camera 2\nproperty list uchar float view\nproperty short n\n"
        f"element vertex {vertices}\nproperty uchar red\nproperty double z\nproperty float x\nproperty float y\n"
        f"element face {faces}\nproperty uchar flags\nproperty list int ushort vertex_index\n"
        "property list uchar float texcoord\nelement nothing 0\nproperty int n\nend_header\n"
    )
    if body is not None:
        return head.encode() + body
    if form == "ascii":
        lines = ["2 0.5 0.5 7", "0 -1"] + [f"9 {z:.9g} {x:.9g} {y:.9g}" for x, y, z in X]
        lines += [f"1 {len(q)} {' '.join(map(str, q))} 2 0.25 0.75" for q in QUADS]
        return (head + "\n".join(lines) + "\n").encode()
    o = "<" if "little" in form else ">"
    data = struct.pack(o + "BffhBh", 2, 0.5, 0.5, 7, 0, -1)
    data += b"".join(struct.pack(o + "Bdff", 9, z, x, y) for x, y, z in X)
    for q in QUADS:
        data += struct.pack(f"{o}Bi{len(q)}HBff", 1, len(q), *q, 2, 0.25, 0.75)
    return head.encode() + data


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_ply_of_lists_and_other_elements_is_read(tmp_path, form):
    vertices, triangles = read_ply(written(tmp_path / "a.ply", ply(form)))
    np.testing.assert_allclose(vertices, X, rtol=1e-7)
    assert triangles.tolist() == [list(t) for t in FANS]


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_and_stl_are_read_as_trimesh_reads_them(tmp_path, encoding):
    mesh = trimesh.Trimesh(X, TRIANGLES, process=False)
    vertices, triangles = read_ply(written(tmp_path / "a.ply", mesh.export(file_type="ply", encoding=encoding)))
    np.testing.assert_allclose(vertices, X, rtol=1e-6)
    np.testing.assert_array_equal(triangles, TRIANGLES)
    vertices, triangles = read_stl(
        written(tmp_path / "a.stl", mesh.export(file_type="stl" if encoding == "binary" else "stl_ascii"))
    )
    assert len(vertices) == len(X)  # merged again
    np.testing.assert_allclose(vertices[triangles], X[TRIANGLES], rtol=1e-6)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (ply("ascii", vertices=10**12), "cut off"),
        (ply("binary_little_endian", vertices=10**14), "cut off"),
        (ply("binary_little_endian", faces=2 * 10**3), "cut off"),
        (ply("binary_little_endian", faces=10**17), "no PLY file has"),
        (ply("ascii", body=b"nothing"), "cut off"),
        (ply("binary_little_endian")[:-9], "cut off"),
        (ply("ascii")[:-9], "cut off"),
        (ply("ascii").replace(b"1 3 4 5 6", b"1 -3 4 5 6"), "cut off"),
        (ply("ascii").replace(b"1 3 4 5 6", b"1 3 4 5.5 6"), "an index is no integer"),
        (ply("ascii").replace(b"ushort", b"float"), "names no vertices"),
        (ply("ascii").replace(b"property float x", b"property float q"), "no x, y and z"),
        (ply("ascii").replace(b"format ascii", b"format binary"), "no PLY file has"),
        (ply("ascii").replace(b"end_header", b"end"), "its header has no end"),
    ],
)
def test_a_ply_that_promises_more_than_it_has_is_refused(tmp_path, content, message):
    with pytest.raises(InputError, match=message):
        read_ply(written(tmp_path / "a.ply", content))


def test_an_stl_of_another_count_is_refused(tmp_path):
    content = trimesh.Trimesh(X, TRIANGLES, process=False).export(file_type="stl")
    for count in (10**9, 2**32 - 1, 319, 0):
        with pytest.raises(InputError, match="its size is not that of the"):
            read_stl(written(tmp_path / "a.stl", content[:80] + struct.pack("<I", count) + content[84:]))
    with pytest.raises(InputError, match="line 3 is none of an STL file"):
        read_stl(written(tmp_path / "a.stl", "solid a\nfacet normal 0 0 1\nsomething else\n"))
    with pytest.raises(InputError, match="cut off within a triangle"):
        read_stl(written(tmp_path / "a.stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 1 2 3\n"))


def glb(edit):
    x, corners = X.astype("<f4").tobytes(), TRIANGLES.astype("<u2").tobytes()
    words = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "buffers": [{"byteLength": len(x + corners)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": len(x)},
            {"buffer": 0, "byteOffset": len(x), "byteLength": len(corners)},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": len(X), "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": TRIANGLES.size, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    }
    edit(words)
    text = json.dumps(words).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I", len(text)) + b"JSON" + text + struct.pack("<I", len(x + corners)) + b"BIN\0" + x + corners
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def primitive(words):
    return words["meshes"][0]["primitives"][0]


def doubled_nodes(words):
    """Each node twice the child of the one before: 2^60 ways to the mesh."""
    words["nodes"] = [{"children": [k + 1, k + 1]} for k in range(60)] + [{"mesh": 0}]


def many_targets(words):
    words["accessors"].append({"componentType": 5126, "count": len(X), "type": "VEC3"})
    primitive(words)["targets"] = [{"POSITION": 2}] * 10_000


GLTF = {
    "as it is": (lambda words: None, ""),
    "stride negative": (lambda words: words["bufferViews"][0].update(byteStride=-4096), "byteStride: -4,096"),
    "stride short": (lambda words: words["bufferViews"][0].update(byteStride=1), "byteStride: 1, below the 12 bytes"),
    "offset negative": (lambda words: words["accessors"][0].update(byteOffset=-12), "byteOffset: -12"),
    "view negative": (lambda words: words["bufferViews"][1].update(byteOffset=-8), "byteOffset: -8"),
    "view beyond": (lambda words: words["bufferViews"][1].update(byteLength=10**12), "shorter than it says"),
    "count beyond": (lambda words: words["accessors"][0].update(count=10**6), "reaches beyond its buffer"),
    "count huge": (
        lambda words: words["accessors"][0].update(count=10**13),
        "10,000,000,000,000 vertices; expected at",
    ),
    "count of zeros": (
        lambda words: words["accessors"].__setitem__(0, {"componentType": 5126, "count": 10**12, "type": "VEC3"}),
        "vertices; expected at most",
    ),
    "count no integer": (lambda words: words["accessors"][0].update(count=162.5), "162.5 vertices"),
    "accessor negative": (lambda words: primitive(words).update(indices=-1), "accessors: -1 is none of its 2"),
    "index beyond": (lambda words: words["accessors"][0].update(count=100), "triangles: .*expected 0..99"),
    "kind of another": (lambda words: words["accessors"][0].update(type="VEC4"), "of type VEC4, expected VEC3"),
    "targets too many": (many_targets, "10,000 morph targets; expected at most 2,000"),
    "target of others": (lambda words: primitive(words).update(targets=[{"POSITION": 1}]), "expected VEC3"),
    "nodes doubled": (doubled_nodes, "its nodes are no tree"),
    "nodes deep": (
        lambda words: words.update(nodes=[{"children": [k + 1]} for k in range(500)] + [{"mesh": 0}]),
        "levels of nodes; expected at most 100",
    ),
    "scale NaN": (lambda words: words["nodes"][0].update(scale=[float("nan")] * 3), "NaN is no finite number"),
    "scale huge": (lambda words: words["nodes"][0].update(scale=[1e300] * 3), "scale: 1e\\+300 is too large"),
    "matrix short": (lambda words: words["nodes"][0].update(matrix=[1, 0]), "matrix: expected shape \\(16,\\)"),
}


@pytest.mark.parametrize("name", GLTF)
def test_counts_and_numbers_of_a_gltf_are_not_trusted(tmp_path, name):
    edit, message = GLTF[name]
    path = written(tmp_path / "a.glb", glb(edit))
    if not message:
        np.testing.assert_array_equal(read_scan(path).vertices, X)
        return
    with pytest.raises(InputError, match=f"a.glb: .*{message}"):
        read_scan(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "expected landmarks by name"),
        ("[]", "expected landmarks by name"),
        ("[" * 100_000, "levels of brackets"),
        ('{"chin": ' + "9" * 40 + "}", "40 digits"),
        ('{"chin": [1, 2, ' + "9" * 400 + "]}", "400 digits"),
        ('{"chin": [1, 2, NaN]}', "NaN is no finite number"),
        ('{"chin": [1, 2, 1e300]}', "landmark 'chin': 1e.300 is too large"),
        ('{"chin": [1, 2]}', r"landmark 'chin': expected shape \(3,\)"),
        ('{"chin": null}', "landmark 'chin': expected real numbers"),
    ],
)
def test_bad_landmarks_are_named(tmp_path, text, message):
    with pytest.raises(InputError, match=f"marks.json: .*{message}"):
        read_landmarks(written(tmp_path / "marks.json", text))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "levels of brackets"),
        ('{"a.obj": {"jawOpen": ' + "9" * 400 + "}}", "400 digits"),
        ('{"' + "a" * 5000 + '": {"jawOpen": 1}}', "no such file"),
        ('{"a\\u0000.obj": {"jawOpen": 1}}', "no such file"),
        ('{"\\ud800.obj": {"jawOpen": 1}}', "no such file"),
    ],
)
def test_bad_guesses_are_named(tmp_path, text, message):
    with pytest.raises(InputError, match=f"g.json: .*{message}") as raised:
        read_guesses(written(tmp_path / "g.json", text))
    assert str(raised.value).isprintable()


BALL = trimesh.creation.icosphere(2, radius=100)


def test_units_are_converted(tmp_path):
    np.savez(tmp_path / "ball.npz", vertices=BALL.vertices / 10, triangles=BALL.faces)
    np.testing.assert_allclose(read_surface(tmp_path / "ball.npz", unit="cm").vertices, BALL.vertices)
    with pytest.raises(InputError, match="inch"):
        read_surface(tmp_path / "ball.npz", unit="inch")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.ply", b"", "the file is empty"),
        ("broken.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 9", "its header has no end"),
        ("broken.npz", b"PK", "or damaged"),
        ("text.glb", b"this is no mesh", "not a GLB file"),
        ("no.obj", None, "no such file"),
    ],
)
def test_bad_files_are_named_in_one_line(tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=f"{name}: .*{message}") as caught:
        read_surface(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_skins_that_are_open_non_manifold_split_or_of_wrong_size_are_refused():
    x, triangles = BALL.vertices, BALL.faces
    check_skin(Surface(x, triangles))
    touching = np.isin(triangles, triangles[0]).any(axis=1)
    far = np.linalg.norm(x[triangles].mean(axis=1) + x[triangles[0]].mean(axis=0), axis=1).argmin()
    kept = ~touching
    kept[far] = False
    with pytest.raises(MeshError, match="2 holes"):
        check_skin(Surface(x, triangles[kept]))
    fin = np.vstack([triangles, [triangles[0][0], triangles[0][1], triangles[far][0]]])
    with pytest.raises(MeshError, match="more than two triangles"):
        check_skin(Surface(x, fin))
    flipped = triangles.copy()
    flipped[5] = flipped[5][::-1]
    with pytest.raises(MeshError, match="oriented against"):
        check_skin(Surface(x, flipped))
    with pytest.raises(MeshError, match="2 separate pieces"):
        check_skin(Surface(np.vstack([x, x + 300]), np.vstack([triangles, triangles + len(x)])))
    with pytest.raises(MeshError, match="units off"):
        check_skin(Surface(x / 1000, triangles))


def test_cache_is_read_back_and_rebuilt_when_damaged(tmp_path, monkeypatch):
    monkeypatch.setenv("SOFTDECA_CACHE", str(tmp_path / "cache"))
    made = []

    def make():
        made.append(1)
        return {"a": np.arange(5.0)}

    for _ in range(2):
        np.testing.assert_array_equal(load_or_make("thing", make)["a"], np.arange(5.0))
    assert len(made) == 1
    file = tmp_path / "cache" / "thing.npz"
    file.write_bytes(file.read_bytes()[:60])
    np.testing.assert_array_equal(load_or_make("thing", make)["a"], np.arange(5.0))
    assert len(made) == 2
    np.testing.assert_array_equal(load_or_make("thing", make)["a"], np.arange(5.0))
    assert len(made) == 2 and len(list(file.parent.iterdir())) == 1


# Buffers packed by meshoptimizer's own encoder (0.2.30 of its Python wrapper).
VERTICES_0 = bytes.fromhex(
    "a01f006a13f4733d57a7e264094b4f00b81d77515095f2d2ffa12554b6ecd86a6b44ffff00007a30952e8a9252152a0ccaa8"
    "62213579bbbbbb77330446aaccccca8842000000001f00dd18fe98fa6dbda06269091962c87476b1c2054984bfc574651dae"
    "bd7a84e0ffff00007c030469568cd9852a017b99326aca6057bb5148ca84179b7506aca803000000001f0002060a0e12161a"
    "1e22262a2e32363a3e40464a4e5256585e62666a6c72767affff00007e80868a8c92969a0490000000043c0000001e1d043c"
    "0000004e4d0000000000000000000000000000000000000000000000000000b80b00000000"
)
VERTICES_1 = bytes.fromhex(
    "a17703006a13f4733d57a7e264094b4f00b81d77515095f2d2ffa12554b6ecd86a6b447a30952e8a9252152a0ccaa8622135"
    "79bbbbbb77330446aaccccca88420000000000dd18fe98fa6dbda06269091962c87476b1c2054984bfc574651daebd7a84e0"
    "7c030469568cd9852a017b99326aca6057bb5148ca84179b7506aca803000000000002060a0e12161a1e22262a2e32363a3e"
    "40464a4e5256585e62666a6c72767a7e80868a8c92969a04030002010406001e1d0406004e4d000000000000000000000000"
    "00000000b80b000000000000"
)
TRIANGLES_1 = bytes.fromhex(
    "e1fefefefefefefefefefefefefefefefefffffffffffffffffffffffffefefefeffff0f0af202f202f2025f045f025f020f"
    "026f046f025f020f026f046f025f020f02ff2b0a01f2050af1070af1070aff050a01f2050af1070af1070aff050a01f2050a"
    "f1070af1070a80171615fe0a292f050e007687566778a9866589689801690000"
)
SEQUENCE = bytes.fromhex("d100041000911c06b1ef100200000000")


@pytest.mark.parametrize("packed", [VERTICES_0, VERTICES_1])
def test_attributes(packed):
    k = np.arange(40)
    x = np.stack([np.round(8000 * np.sin(0.2 * k)), np.round(3000 * np.cos(0.5 * k)), k * k % 257, (k == 17) * 9999], 1)
    found = np.frombuffer(decode_meshopt(packed, 40, 8, "ATTRIBUTES"), "<i2").reshape(40, 4)
    np.testing.assert_array_equal(found, x.astype("<i2"))


def test_triangles_up_to_where_they_begin():
    corner = (5 * np.arange(4)[:, None] + np.arange(4)).ravel()
    lower, upper = (corner[:, None] + np.array(offsets) for offsets in ([0, 1, 5], [1, 6, 5]))
    expected = np.vstack([lower, upper, [[24, 3, 11], [0, 24, 7]]])
    for stride, kind in ((4, "<u4"), (2, "<u2")):
        found = np.frombuffer(decode_meshopt(TRIANGLES_1, 102, stride, "TRIANGLES"), kind).reshape(-1, 3)
        first = (found == found.min(axis=1, keepdims=True)).argmax(axis=1)
        turned = np.take_along_axis(found, (first[:, None] + np.arange(3)) % 3, axis=1)
        first = (expected == expected.min(axis=1, keepdims=True)).argmax(axis=1)
        np.testing.assert_array_equal(turned, np.take_along_axis(expected, (first[:, None] + np.arange(3)) % 3, axis=1))


def test_a_sequence():
    found = np.frombuffer(decode_meshopt(SEQUENCE, 8, 4, "INDICES"), "<u4")
    assert found.tolist() == [0, 1, 5, 5, 900, 3, 70000, 2]


def test_the_exponential_filter():
    values = np.array([1.5, -0.25, 3072.0, 0.0], "<f4")
    exponent = np.array([-4, -8, 7, 0])
    mantissa = np.round(values / 2.0**exponent).astype(np.int64) & 0xFFFFFF
    raw = ((exponent & 0xFF) << 24 | mantissa).astype("<u4")
    # A buffer of one element of 16 bytes: header, no deltas, and the element to which they are added.
    packed = bytes([0xA0]) + bytes(16) + bytes(32 - 16) + raw.tobytes()
    found = np.frombuffer(decode_meshopt(packed, 1, 16, "ATTRIBUTES", "EXPONENTIAL"), "<f4")
    np.testing.assert_array_equal(found, values)


@pytest.mark.parametrize("cut", [0, 1, 5, 30])
def test_damaged_data_are_told(cut):
    for packed, count, stride, mode in (
        (VERTICES_0, 40, 8, "ATTRIBUTES"),
        (VERTICES_1, 40, 8, "ATTRIBUTES"),
        (TRIANGLES_1, 102, 4, "TRIANGLES"),
        (SEQUENCE[: len(SEQUENCE) // 2], 800, 4, "INDICES"),
    ):
        with pytest.raises(InputError, match="damaged or cut short"):
            decode_meshopt(packed[:cut], count, stride, mode)
    with pytest.raises(InputError, match="unknown mode"):
        decode_meshopt(SEQUENCE, 8, 4, "POINTS")
