"""Deformation transfer: exact for integrable gradients, whatever the reference mesh."""

import numpy as np
import pytest

from softdeca.lhm import MeshError, Surface
from softdeca.lhm.base.geometry import cholesky
from softdeca.lhm.base.geometry.deformation import DeformationTransfer, deformation_gradients, sumner_frames


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


def test_superlu_stands_in_for_cholespy(case, monkeypatch):
    reference, before, after, still = case
    gradients = minus_identity(deformation_gradients(before, after, reference.triangles))
    with_cholespy = DeformationTransfer(reference, still).delta(gradients, before[None])
    monkeypatch.setattr(cholesky, "CholeskySolverD", None)
    without = DeformationTransfer(reference, still).delta(gradients, before[None])
    np.testing.assert_allclose(without, with_cholespy, atol=1e-9)


def test_a_part_without_an_anchor_is_named(sphere_head):
    skin = sphere_head.skin
    n = len(skin.vertices)
    two = Surface(np.vstack([skin.vertices, skin.vertices + 300.0]), np.vstack([skin.triangles, skin.triangles + n]))
    with pytest.raises(MeshError, match=f"vertex {n} "):
        DeformationTransfer(two, [0])


def test_a_flat_reference_triangle_is_named(sphere_head):
    vertices = sphere_head.skin.vertices.copy()
    i, j, k = sphere_head.skin.triangles[7]
    vertices[k] = 0.5 * (vertices[i] + vertices[j])
    with pytest.raises(MeshError, match="no area"):
        DeformationTransfer(sphere_head.skin.with_vertices(vertices), [0])
