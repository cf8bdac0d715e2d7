"""Scans: repaired with a word on each step, found in any orientation and unit."""

import numpy as np
import pytest
import trimesh

from softdeca.lhm import FitError, Surface, identities, scans
from softdeca.lhm.base.files.surface_file import Scan
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.geometry.topology import close_openings, find_openings, is_closed
from softdeca.lhm.scans.repair import repair_pieces, repair_scan
from softdeca.lhm.template.registration.registration import find_face

X, TRIANGLES = geodesic_sphere(4)


def turned(vector):
    angle = np.linalg.norm(vector)
    x, y, z = np.asarray(vector) / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


# Repair


def test_a_sound_surface_is_left_as_it_is_open_or_not():
    for triangles in (TRIANGLES, TRIANGLES[X[TRIANGLES][:, :, 1].min(axis=1) > -0.5]):
        scan = Scan(X, triangles)
        done = repair_scan(scan)
        assert done.scan.triangles.shape == triangles.shape
        assert done.notes == () and len(done.scan.vertices) == len(np.unique(triangles))


def test_a_stand_larger_than_the_head_is_tried_first_and_the_head_next():
    stand = trimesh.creation.box((4.0, 3.0, 4.0))
    x = np.vstack([X, stand.vertices - [0, 3, 0]])
    pieces = list(repair_pieces(Scan(x, np.vstack([TRIANGLES, len(X) + stand.faces]))))
    assert [len(done.scan.vertices) for done in pieces] == [8, len(X)]
    assert "the one that a face was found in was kept" in pieces[1].notes[-1]


def test_lips_that_touch_are_not_sewn_together_where_a_morph_target_opens_them():
    # Two squares that touch along an edge; the target lifts the upper one.
    x = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0], [1, 0, 0], [1, -1, 0], [0, -1, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [5, 4, 7], [5, 7, 6]])
    lift = np.zeros_like(x)
    lift[:4, 1] = 0.5
    assert len(repair_scan(Scan(x, triangles)).scan.vertices) == 6
    assert any("2 separate pieces" in note for note in repair_scan(Scan(x, triangles, {"jawOpen": lift})).notes)


def test_openings_are_closed_where_the_boundary_touches_itself_too():
    fans = [np.flatnonzero((TRIANGLES == vertex).any(axis=1)) for vertex in (0, 30)]
    kept = np.delete(TRIANGLES, np.concatenate(fans), axis=0)
    surface = Surface(X, kept)
    loops = find_openings(kept)
    assert len(loops) == 2 and is_closed(close_openings(surface).triangles)
    # Two triangles that share a vertex only: a boundary like an eight.
    first, *others = (k for k, t in enumerate(TRIANGLES) if 0 in t)
    opposite = next(k for k in others if len(np.intersect1d(TRIANGLES[k], TRIANGLES[first])) == 1)
    eight = np.delete(TRIANGLES, [first, opposite], axis=0)
    assert is_closed(close_openings(Surface(X, eight)).triangles)
    assert sum(map(len, find_openings(eight))) == 6


# Where the face is


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
        (turned([2.0, -0.8, 1.1]), 3.3, "none known", "turned upright"),
    ],
)
def test_a_face_is_found_in_any_orientation_and_unit(face, person, turn, size, told, way):
    moved = Surface(size * person.vertices @ turn.T + [5, 6, 7], person.triangles)
    found = scans.find_placement(moved, face)
    assert told in found.notes[0] and way in found.notes[1]
    upright = found.motion(moved.vertices)
    # The rest is a shift, a little tilt where the head was turned, and some scale where the unit is not known.
    a, b = upright - upright.mean(axis=0), person.vertices - person.vertices.mean(axis=0)
    off = np.linalg.norm(a - b, axis=1).max()
    assert off < (1e-9 if size in (1.0, 0.1, 1e-3) and "turned" not in way else 30.0)
    np.testing.assert_allclose(found.inverse(upright), moved.vertices, atol=1e-9)


def test_what_is_said_of_axes_and_unit_is_taken_or_refused(face, person):
    moved = Surface(person.vertices @ STATUE.T, person.triangles)
    found = scans.find_placement(moved, face, up="z", front="-y", unit="1.02")
    assert found.motion.scale == 1.02 and "as said" in found.notes[0]
    with pytest.raises(FitError, match="another --unit"):
        scans.find_placement(moved, face, unit="cm")


@pytest.mark.parametrize(("unit", "factor"), [("m", 1e-3), ("cm", 0.1), ("in", 1 / 25.4)])
def test_a_skin_of_the_templates_triangles_is_found_in_any_unit_and_orientation(template, tmp_path, unit, factor):
    rest = template.skin
    turn = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])  # z up, x the front

    def written(vertices):
        np.savez(tmp_path / "skin.npz", vertices=vertices, triangles=rest.triangles)
        return tmp_path / "skin.npz"

    placed = scans.place_scan(template, written(factor * rest.vertices @ turn.T))
    np.testing.assert_allclose(placed.skin.vertices, rest.vertices, atol=1e-9)
    assert f"taken for {unit}," in placed.notes[0] and placed.notes[1] == "axes: z is up, x the front"
    # Kilometres off it is moved to the origin, and knows its place.
    there = rest.vertices + [4.5e8, 0, -5e9]
    placed = scans.place_scan(template, written(there))
    assert np.abs(placed.skin.vertices.mean(axis=0)).max() < 1e-3 and "5e+06 m from the origin" in placed.notes[0]
    np.testing.assert_allclose(placed.placement.inverse(placed.skin.vertices), there, atol=1e-5)
    # As it stands where it stands as a head does, a child's too.
    child = 0.6 * rest.vertices + [1000.0, 0, 0]
    placed = scans.place_scan(template, written(child))
    np.testing.assert_array_equal(placed.skin.vertices, child)
    assert placed.notes == ()
