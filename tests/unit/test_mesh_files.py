"""Readers of OBJ, PLY, STL and glTF against trimesh's, and what each refuses before it makes anything of it."""

import json
import struct

import numpy as np
import pytest
import trimesh

from softdeca.lhm import InputError
from softdeca.lhm.base.files.ply import read_ply
from softdeca.lhm.base.files.surface_file import read_obj, read_scan, read_stl
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.registration import read_landmarks
from softdeca.lhm.scans import read_guesses

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
