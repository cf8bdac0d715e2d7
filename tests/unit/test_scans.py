"""Scans: read from any usual file, repaired with a word on each step, found in any orientation and unit."""

import base64
import json
import struct

import numpy as np
import pytest

from softdeca.lhm import FitError, InputError, MeshError, Surface, identities, load_template, scans
from softdeca.lhm.arkit import ARKIT, arkit_name, find_arkit_morphs
from softdeca.lhm.base.files.surface_file import Scan, read_scan
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.geometry.topology import close_openings, find_openings, is_closed
from softdeca.lhm.registration.registration import find_face
from softdeca.lhm.scans.repair import repair_scan

X, TRIANGLES = geodesic_sphere(4)


def turned(vector):
    angle = np.linalg.norm(vector)
    x, y, z = np.asarray(vector) / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def volume(scan):
    a, b, c = (scan.vertices[scan.triangles[:, k]] for k in range(3))
    return np.einsum("md,md->", a, np.cross(b, c)) / 6


# Reading


def test_an_obj_of_several_groups_and_materials_keeps_its_vertices(tmp_path):
    lines = [f"v {x:.9f} {y:.9f} {z:.9f} 0.5 0.5 0.5" for x, y, z in X]
    half = len(TRIANGLES) // 2
    lines += ["vt 0 0", "vn 0 0 1", "o head", "g face", "usemtl skin"]
    lines += ["f " + " ".join(f"{k + 1}/1/1" for k in t) for t in TRIANGLES[:half]]
    lines += ["g back", "usemtl hair", "s off"]
    lines += ["f " + " ".join(f"{k - len(X)}//1" for k in t) for t in TRIANGLES[half:]]
    (tmp_path / "head.obj").write_text("\n".join(lines))
    scan = read_scan(tmp_path / "head.obj")
    assert np.allclose(scan.vertices, X) and np.array_equal(scan.triangles, TRIANGLES)
    (tmp_path / "quad.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 \\\n3 4\nl 1 2\n")
    assert read_scan(tmp_path / "quad.obj").triangles.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", "v 0 0\nf 1 2 3", "line 1 is none of an OBJ file"),
        ("a.obj", "v 0 0 0\nf 1 2", "line 2 is none of an OBJ file"),
        ("a.obj", "v 0 0 0\nf 1 2 3", "outside 0..0"),
        ("a.obj", "v 0 0 nan\nv 0 0 1\nv 0 1 0\nf 1 2 3", "not finite"),
        ("a.obj", "v 0 0 0", "no triangles found"),
        ("a.glb", "solid", "does not begin with 'glTF'"),
        ("a.gltf", "{", "not a glTF file"),
        ("a.gltf", '{"asset": {"version": "1.0"}}', "not a glTF 2.0 file"),
        ("a.gltf", '{"asset": {"version": "2.0"}, "nodes": [{"children": [0]}]}', "no triangles found"),
        ("a.gltf", '{"asset": {"version": "2.0"}, "extensionsRequired": ["X_y"]}', "needs the glTF extension 'X_y'"),
        ("a.stl", "hello", "no"),
        ("a.fbx", "x", "unknown kind of file"),
        ("a.ply", "", "the file is empty"),
    ],
)
def test_bad_files_are_one_line(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message) as error:
        read_scan(tmp_path / name)
    assert str(tmp_path / name) in str(error.value) and "\n" not in str(error.value)


def gltf(*, morphs=None, node=None, quantized=False):
    """A glTF of the sphere in two primitives, its data within the text."""
    half = len(TRIANGLES) // 2
    chunks, views, accessors = [], [], []

    def add(array, component, kind, **more):
        start = sum(map(len, chunks))
        content = array.tobytes() + b"\0" * (-array.nbytes % 4)
        chunks.append(content)
        views.append({"buffer": 0, "byteOffset": start, "byteLength": array.nbytes})
        count = array.size if kind == "SCALAR" else len(array)
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": component, "count": count, "type": kind, **more}
        )
        return len(accessors) - 1

    if quantized:
        place = add(np.round(X * 32767).astype("<i2"), 5122, "VEC3", normalized=True)
    else:
        place = add(X.astype("<f4"), 5126, "VEC3")
    primitives = [
        {"attributes": {"POSITION": place}, "indices": add(part.astype("<u2").ravel(), 5123, "SCALAR")}
        for part in (TRIANGLES[:half], TRIANGLES[half:])
    ]
    mesh = {"primitives": primitives}
    if morphs:
        targets = [{"POSITION": add(delta.astype("<f4"), 5126, "VEC3")} for delta in morphs.values()]
        for primitive in primitives:
            primitive["targets"] = targets
        mesh["extras"] = {"targetNames": list(morphs)}
    content = b"".join(chunks)
    return {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], **(node or {})}, {"mesh": 0}],
        "meshes": [mesh],
        "buffers": [{"byteLength": len(content)}],
        "bufferViews": views,
        "accessors": accessors,
    }, content


def write_glb(path, document, content):
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(content), b"BIN\0") + content
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


@pytest.mark.parametrize("quantized", [False, True])
def test_gltf_is_read_with_transforms_and_morph_targets(tmp_path, quantized):
    wave = 0.1 * np.sin(5 * X)
    node = {"translation": [1, 2, 3], "rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "scale": [2, 2, 2]}
    document, content = gltf(morphs={"jawOpen": wave, "smirk": 2 * wave}, node=node, quantized=quantized)
    write_glb(tmp_path / "a.glb", document, content)
    scan = read_scan(tmp_path / "a.glb")
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for half in (slice(0, len(X)), slice(len(X), None)):
        np.testing.assert_allclose(scan.vertices[half], 2 * X @ turn.T + [1, 2, 3], atol=1e-4)
        np.testing.assert_allclose(scan.morphs["smirk"][half], 4 * wave @ turn.T, atol=1e-6)
    # Two primitives over the same vertices become one surface again.
    done = repair_scan(scan)
    assert len(done.scan.vertices) == len(X) and is_closed(done.scan.triangles)
    np.testing.assert_allclose(done.scan.morphs["jawOpen"], (2 * wave @ turn.T)[done.origin % len(X)], atol=1e-6)

    data = base64.b64encode(content).decode()
    document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + data
    (tmp_path / "b.gltf").write_text(json.dumps(document))
    assert np.array_equal(read_scan(tmp_path / "b.gltf").vertices, scan.vertices)
    document["buffers"][0]["uri"] = "missing.bin"
    (tmp_path / "b.gltf").write_text(json.dumps(document))
    with pytest.raises(InputError, match="'missing.bin' is not beside it"):
        read_scan(tmp_path / "b.gltf")
    whole = (tmp_path / "a.glb").read_bytes()
    for cut in (10, 200, len(whole) // 2, len(whole) - 9):
        (tmp_path / "c.glb").write_bytes(whole[:cut])
        with pytest.raises(InputError, match=r"c\.glb: "):
            read_scan(tmp_path / "c.glb")


def test_a_draco_file_is_read(data):
    pytest.importorskip("DracoPy")
    done = repair_scan(read_scan(data / "heads" / "lee_perry_smith.glb"))
    assert len(done.scan.vertices) == 8844 and len(find_openings(done.scan.triangles)) == 4
    assert any("379 vertices" in note for note in done.notes)


# Repair


def spoilt(name):
    """Vertices and triangles of the sphere with one defect, and how it is told."""
    t = TRIANGLES
    n = len(X)
    if name == "torn":
        return X[t.ravel()], np.arange(t.size).reshape(-1, 3), "that lie on others at seams were merged"
    if name == "doubled":
        return X, np.vstack([t, t[:9, [1, 2, 0]]]), "9 doubled triangles"
    if name == "flat":
        return X, np.vstack([t, [[0, 0, 1]]]), "1 triangles without area"
    if name == "fin":
        return np.vstack([X, [[0, 0, 3.0]]]), np.vstack([t, [[t[0, 0], t[0, 1], n]]]), "1 edges of more than two"
    if name == "turned":
        mixed = t.copy()
        mixed[::3] = mixed[::3, ::-1]
        return X, mixed, "turned the way round"
    if name == "inwards":
        return X, t[:, ::-1], "faced inwards"
    if name == "pieces":
        return np.vstack([X, 0.2 * X + 3]), np.vstack([t, t + n]), "of 2 separate pieces the largest was kept"
    touching = np.vstack([X, [[3.0, 0, 0], [3, 1, 0], [3, 0, 1]]])
    more = [[0, n, n + 1], [0, n + 1, n + 2], [0, n + 2, n], [n + 1, n, n + 2]]
    return touching, np.vstack([t, more]), "where surfaces only touch"


@pytest.mark.parametrize("name", ["torn", "doubled", "flat", "fin", "turned", "inwards", "pieces", "touching"])
def test_a_defect_is_repaired_and_told(name):
    vertices, triangles, words = spoilt(name)
    done = repair_scan(Scan(vertices, triangles))
    assert any(words in note for note in done.notes)
    assert volume(done.scan) == pytest.approx(volume(Scan(X, TRIANGLES)), rel=1e-3)
    assert len(done.scan.triangles) == len(TRIANGLES)
    np.testing.assert_array_equal(vertices[done.origin], done.scan.vertices)
    assert is_closed(close_openings(done.scan.surface).triangles)


def test_a_sound_surface_is_left_as_it_is_open_or_not():
    for triangles in (TRIANGLES, TRIANGLES[X[TRIANGLES][:, :, 1].min(axis=1) > -0.5]):
        scan = Scan(X, triangles)
        done = repair_scan(scan)
        assert done.scan.triangles.shape == triangles.shape
        assert done.notes == () and len(done.scan.vertices) == len(np.unique(triangles))


def test_lips_that_touch_are_not_sewn_together_where_a_morph_target_opens_them():
    # Two squares that touch along an edge; the target lifts the upper one.
    x = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0], [1, 0, 0], [1, -1, 0], [0, -1, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [5, 4, 7], [5, 7, 6]])
    lift = np.zeros_like(x)
    lift[:4, 1] = 0.5
    assert len(repair_scan(Scan(x, triangles)).scan.vertices) == 6
    assert any("2 separate pieces" in note for note in repair_scan(Scan(x, triangles, {"jawOpen": lift})).notes)


def test_a_moebius_strip_and_a_mesh_of_nothing_are_refused():
    angle = np.linspace(0, 2 * np.pi, 13)[:-1]
    rim = [np.cos(angle), np.sin(angle), 0 * angle]
    across = [np.cos(angle / 2) * np.cos(angle), np.cos(angle / 2) * np.sin(angle), np.sin(angle / 2)]
    x = np.stack([np.transpose(rim) + 0.3 * np.transpose(across), np.transpose(rim) - 0.3 * np.transpose(across)])
    a = np.arange(12)
    b = (a + 1) % 12
    up, down = a + 0, a + 12
    next_up, next_down = np.where(b == 0, 12, b), np.where(b == 0, 0, b + 12)
    triangles = np.vstack([np.stack([up, down, next_up], 1), np.stack([down, next_down, next_up], 1)])
    with pytest.raises(MeshError, match="one side only"):
        repair_scan(Scan(x.reshape(-1, 3), triangles))
    with pytest.raises(MeshError, match="none of its triangles has an area"):
        repair_scan(Scan(np.zeros((3, 3)), [[0, 1, 2]]))


def test_openings_are_closed_where_the_boundary_touches_itself_too():
    fans = [np.flatnonzero((TRIANGLES == vertex).any(axis=1)) for vertex in (0, 30)]
    kept = np.delete(TRIANGLES, np.concatenate(fans), axis=0)
    surface = Surface(X, kept)
    loops = find_openings(kept)
    assert len(loops) == 2 and is_closed(close_openings(surface).triangles)
    # Two triangles that share a vertex only: a boundary like an eight.
    neighbour = next(t for t in TRIANGLES if 0 in t and t[0] == 0)
    others = [k for k, t in enumerate(TRIANGLES) if 0 in t]
    eight = np.delete(TRIANGLES, [others[0], others[len(others) // 2]], axis=0)
    assert len(neighbour) == 3 and is_closed(close_openings(Surface(X, eight)).triangles)
    assert sum(map(len, find_openings(eight))) == 6


# Names


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("jawOpen", "jawOpen"),
        ("eyeBlink_L", "eyeBlinkLeft"),
        ("blendShape1.mouthSmile_R", "mouthSmileRight"),
        ("EyeBlinkLeft", "eyeBlinkLeft"),
        ("Face:mouth_smile_left", "mouthSmileLeft"),
        ("browInnerUp_L", "browInnerUp"),
        ("cheekPuff_R", "cheekPuff"),
        ("mouthLeft", "mouthLeft"),
        ("eyeBlink.R", "eyeBlinkRight"),
        ("viseme_aa", None),
        ("target 3", None),
    ],
)
def test_names_are_known_however_they_are_written(name, meant):
    assert arkit_name(name) == meant
    assert all(arkit_name(known) == known for known in ARKIT)


def test_halves_are_added():
    found = find_arkit_morphs(
        {"browInnerUp_L": np.ones((2, 3)), "browInnerUp_R": 2 * np.ones((2, 3)), "x": np.ones((2, 3))}
    )
    assert list(found) == ["browInnerUp"] and (found["browInnerUp"] == 3).all()


# Where the face is


@pytest.fixture(scope="module")
def template():
    return load_template(level=1)


@pytest.fixture(scope="module")
def face(template):
    mask = find_face(template.skin, template.parts)[1]
    return template.skin.vertices[mask], template.skin.vertex_normals[mask]


@pytest.fixture(scope="module")
def person():
    return identities.Anny().sample(np.random.default_rng(4))[1]


UPRIGHT = np.eye(3)
STATUE = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
BACK = np.diag([-1.0, 1, -1])


@pytest.mark.parametrize(
    ("turn", "size", "told", "way"),
    [
        (UPRIGHT, 1.0, "taken for mm", "y is up, z the front"),
        (STATUE, 0.1, "taken for cm", "z is up, -y the front"),
        (BACK, 1e-3, "taken for m,", "y is up, -z the front"),
        (turned([0.4, 0.9, -0.5]), 1 / 25.4, "taken for in", "turned upright"),
        (turned([2.0, -0.8, 1.1]), 3.3, "none known", "turned upright"),
    ],
)
def test_a_face_is_found_in_any_orientation_and_unit(face, person, turn, size, told, way):
    moved = Surface(size * person.vertices @ turn.T + [5, 6, 7], person.triangles)
    found = scans.find_placement(moved, face)
    assert told in found.notes[0] and way in found.notes[1]
    upright = found.motion(moved.vertices)
    # What is left is a shift, a little tilt where the head was turned, and some scale where the unit is not known.
    a, b = upright - upright.mean(axis=0), person.vertices - person.vertices.mean(axis=0)
    off = np.linalg.norm(a - b, axis=1).max()
    assert off < (1e-9 if size in (1.0, 0.1, 1e-3) and "turned" not in way else 30.0)
    np.testing.assert_allclose(found.inverse(upright), moved.vertices, atol=1e-9)


def test_what_is_said_of_axes_and_unit_is_taken_or_refused(face, person):
    moved = Surface(person.vertices @ STATUE.T, person.triangles)
    found = scans.find_placement(moved, face, up="z", front="-y", unit="1.02")
    assert found.motion.scale == 1.02 and "as said" in found.notes[0]
    for options, error, message in (
        ({"up": "z", "front": "x"}, FitError, "no face found"),
        ({"unit": "cm"}, FitError, "another --unit"),
        ({"unit": "mile"}, InputError, "unit 'mile': expected one of mm"),
        ({"unit": "-3"}, InputError, "unit '-3'"),
        ({"up": "z", "front": "-z"}, InputError, "two different axes"),
        ({"up": "w"}, InputError, "up 'w': expected one of x"),
    ):
        with pytest.raises(error, match=message):
            scans.find_placement(moved, face, **options)


def test_a_sphere_has_no_face(face):
    with pytest.raises(FitError, match="no face found"):
        scans.find_placement(Surface(100 * X, TRIANGLES), face)


@pytest.mark.parametrize(("unit", "factor"), [("m", 1e-3), ("cm", 0.1), ("in", 1 / 25.4)])
def test_a_skin_of_the_templates_triangles_is_found_in_any_unit_and_orientation(tmp_path, unit, factor):
    template = load_template(level=1)
    rest = template.skin
    turn = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])  # z up, x the front

    def written(vertices):
        np.savez(tmp_path / "skin.npz", vertices=vertices, triangles=rest.triangles)
        return tmp_path / "skin.npz"

    skin, notes = scans.read_same_topology(written(factor * rest.vertices @ turn.T), template)
    np.testing.assert_allclose(skin.vertices, rest.vertices, atol=1e-9)
    assert f"taken for {unit}," in notes[0] and notes[1] == "axes: z is up, x the front"
    # As it stands where it stands as a head does, a child's too.
    skin, notes = scans.read_same_topology(written(0.6 * rest.vertices), template)
    np.testing.assert_array_equal(skin.vertices, 0.6 * rest.vertices)
    assert notes == ()
    with pytest.raises(InputError, match="skin.npz: skin: in that unit its face is 0.0+1 times .* another --unit"):
        scans.read_same_topology(written(1e-3 * rest.vertices), template, scans.Hints(unit="mm"))
    with pytest.raises(InputError, match="skin.npz: skin: all its vertices are in one place"):
        scans.read_same_topology(written(0 * rest.vertices), template)
