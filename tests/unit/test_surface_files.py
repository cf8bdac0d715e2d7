"""Readers of OBJ, PLY, STL and glTF against trimesh's, skins, and the cache: what each refuses."""

import base64
import json
import os
import struct

import numpy as np
import pytest
from scipy.spatial import cKDTree

from softdeca.lhm.base.files.cache import load_or_make
from softdeca.lhm.base.files.surface_file import read_scan, read_surface
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.geometry.topology import find_openings, is_closed
from softdeca.lhm.scans.intake import read_at_rest
from softdeca.lhm.scans.repair import repair_scan

from ..refusals import refused
from ..robustness.whole_files import Gltf, exported, obj

UNIT, TRIANGLES = geodesic_sphere(4)
X = np.round(6400 * UNIT) / 64  # [mm], exact in single precision and in nine digits
OBJ = obj(X, TRIANGLES)


def written(path, content):
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def mesh_of(path):
    scan = read_scan(path)
    return scan.vertices, scan.triangles


# Reading


def test_a_byte_order_mark_does_not_take_the_first_vertex(tmp_path):
    for mark in (b"", b"\xef\xbb\xbf"):
        vertices, triangles = mesh_of(written(tmp_path / "a.obj", mark + OBJ.encode()))
        np.testing.assert_array_equal(vertices, X)
        np.testing.assert_array_equal(triangles, TRIANGLES)


def test_an_obj_of_several_groups_and_materials_keeps_its_vertices(tmp_path):
    lines = [f"v {x:.9f} {y:.9f} {z:.9f} 0.5 0.5 0.5" for x, y, z in X]
    half = len(TRIANGLES) // 2
    lines += ["vt 0 0", "vn 0 0 1", "o head", "g face", "usemtl skin"]
    lines += ["f " + " ".join(f"{k + 1}/1/1" for k in t) for t in TRIANGLES[:half]]
    lines += ["g back", "usemtl hair", "s off"]
    lines += ["f " + " ".join(f"{k - len(X)}//1" for k in t) for t in TRIANGLES[half:]]
    vertices, triangles = mesh_of(written(tmp_path / "head.obj", "\n".join(lines)))
    assert np.allclose(vertices, X) and np.array_equal(triangles, TRIANGLES)
    quad = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 \\\n3 4 # a_b\nl 1 2\n"
    assert mesh_of(written(tmp_path / "quad.obj", quad))[1].tolist() == [[0, 1, 2], [0, 2, 3]]


SQUARES = "v 0 0 0\nv 10 0 0\nv 10 10 0\nv 9 1 0\n"
U = "v 0 0 0\nv 3 0 0\nv 3 3 0\nv 2 3 0\nv 2 1 0\nv 1 1 0\nv 1 3 0\nv 0 3 0\n"
AREAS = {
    "a concave quad": (SQUARES + "f 1 2 3 4\n", 10.0),
    "a U": (U + "f 1 2 3 4 5 6 7 8\n", 7.0),
    "a path in a comment": ("# C:\\scans\\\n" + SQUARES + "f 1 2 3\n", 50.0),
    "a path as a material": (SQUARES + "f 1 2 3\nusemtl skin\\head\\\nf 1 3 4\n", 50.0 + 40.0),
    "a path of a library": ("mtllib C:\\scan\\\n" + SQUARES + "f 1 2 3\n", 50.0),
    "a vertex in two lines": ("v 0 0 \\\n0\n" + SQUARES[8:] + "f 1 2 3\n", 50.0),
}
"""Areas by the shoelace formula; a fan of the first quad would cover 90."""


@pytest.mark.parametrize("name", AREAS)
def test_polygons_of_an_obj_cover_what_they_enclose(tmp_path, name):
    text, area = AREAS[name]
    assert read_surface(written(tmp_path / "a.obj", text)).areas.sum() == pytest.approx(area)


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
    vertices, triangles = mesh_of(written(tmp_path / "a.ply", ply(form)))
    np.testing.assert_allclose(vertices, X, rtol=1e-7)
    assert triangles.tolist() == [list(t) for t in FANS]


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_and_stl_are_read_as_trimesh_reads_them(tmp_path, encoding):
    vertices, triangles = mesh_of(written(tmp_path / "a.ply", exported("ply", X, TRIANGLES, encoding=encoding)))
    np.testing.assert_allclose(vertices, X, rtol=1e-6)
    np.testing.assert_array_equal(triangles, TRIANGLES)
    kind = {"binary": "stl", "ascii": "stl_ascii"}[encoding]
    vertices, triangles = mesh_of(written(tmp_path / "a.stl", exported(kind, X, TRIANGLES)))
    assert len(vertices) == len(X)  # merged again
    np.testing.assert_allclose(vertices[triangles], X[TRIANGLES], rtol=1e-6)


def gltf(x=X, morphs=None, **nodes) -> Gltf:
    """The sphere in two primitives over the same vertices."""
    made, x = Gltf(**nodes), x if x.dtype == "<i2" else x.astype("<f4")
    attributes = {"POSITION": made.add(x, **({"normalized": True} if x.dtype == "<i2" else {}))}
    half = len(TRIANGLES) // 2
    primitives = [
        {"attributes": attributes, "indices": made.add(part.astype("<u2").ravel())}
        for part in (TRIANGLES[:half], TRIANGLES[half:])
    ]
    if morphs is None:
        made.mesh(*primitives)
    else:
        targets = [{"POSITION": made.add(delta.astype("<f4"))} for delta in morphs.values()]
        made.mesh(*(each | {"targets": targets} for each in primitives), extras={"targetNames": list(morphs)})
    return made


@pytest.mark.parametrize("quantized", [False, True])
def test_gltf_is_read_with_transforms_and_morph_targets(tmp_path, quantized):
    wave = 0.1 * np.sin(5 * UNIT)
    node = {"translation": [1, 2, 3], "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "scale": [2, 2, 2]}
    x = np.round(UNIT * 32767).astype("<i2") if quantized else UNIT
    nodes = {"scenes": [{"nodes": [0]}], "nodes": [{"children": [1], **node}, {"mesh": 0}]}
    made = gltf(x, {"jawOpen": wave, "smirk": 2 * wave}, **nodes)
    scan = read_scan(written(tmp_path / "a.glb", made.glb()))
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for half in (slice(0, len(X)), slice(len(X), None)):
        np.testing.assert_allclose(scan.vertices[half], 2 * UNIT @ turn.T + [1, 2, 3], atol=1e-4)
        np.testing.assert_allclose(scan.morphs["smirk"][half], 4 * wave @ turn.T, atol=1e-6)
    # Two primitives over the same vertices become one surface again.
    done = repair_scan(scan)
    assert len(done.scan.vertices) == len(X) and is_closed(done.scan.triangles)
    there = cKDTree(scan.vertices[: len(X)]).query(done.scan.vertices)[1]
    np.testing.assert_allclose(done.scan.morphs["jawOpen"], (2 * wave @ turn.T)[there], atol=1e-6)

    made.words["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(made.chunk).decode()
    assert np.array_equal(mesh_of(written(tmp_path / "b.gltf", json.dumps(made.words)))[0], scan.vertices)
    for uri, said in (
        ("missing.bin", "no such file beside it"),
        ("head:1.bin", "has no ':'"),
        (".a.bin", "with a dot"),
    ):
        made.words["buffers"][0]["uri"] = uri
        refused(f"{uri}: .*{said}", read_scan, written(tmp_path / "b.gltf", json.dumps(made.words)))


WAVE = 10.0 * UNIT * [1, 0, 0]


def posed(names=("wide",), by=(), inner=(), named="extras", skin=None):
    """A sphere with morph targets: their weights `by` the mesh and `inner` of its node, and where names stand."""
    made = Gltf(nodes=[{"mesh": 0, **({"weights": list(inner)} if inner else {})}])
    targets = [{"POSITION": made.add(((k + 1) * WAVE).astype("<f4"))} for k in range(len(names))]
    part = {"attributes": {"POSITION": made.add(X.astype("<f4"))}, "indices": made.add(TRIANGLES.astype("<u2").ravel())}
    more = {"weights": list(by)} if by else {}
    if named == "accessors":
        for target, name in zip(targets, names, strict=True):
            made.words["accessors"][target["POSITION"]]["name"] = name
    else:
        (part if named == "primitive" else more)["extras"] = {"targetNames": list(names)}
    if skin is not None:
        made.words["skins"] = [{"joints": [1, 2]}]
        made.words["nodes"] = [{"mesh": 0, "skin": 0, "translation": [9, 9, 9]}, *({"translation": t} for t in skin)]
        made.words["scenes"] = [{"nodes": [0, 1, 2]}]
    made.mesh(part | {"targets": targets}, **more)
    return made


# The specification says: a node's weights replace its mesh's, and the transform of a skinned mesh's node is ignored.
SHOWN = {
    "a mesh's weights": ({"by": [1.0]}, WAVE),
    "a node's weights": ({"by": [1.0], "inner": [0.5]}, 0.5 * WAVE),
    "two targets": ({"names": ("a", "b"), "by": [0.5, 0.25]}, WAVE),
    "joints that move alike": ({"skin": ([0, 4, 0], [0, 4, 0])}, [0, 4, 0]),
}


@pytest.mark.parametrize("name", SHOWN)
def test_a_gltf_is_read_as_it_is_shown(tmp_path, name):
    options, moved = SHOWN[name]
    scan = read_scan(written(tmp_path / "a.glb", posed(**options).glb()))
    np.testing.assert_allclose(scan.vertices, X + moved, atol=1e-5)
    assert scan.notes == ()


@pytest.mark.parametrize("named", ["extras", "primitive", "accessors"])
def test_morph_targets_are_named_where_exporters_name_them(tmp_path, named):
    scan = read_scan(written(tmp_path / "a.glb", posed(("jawOpen", "smirk"), named=named).glb()))
    assert list(scan.morphs) == ["jawOpen", "smirk"]


def test_expressions_that_a_gltf_shows_are_taken_out_of_a_neutral_head_and_told(tmp_path):
    made = posed(("jawOpen", "wide"), by=[0.5, 1.0])
    scan, notes = read_at_rest(written(tmp_path / "a.glb", made.glb()))
    np.testing.assert_allclose(scan.vertices, X + 2 * WAVE, atol=1e-5)
    assert notes == ("expressions that the file shows were taken out: jawOpen",)


def test_what_of_a_gltf_is_left_out_is_told(tmp_path):
    made = posed(skin=([0, 4, 0], [0, 0, 0]))
    strip = made.words["meshes"][0]["primitives"][0] | {"mode": 5, "indices": made.add(np.arange(9).astype("<u2"))}
    made.words["meshes"][0]["primitives"].append(strip)
    said = read_scan(written(tmp_path / "a.glb", made.glb())).notes
    assert len(said) == 2 and "skeleton poses it" in said[0] and "strips" in said[1]


def test_positions_of_a_gltf_may_be_sparse_alone(tmp_path):
    made = posed()
    ids, x = np.arange(len(X)).astype("<u2"), X.astype("<f4")
    sparse = {"indices": {"bufferView": made.view(ids.tobytes()), "componentType": 5123}, "count": len(X)}
    sparse["values"] = {"bufferView": made.view(x.tobytes())}
    position = made.access({"count": len(X), "type": "VEC3", "componentType": 5126, "sparse": sparse})
    made.words["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = position
    np.testing.assert_array_equal(mesh_of(written(tmp_path / "a.glb", made.glb()))[0], X)


def test_a_draco_file_is_read(data):
    pytest.importorskip("DracoPy")
    done = repair_scan(read_scan(data / "heads" / "lee_perry_smith.glb"))
    assert len(done.scan.vertices) == 8844 and len(find_openings(done.scan.triangles)) == 4
    assert any("379 vertices" in note for note in done.notes)


def test_units_are_converted(tmp_path):
    np.savez(tmp_path / "ball.npz", vertices=X / 10, triangles=TRIANGLES)
    np.testing.assert_allclose(read_surface(tmp_path / "ball.npz", unit="cm").vertices, X)


# Refusals


OUTSIDE = [
    "{outside}", "../outside.bin", "%2e%2e/outside.bin", "below/../../outside.bin", "below%2F..%2F..%2Foutside.bin",
    "file://{outside}", "file:outside.bin", "C:/outside.bin", "..\\outside.bin", ".hidden.bin", "below/.hidden/a.bin",
    "linked.bin", "linked/outside.bin", "loop.bin", "pipe.bin", "below", ".", "", "http://127.0.0.1/a.bin",
    "/proc/self/environ", "/dev/zero", "a" * 100_000, "below/" * 40_000, "a\0b", "%00", "\ud800", 7, ["in.bin"],
]  # fmt: skip


@pytest.mark.parametrize(("number", "uri"), enumerate(OUTSIDE), ids=range(len(OUTSIDE)))
def test_a_gltf_opens_no_file_outside_its_folder(tmp_path, number, uri):
    made, outside = gltf(), tmp_path / "outside.bin"
    here = tmp_path / "here"
    (here / "below" / ".hidden").mkdir(parents=True)
    for file in (outside, here / ".hidden.bin", here / "below" / ".hidden" / "a.bin"):
        file.write_bytes(made.chunk)
    (here / "linked.bin").symlink_to(outside)
    (here / "linked").symlink_to(tmp_path)
    (here / "loop.bin").symlink_to(here / "loop.bin")
    os.mkfifo(here / "pipe.bin")
    made.words["buffers"][0]["uri"] = uri.format(outside=outside) if isinstance(uri, str) else uri
    path = written(here / "a.glb", made.glb()) if number % 2 else written(here / "a.gltf", json.dumps(made.words))
    assert len(refused(f"{path.name}: ", read_scan, path)) < len(str(path)) + 200


def test_a_gltf_reads_what_it_states_of_a_file_in_its_folder_also_by_a_link(tmp_path):
    made, here = gltf(), tmp_path / "here"
    (here / "below").mkdir(parents=True)
    (here / "below" / "a b.bin").write_bytes(made.chunk + bytes(10**6))
    (here / "near.bin").symlink_to(here / "below" / "a b.bin")
    for uri in ("below/a%20b.bin", "./below/a b.bin", "near.bin"):
        made.words["buffers"][0]["uri"] = uri
        written(here / "a.gltf", json.dumps(made.words))
        np.testing.assert_array_equal(mesh_of(here / "a.gltf")[0][: len(X)], X)
    # The folder is that of the file, not of the link to it.
    (tmp_path / "link.gltf").symlink_to(here / "a.gltf")
    np.testing.assert_array_equal(mesh_of(tmp_path / "link.gltf")[0][: len(X)], X)


def test_a_mirrored_gltf_keeps_its_outside_and_a_rotation_is_of_unit_length(tmp_path):
    made = gltf()
    made.words["nodes"][0] |= {"scale": [-1, 1, 1], "rotation": [0, 0, 1.004, 0]}
    vertices, triangles = mesh_of(written(tmp_path / "a.glb", made.glb()))
    np.testing.assert_allclose(vertices[: len(X)], X * [1, -1, 1], atol=1e-9)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0.0


# Skins and the cache


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
    file.rename(file.with_name("other.npz"))
    load_or_make("other", make)
    assert len(made) == 3  # a file under another name is none
