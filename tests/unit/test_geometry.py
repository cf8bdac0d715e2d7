"""Compiled geometry against closed forms and brute force; deformation transfer, exact for integrable gradients."""

import numpy as np
import pytest
import trimesh

from softdeca.lhm import MeshError, Surface
from softdeca.lhm.base.geometry.bvh import TriangleTree
from softdeca.lhm.base.geometry.deformation import DeformationTransfer, deformation_gradients, sumner_frames
from softdeca.lhm.base.geometry.distance import SignedDistance
from softdeca.lhm.base.geometry.rays import first_hits
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.geometry.tets import smallest_dihedrals
from softdeca.lhm.base.geometry.topology import across_edges, find_openings, subdivide
from softdeca.lhm.base.geometry.triangles import triangles_cross
from softdeca.lhm.base.geometry.warp import TriharmonicWarp, farthest_points, rigid_motion
from softdeca.lhm.identities.cut import cut_and_close
from softdeca.lhm.template.wraps.depth import inscribed_radius
from softdeca.lhm.template.wraps.landmarks import jaw_share

from ..refusals import refused

FLAT = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0]])


@pytest.mark.parametrize(
    ("other", "crosses"),
    [
        ([[1, 1, -1], [1, 1, 1], [3, 3, 1]], True),  # pierces the inside
        ([[3, 3, -1], [3, 3, 1], [5, 5, 1]], False),  # passes beyond the long edge
        ([[1, 1, 0.1], [2, 1, 1], [1, 2, 1]], False),  # hovers above
        ([[1, 1, 0], [2, 1, 1], [1, 2, 1]], True),  # touches with a corner
        ([[-1, 1, 0.5], [5, 1, 0.5], [1, 1, -0.5]], True),  # an edge of each meets the other
        ([[0, 0, 1], [4, 0, 1], [0, 4, 1]], False),  # parallel
        ([[10, 0, 0], [14, 0, 0], [10, 4, 0]], False),  # coplanar and apart
    ],
)
def test_triangles_that_cross_and_that_do_not(other, crosses):
    other = np.array(other, dtype=float)
    for a, b in ((FLAT, other), (other, FLAT)):
        assert triangles_cross(a, b) == crosses
        assert triangles_cross(a[[1, 2, 0]], b[[2, 1, 0]]) == crosses


DEGENERATE = {"a point": [0, 0, 0], "a corner twice": [0, 0, 1], "another twice": [0, 1, 1], "the third": [0, 1, 0]}


@pytest.mark.parametrize("name", DEGENERATE)
def test_a_triangle_without_area_is_its_edges_and_crosses_nothing(name):
    rng = np.random.default_rng(0)
    ends = rng.normal(size=(2, 3))
    corners = ends[DEGENERATE[name]]
    other = np.array([[-9.0, -9, 0.1], [9, -9, 0.1], [0, 9, 0.1]])
    assert not triangles_cross(corners, other) and not triangles_cross(other, corners)
    assert not triangles_cross(corners, corners)
    start, way = corners[0], corners[np.abs(corners - corners[0]).sum(axis=1).argmax()] - corners[0]
    tree = TriangleTree(corners, np.array([[0, 1, 2]]))
    # On its line, before, within and beyond it, and anywhere; also at its corners.
    points = np.vstack([start + np.linspace(-1, 2, 13)[:, None] * way, rng.normal(size=(200, 3)), corners])
    share = np.clip((points - start) @ way / max(way @ way, 1e-30), 0.0, 1.0)
    weights, distance = tree.closest(points)[1:]
    np.testing.assert_allclose(distance, np.linalg.norm(points - start - share[:, None] * way, axis=1), atol=1e-12)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    # A ray along the line of it, too.
    first_hits(tree, points, np.tile(way + 0.0, (len(points), 1)), 100.0)


def test_tree_finds_the_crossings_that_brute_force_finds():
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(150, 1, 3)) * 3 + rng.normal(size=(150, 3, 3))
    tree = TriangleTree(corners.reshape(-1, 3), np.arange(450).reshape(-1, 3))
    brute = {(i, j) for i in range(150) for j in range(i + 1, 150) if triangles_cross(corners[i], corners[j])}
    assert len(brute) > 30
    assert {tuple(pair) for pair in tree.self_crossings()} == brute


def test_crossing_spheres_and_nested_spheres():
    x, triangles = geodesic_sphere(6)
    inner, outer, shifted = (TriangleTree(v, triangles) for v in (x, 2 * x, 2 * x + [2.5, 0, 0]))
    assert len(outer.self_crossings()) == 0
    assert len(inner.crossings(outer)) == 0
    assert len(outer.crossings(shifted)) > 10


def test_closest_points_against_the_sphere_and_brute_force():
    x, triangles = geodesic_sphere(8)
    points = np.random.default_rng(1).normal(size=(300, 3)) * 2
    triangle, weights, distance = TriangleTree(x, triangles).closest(points)
    closest = np.einsum("kc,kcd->kd", weights, x[triangles[triangle]])
    np.testing.assert_allclose(np.linalg.norm(points - closest, axis=1), distance, atol=1e-12)
    # Barycentric samples of all triangles come no closer, and not much farther.
    grid = np.array([(i, j, 12 - i - j) for i in range(13) for j in range(13 - i)]) / 12
    samples = np.einsum("sc,mcd->msd", grid, x[triangles]).reshape(-1, 3)
    sampled = np.array([np.linalg.norm(samples - p, axis=1).min() for p in points])
    assert (distance <= sampled + 1e-12).all() and (sampled - distance).max() < 0.02


def test_signed_distance_to_a_box_has_the_right_sign_at_edges_and_corners():
    box = trimesh.creation.box(extents=(2, 2, 2))
    distance = SignedDistance(Surface(box.vertices, box.faces))
    points = np.random.default_rng(2).uniform(-2, 2, size=(2000, 3))
    q = np.abs(points) - 1
    exact = np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)
    phi, direction, _, _ = distance(points)
    np.testing.assert_allclose(phi, exact, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(distance(points - (phi * 0.5)[:, None] * direction)[0], 0.5 * exact, atol=1e-9)


def test_triangles_across_edges_share_them():
    _, triangles = geodesic_sphere(3)
    across = across_edges(triangles)
    for k in range(3):
        edge = np.sort(triangles[:, [k, (k + 1) % 3]], axis=1)
        assert all(set(e) <= set(triangles[o]) for e, o in zip(edge, across[:, k], strict=True))
        assert (across[:, k] != np.arange(len(triangles))).all()


def test_geodesic_sphere_of_frequency_22_has_the_wraps_counts():
    x, triangles = subdivide(*geodesic_sphere(11))
    assert (len(x), len(triangles)) == (4842, 9680)
    mesh = trimesh.Trimesh(x, triangles, process=False)
    assert mesh.is_watertight and mesh.euler_number == 2 and mesh.volume > 0.95 * 4 / 3 * np.pi


def test_dihedrals_of_known_tets():
    regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    angles = smallest_dihedrals(np.vstack([regular, corner]), np.array([[0, 1, 2, 3], [4, 5, 6, 7]]))
    np.testing.assert_allclose(angles, np.degrees([np.arccos(1 / 3), np.arccos(1 / np.sqrt(3))]), atol=1e-9)


def test_warp_reproduces_affine_maps_and_interpolates():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(200, 3)) * 80
    warp = TriharmonicWarp(points[:60])
    matrix, shift = rng.normal(size=(3, 3)) * 0.2, np.array([5.0, -3, 2])
    displaced = warp.basis(points) @ warp.coefficients(points[:60] @ matrix + shift)
    np.testing.assert_allclose(displaced, points @ matrix + shift, atol=1e-7)
    wanted = rng.normal(size=(60, 3))
    np.testing.assert_allclose(warp.basis(points[:60]) @ warp.coefficients(wanted), wanted, atol=1e-7)


def test_farthest_points_keep_the_first_and_spread():
    line = np.column_stack([np.linspace(0, 10, 11), np.zeros((11, 2))])
    assert farthest_points(line, 3, np.array([0])).tolist() == [0, 10, 5]


def test_inscribed_ball_of_a_sphere_and_of_a_slab():
    x, _ = geodesic_sphere(8)
    np.testing.assert_allclose(inscribed_radius(7 * x, x, 40.0), 7.0, rtol=1e-9)
    grid = np.stack(np.meshgrid(np.arange(12.0), np.arange(12.0)), axis=-1).reshape(-1, 2) * 0.5
    up = np.tile([0.0, 0, 1], (144, 1))
    slab = np.vstack([np.column_stack([grid, np.full(144, 2.0)]), np.column_stack([grid, np.zeros(144)])])
    np.testing.assert_allclose(inscribed_radius(slab, np.vstack([up, -up]), 40.0), 1.0, rtol=1e-9)


def test_cut_cylinder_is_closed_by_its_lid_and_two_holes_are_refused():
    tube = trimesh.creation.cylinder(radius=1, height=2, sections=24)
    lower = tube.vertices[tube.faces].max(axis=1)[:, 2] < 1 - 1e-9
    upper = ~lower & (np.ptp(tube.vertices[tube.faces][:, :, 2], axis=1) < 1e-9)
    open_above = np.asarray(tube.faces)[~upper]
    weights, triangles, kept = cut_and_close(open_above, len(tube.vertices))
    closed = trimesh.Trimesh(weights @ tube.vertices, triangles, process=False)
    assert closed.is_watertight and closed.euler_number == 2 and closed.volume > 0
    np.testing.assert_allclose(np.asarray(weights.sum(axis=1)).ravel(), 1)
    assert kept.max() < len(tube.vertices)
    sides = open_above[np.ptp(tube.vertices[open_above][:, :, 2], axis=1) > 1e-9]
    assert len(find_openings(sides)) == 2
    refused("found 2", cut_and_close, sides, len(tube.vertices), error=MeshError)


def test_rigid_motion_and_share_of_a_known_rotation():
    rng = np.random.default_rng(4)
    rest = rng.normal(size=(400, 3)) * 30
    angle = 0.3
    rotation = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    found, translation = rigid_motion(rest, rest @ rotation.T + [1, 2, 3])
    np.testing.assert_allclose(found, rotation, atol=1e-12)
    np.testing.assert_allclose(translation, [1, 2, 3], atol=1e-10)
    follows = rest[:, 1] < 0
    opened = rest + np.where(follows, 1.0, 0.0)[:, None] * (rest @ rotation.T + [0, -8, 0] - rest)
    share = jaw_share(rest, opened, np.ones(400, bool))
    np.testing.assert_allclose(share[follows], 1, atol=1e-9)
    np.testing.assert_allclose(share[~follows], 0, atol=1e-12)


def bent(vertices, amount):
    """A smooth map of space that leaves the half y < -50 where it is."""
    lift = np.clip((vertices[:, 1] + 50.0) / 100.0, 0.0, None) ** 3
    moved = vertices.copy()
    moved[:, 0] += amount * lift * np.sin(vertices[:, 2] / 40.0)
    moved[:, 2] += 2.0 * amount * lift
    return moved


@pytest.fixture(scope="module")
def case(sphere_head):
    skin = sphere_head.skin
    rng = np.random.default_rng(3)
    reference = skin.with_vertices(skin.vertices * [1.0, 1.2, 0.9] + rng.normal(0.0, 1.0, skin.vertices.shape))
    return reference, skin.vertices, bent(skin.vertices, 8.0), np.flatnonzero(skin.vertices[:, 1] < -50.0)


def minus_identity(gradients):
    return (gradients - np.eye(3)).reshape(1, -1, 9)


def test_integrable_gradients_give_their_surface(case):
    reference, before, after, still = case
    transfer = DeformationTransfer(reference, still)
    gradients = minus_identity(deformation_gradients(before, after, reference.triangles))
    assert np.abs(after - before).max() > 10.0
    assert np.abs(before + transfer.delta(gradients, before[None])[0] - after).max() < 1e-9


def test_single_precision_is_good_to_a_micrometre(case):
    reference, before, after, still = case
    transfer = DeformationTransfer(reference, still, dtype=np.float32)
    gradients = minus_identity(deformation_gradients(before, after, reference.triangles)).astype(np.float32)
    answer = before + transfer.delta(gradients, before[None].astype(np.float32))[0]
    assert np.abs(answer - after).max() < 1e-3


def test_identity_gradients_leave_the_skin(case):
    reference, before, _, still = case
    zero = np.zeros((2, len(reference.triangles), 9))
    assert np.all(DeformationTransfer(reference, still).delta(zero, np.stack([before, before])) == 0.0)


def test_gradients_of_a_linear_map_are_the_map(case):
    reference, before, _, _ = case
    rotation = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    gradients = deformation_gradients(before, before @ rotation.T, reference.triangles)
    assert np.abs(gradients - rotation).max() < 1e-12
    frames = sumner_frames(before, reference.triangles)
    assert np.all(np.linalg.det(frames) > 0)


def test_pull_back_is_the_transpose(case):
    reference, before, _, still = case
    transfer = DeformationTransfer(reference, still)
    rng = np.random.default_rng(0)
    blended = np.stack([before, before * 1.1])
    gradients = rng.normal(size=(2, len(reference.triangles), 9))
    cotangent = rng.normal(size=blended.shape)
    forward = (transfer.delta(gradients, blended) * cotangent).sum()
    backward = (transfer.pull_back(cotangent, blended) * gradients).sum()
    assert forward == pytest.approx(backward, rel=1e-10)


def test_edges_of_a_motion_give_it_back(case):
    reference, before, after, still = case
    motion = np.stack([after - before, 0.5 * (before - after)])
    corners = motion[:, reference.triangles]
    edges = corners[:, :, 1:] - corners[:, :, :1]
    np.testing.assert_allclose(DeformationTransfer(reference, still).displacements(edges), motion, atol=1e-9)
