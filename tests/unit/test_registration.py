"""Registration: its parts against closed forms, whole heads against known correspondence, bad input by its message."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from softdeca.lhm import FitError, MeshError, Surface, identities
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.geometry.warp import fit_similarity
from softdeca.lhm.identities.space import MOUTH
from softdeca.lhm.template.registration import (
    landmark_ids,
    pair_landmarks,
    register,
)
from softdeca.lhm.template.registration.alignment import Target
from softdeca.lhm.template.registration.nonrigid import SmoothAffine
from softdeca.lhm.template.registration.registration import template_ties

from ..refusals import refused


@pytest.fixture(scope="module")
def space():
    return identities.Anny()


@pytest.fixture(scope="module")
def person(space):
    return space.sample(np.random.default_rng(1))[1]


def turned(degrees: float, axis: int) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    rotation = np.eye(3)
    i, j = [k for k in range(3) if k != axis]
    rotation[i, i], rotation[i, j], rotation[j, i], rotation[j, j] = c, -s, s, c
    return rotation


def test_similarity_is_recovered():
    points = np.random.default_rng(0).normal(size=(20, 3))
    moved = 1.3 * points @ turned(40, 1).T + [5, -2, 1]
    found = fit_similarity(points, moved)
    assert found.scale == pytest.approx(1.3)
    np.testing.assert_allclose(found(points), moved, atol=1e-12)


def test_of_two_sheets_the_one_that_faces_the_same_way_is_matched():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * 10
    up, down = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[6, 5, 4], [7, 6, 4]])
    target = Target(Surface(np.vstack([square, square + [0, 0, 1.0]]), np.vstack([up, down])))
    points = np.array([[5.0, 6, 0.9], [5, 6, 0.9], [5, 6, 0.9], [14, 5, 0]])
    normals = np.array([[0.0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 0, 1]])
    closest, distance, weight = target.match(points, normals)
    np.testing.assert_allclose(closest[:2], [[5, 6, 0], [5, 6, 1]])
    np.testing.assert_allclose(distance[:2], [0.9, 0.1])
    # No sheet faces along x, and the last point lies beside the sheet, closest to its open edge.
    assert weight.tolist() == [1, 1, 0, 0]


def test_of_two_slopes_the_one_turned_alike_is_matched_where_that_counts():
    # A steep and a gentle slope with a common foot: the point lies over the steep one, and faces upwards.
    x = np.array([[-10.0, -5, 10], [-10, 5, 10], [0, 5, 0], [0, -5, 0], [0, 5, 0], [0, -5, 0], [10, -5, 5], [10, 5, 5]])
    target = Target(Surface(x, np.array([[0, 3, 2], [0, 2, 1], [5, 6, 7], [5, 7, 4]])))
    points, normals = np.array([[-2.0, 0, 3.0]]), np.array([[0.0, 0, 1]])
    near, alike = (target.located(points, normals, turned=turned)[0] for turned in (0.0, 20.0))
    assert set(near[0]) <= {0, 1, 2, 3} and set(alike[0]) <= {4, 5, 6, 7}


@pytest.mark.parametrize("turned", [0.0, 3.0])
def test_matches_within_reach_are_those_of_an_endless_search(turned):
    x, triangles = geodesic_sphere(6)
    target = Target(Surface(20 * x, triangles))
    rng = np.random.default_rng(2)
    points, normals = 15 * rng.standard_normal((300, 3)), rng.standard_normal((300, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    endless, near = (target.match(points, normals, turned=turned, reach=reach) for reach in (np.inf, 6.0))
    within = (endless[2] > 0) & (endless[1] < 6.0)
    assert 20 < within.sum() < 250
    for one, other in zip(endless, near, strict=True):
        np.testing.assert_array_equal(one[within], other[within])
    assert not (near[2][~within] * (near[1][~within] < 6.0)).any()


def test_affine_maps_carry_what_is_not_held():
    x, triangles = geodesic_sphere(5)
    x = 100 * x
    model = SmoothAffine(x, triangles, csr_matrix((0, len(x))))
    matrix = np.eye(3) + 0.1 * np.random.default_rng(2).normal(size=(3, 3))
    held = x[:, 2] > -20
    moved = model.solve(1e-3, held.astype(float), x @ matrix.T + 7)
    np.testing.assert_allclose(moved[held], (x @ matrix.T + 7)[held], atol=0.05)
    # Held nowhere else, the rest follows, and returns slowly to the start's gradients: within the map's own size.
    error = np.linalg.norm(moved - x @ matrix.T - 7, axis=1)[~held]
    assert error.max() < 0.3 * np.linalg.norm(x @ matrix.T - x, axis=1).max()


def test_where_edges_weigh_more_a_surface_moves_as_one_affine_map():
    x, triangles = geodesic_sphere(5)
    x = 100 * x
    patch = x[:, 2] > 70
    goals = x + 8 * np.sin(x[:, [1, 2, 0]] / 15)
    left = []
    for weight in (1.0, np.where(patch, 30.0, 1.0)):
        moved = SmoothAffine(x, triangles, csr_matrix((0, len(x))), weight).solve(0.1, np.ones(len(x)), goals)[patch]
        affine = np.column_stack([x[patch], np.ones(patch.sum())])
        left.append(np.linalg.norm(moved - affine @ np.linalg.lstsq(affine, moved, rcond=None)[0], axis=1).mean())
    assert left[1] < 0.5 * left[0], left


def test_below_an_open_neck_displacements_fade_to_those_of_the_crown():
    # A tube of rings 5 mm apart, of which the skin has the upper ones: what is harmonic on the rest falls evenly.
    rings, around = 21, 12
    ring, turn = np.divmod(np.arange(rings * around), around)
    angle = 2 * np.pi * turn / around
    x = np.stack([10 * np.cos(angle), 5.0 * ring, -10 * np.sin(angle)], axis=1)
    a = np.arange((rings - 1) * around)
    b = np.where(a % around == around - 1, a + 1 - around, a + 1)
    tube = Surface(x, np.vstack([np.stack([a, b, b + around], axis=1), np.stack([a, b + around, a + around], axis=1)]))
    open_at = 8
    skin = Surface(x, tube.triangles[(ring[tube.triangles] >= open_at).all(axis=1)])
    weights = template_ties(tube, skin, ring == 0)
    np.testing.assert_allclose(np.asarray(weights.sum(axis=1)).ravel(), 1.0)
    moved = (rings - 1 - ring) / (rings - 1 - open_at)
    np.testing.assert_allclose(weights @ moved, np.where(ring < open_at, ring / open_at, moved), atol=1e-6)
    # Without a lid all that is below goes with the opening's edge.
    loose = template_ties(tube, skin, np.zeros(len(x), bool))
    np.testing.assert_allclose(loose @ moved, np.minimum(moved, 1.0), atol=1e-6)


def test_an_open_face_at_any_angle_is_registered_by_its_landmarks(space, person):
    names = landmark_ids(space.mean, space.parts)
    rotation = turned(90, 1) @ turned(180, 2)
    moved = person.vertices @ rotation.T + 500
    points = {name: moved[vertex] for name, vertex in names.items()}
    front = person.vertices[person.triangles][:, :, 2].min(axis=1) > 70
    skin = Surface(moved, person.triangles[front])
    found = register(space.mean, space.parts, skin, landmarks=pair_landmarks(space.mean, space.parts, points))
    off = np.linalg.norm(found.vertices - moved, axis=1)
    assert off[list(names.values())].max() < 3.0
    # Mouth and eye sockets go along, and the missing back keeps a head's size.
    assert off[space.parts == MOUTH].mean() < 4.0
    assert off.max() < 60.0


def test_landmarks_of_both_heads_lie_where_their_names_say(space):
    x = space.mean.vertices[list(landmark_ids(space.mean, space.parts).values())]
    ids = landmark_ids(space.mean, space.parts)
    assert len(set(ids.values())) == len(ids) == 11 and np.isfinite(x).all()
    assert space.mean.vertices[ids["nose tip"], 2] == space.mean.vertices[:, 2].max()
    assert space.mean.vertices[ids["left eye outer"], 0] > 35 > -35 > space.mean.vertices[ids["right eye outer"], 0]


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (lambda s: Surface(s.vertices / 1000, s.triangles), MeshError, "metres: use unit='m'"),
        (lambda s: Surface(s.vertices / 10, s.triangles), MeshError, "centimetres: use unit='cm'"),
        (lambda s: Surface(s.vertices * [-1, 1, 1], s.triangles), MeshError, "mirrored"),
        (lambda s: Surface(100 * geodesic_sphere(12)[0], geodesic_sphere(12)[1]), FitError, "no face found"),
        (lambda s: Surface(s.vertices * [-1, 1, -1], s.triangles), FitError, "no face found.*look along"),
    ],
)
def test_bad_skins_are_named(space, person, spoil, error, message):
    refused(message, register, space.mean, space.parts, spoil(person), error=error)
