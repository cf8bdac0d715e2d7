"""A fine skin for drawing: smooth, with a scan's detail, its neck cut clean, and moved by the skin alone."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm import Surface, expressions, fit_head, identities, load_template
from softdeca.lhm.base.geometry.bvh import TriangleTree
from softdeca.lhm.base.geometry.subdivision import subdivide_smoothly
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.geometry.topology import is_closed
from softdeca.lhm.head.detail import Detail, FineSkin, count_fine_vertices
from softdeca.lhm.head.file import load_head, save_head
from softdeca.lhm.identities.neck import cut_neck
from softdeca.lhm.identities.space import CAP, rim_of
from softdeca.lhm.scans.detail import POLICY, lay_detail
from softdeca.lhm.scans.own_mesh import OwnMesh
from softdeca.lhm.template.wraps.landmarks import distance_to

SPACE = identities.Anny()
MEAN = SPACE.mean


@pytest.fixture(scope="module")
def template():
    return load_template(level=1)


@pytest.fixture(scope="module")
def fine():
    return FineSkin.from_skin(MEAN)


@pytest.fixture(scope="module")
def plain(template):
    """Fine vertices beyond all in which a scan's detail is not shown, and not at the neck."""
    x = FineSkin.from_skin(MEAN).refine(MEAN.vertices).vertices
    landmarks = template.landmarks
    away = distance_to(x, MEAN.vertices[landmarks.rim]) > POLICY.lips[1] + 3.0
    away &= distance_to(x, MEAN.vertices[landmarks.lids]) > POLICY.lids[1] + 3.0
    return away & (x[:, 2] > np.quantile(x[:, 2], 0.7)) & (x[:, 1] > MEAN.vertices[landmarks.rim, 1].min() - 30.0)


@pytest.fixture(scope="module")
def scan(fine):
    """A scan of finer triangles than the skin's: waves of .8 and 15 mm over the smooth skin."""
    smooth = fine.refine(MEAN.vertices)
    waves = 0.8 * np.sin(smooth.vertices[:, 0] / 2.4) * np.sin(smooth.vertices[:, 1] / 2.4)
    return smooth.with_vertices(smooth.vertices + waves[:, None] * smooth.vertex_normals)


@pytest.fixture(scope="module")
def detail(template, scan):
    return lay_detail(template, MEAN, scan)


# Subdivision


def test_a_sphere_stays_round_and_a_plane_flat():
    x, triangles = geodesic_sphere(6)
    weights, finer = subdivide_smoothly(triangles, len(x))
    assert np.allclose(weights.sum(axis=1), 1.0) and weights.data.min() >= 0.0
    assert is_closed(finer) and len(finer) == 4 * len(triangles)
    radius = np.linalg.norm(weights @ x, axis=1)
    assert np.ptp(radius) < 0.01 and radius.min() > 0.97
    grid = np.array([[i + 0.5 * j, j, 0.0] for j in range(4) for i in range(4)])
    corner = np.array([4 * j + i for j in range(3) for i in range(3)])
    flat = np.vstack([np.stack([corner, corner + 1, corner + 4], 1), np.stack([corner + 1, corner + 5, corner + 4], 1)])
    weights, finer = subdivide_smoothly(flat, len(grid))
    moved = Surface(weights @ grid, finer)
    # An open surface keeps its rim, and so its area.
    assert np.allclose(moved.areas.sum(), Surface(grid, flat).areas.sum()) and (moved.face_normals[:, 2] > 0.0).all()


# The fine skin


def test_the_fine_skin_lies_on_the_skin_and_moves_with_it(fine):
    smooth = fine.refine(MEAN.vertices)
    assert len(smooth.vertices) == count_fine_vertices(MEAN) and is_closed(smooth.triangles)
    face = MEAN.vertices[:, 2] > np.quantile(MEAN.vertices[:, 2], 0.6)
    off = TriangleTree(smooth.vertices, smooth.triangles).closest(MEAN.vertices[face])[2]
    assert off.mean() < 0.3
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    uneven = replace(fine, heights=np.sin(np.arange(len(fine.heights))))
    moved = uneven.refine(MEAN.vertices @ turn.T + [5.0, 0, 0])
    assert np.allclose(moved.vertices, uneven.refine(MEAN.vertices).vertices @ turn.T + [5.0, 0, 0], atol=1e-9)


@pytest.mark.parametrize("seed", [None, 3, 6])
def test_the_neck_ends_in_a_plane(seed):
    skin = MEAN if seed is None else SPACE.sample(np.random.default_rng(seed))[1]
    weights = cut_neck(skin, SPACE.parts)
    assert np.allclose(weights.sum(axis=1), 1.0)
    ended = weights @ skin.vertices
    end = np.append(rim_of(SPACE.triangles, SPACE.parts, CAP), np.flatnonzero(SPACE.parts == CAP))

    def unevenness(x):
        return np.linalg.svd(x - x.mean(axis=0))[1][2] / np.sqrt(len(x))

    assert unevenness(ended[end]) < 1e-9 < unevenness(skin.vertices[end])
    stays = (ended == skin.vertices).all(axis=1)
    assert stays[skin.vertices[:, 1] > np.quantile(skin.vertices[:, 1], 0.15)].all()


def test_a_skin_of_other_triangles_keeps_its_end():
    x, triangles = geodesic_sphere(6)
    assert np.array_equal(FineSkin.from_skin(Surface(100.0 * x, triangles)).end_neck(x), x)


# A scan's detail


def test_detail_brings_the_skin_onto_the_scan(scan, detail, fine, plain):
    tree = TriangleTree(scan.vertices, scan.triangles)
    without, with_detail = (each.refine(MEAN.vertices) for each in (fine, FineSkin.from_skin(MEAN, detail)))
    before, after = (tree.closest(each.vertices[plain])[2] for each in (without, with_detail))
    assert before.mean() > 0.2 and after.mean() < 0.06 and np.quantile(after, 0.95) < 0.2


def test_lips_and_lids_are_the_templates(template, detail, fine):
    x = fine.refine(MEAN.vertices).vertices
    for rim, (least, _) in ((template.landmarks.rim, POLICY.lips), (template.landmarks.lids, POLICY.lids)):
        near = distance_to(x, MEAN.vertices[rim]) < 0.5 * least
        assert near.any() and not detail.heights[near].any()


def test_expressions_carry_the_detail(detail, fine):
    detailed = FineSkin.from_skin(MEAN, detail)
    smile = MEAN.vertices + SPACE.expressions[expressions.index("mouthSmileLeft")]
    smooth, moved = fine.refine(smile), detailed.refine(smile)
    along = np.einsum("kd,kd->k", moved.vertices - smooth.vertices, smooth.vertex_normals)
    assert np.allclose(along, detailed.heights, atol=1e-6)


def test_a_scan_of_noise_folds_nothing(template, fine):
    """Noise of half a millimetre on one side of the head, of five on the other."""
    smooth = fine.refine(MEAN.vertices)
    size = np.where(smooth.vertices[:, :1] > 0.0, 5.0, 0.5)
    noise = np.random.default_rng(0).normal(scale=size, size=smooth.vertices.shape)
    detail = lay_detail(template, MEAN, smooth.with_vertices(smooth.vertices + noise))
    assert np.abs(detail.heights).max() < POLICY.reach
    moved = FineSkin.from_skin(MEAN, detail).refine(MEAN.vertices)
    facing = np.einsum("kd,kd->k", moved.face_normals, smooth.face_normals)
    whole = smooth.areas > 1e-6  # but for those that the neck's plane flattens
    assert (facing[whole] > 0.0).mean() > 0.9999


def test_a_scan_far_away_has_no_detail(template):
    assert not lay_detail(template, MEAN, MEAN.with_vertices(MEAN.vertices + [0.0, 0.0, 500.0])).heights.any()


# In a head and its file


def test_detail_goes_through_the_file_and_heads_without_it_are_smooth(template, tmp_path):
    head = fit_head(template, MEAN)
    save_head(tmp_path / "plain.npz", head)
    plain = load_head(tmp_path / "plain.npz")
    assert plain.detail is None and not plain.fine_skin.heights.any()
    heights = np.random.default_rng(0).normal(size=count_fine_vertices(MEAN)).astype(np.float32)
    save_head(tmp_path / "fine.npz", replace(head, detail=Detail(heights)))
    again = load_head(tmp_path / "fine.npz")
    assert np.array_equal(again.detail.heights, heights) and np.array_equal(again.fine_skin.heights, heights)


# A scan's own mesh


def test_a_mouth_that_is_sealed_and_lids_that_are_shut_are_seen():
    x, triangles = geodesic_sphere(12)
    ball = Surface(90.0 * x, triangles)
    lips = np.array([[-20.0, 0.0, 86.0], [20.0, 0.0, 86.0]])
    opened = Surface(ball.vertices, triangles[(ball.vertices[triangles].mean(axis=1)[:, 2] < 80.0)])
    for surface, is_sealed in ((ball, True), (opened, False)):
        mesh = OwnMesh(surface, None, None)
        assert mesh.has_sealed_mouth(surface.vertices, lips) is is_sealed
    upper = np.where(ball.vertices[:, 1:2] > 0.0, [[0.0, -10.0, 0.0]], 0.0)
    fades = np.clip(ball.vertices[:, 1:2] / 90.0, 0.0, 1.0) * [[0.0, -10.0, 0.0]]
    assert OwnMesh(ball, None, None).has_shut_lids(upper) and not OwnMesh(ball, None, None).has_shut_lids(fades)
