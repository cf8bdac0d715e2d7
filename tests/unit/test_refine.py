"""Finer meshes of an unchanged domain."""

import numpy as np
import pytest

from softdeca.lhm import TetMesh
from softdeca.lhm.geometry.quality import smallest_dihedrals
from softdeca.lhm.refine import refined_head, refined_tets


def test_a_tet_is_split_into_eight_of_its_volume():
    rng = np.random.default_rng(0)
    for _ in range(20):
        x = rng.normal(size=(4, 3))
        tets = np.array([[0, 1, 2, 3]])
        if np.linalg.det(x[1:] - x[0]) < 0:
            tets = tets[:, [0, 2, 1, 3]]
        mesh = TetMesh(x, tets)
        finer, parent = refined_tets(mesh)
        assert finer.volumes == pytest.approx(np.full(8, mesh.volumes[0] / 8))
        assert np.array_equal(parent, np.zeros(8))


def test_refinement_conforms_and_keeps_its_shape(sphere_head):
    mesh = TetMesh(sphere_head.vertices, sphere_head.tets)
    finer, parent = refined_tets(mesh)
    assert np.bincount(parent, finer.volumes) == pytest.approx(mesh.volumes)
    faces = np.sort(finer.tets[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3), axis=1)
    count = np.unique(faces, axis=0, return_counts=True)[1]
    # Inner faces are shared by two tets, and the border's are four times as many as the two spheres'.
    assert count.max() == 2 and np.count_nonzero(count == 1) == 4 * 2 * len(sphere_head.skin.triangles)
    again, _ = refined_tets(finer)
    assert (
        smallest_dihedrals(again.vertices, again.tets).min() > 0.4 * smallest_dihedrals(mesh.vertices, mesh.tets).min()
    )


def test_a_refined_head_has_the_same_surfaces_and_ties(sphere_head):
    head = refined_head(sphere_head)
    n = len(sphere_head.bone)
    assert len(head.skin_wrap.triangles) == 4 * len(sphere_head.skin_wrap.triangles)
    assert head.skin_wrap.areas.sum() == pytest.approx(sphere_head.skin_wrap.areas.sum())
    volume = sum(abs(s.volumes.sum()) for s in (head.soft, head.muscle))
    assert volume == pytest.approx(sphere_head.soft.volumes.sum() + sphere_head.muscle.volumes.sum())
    assert np.array_equal(head.skull_wrap.vertices[:n], sphere_head.skull_wrap.vertices)
    assert np.array_equal(head.bone[:n], sphere_head.bone) and set(head.bone[n:]) == {0, 1, 2}
    # What moves affinely moves alike on both.
    expression = head.skin.vertices @ np.diag([1.0, 1.1, 0.9])
    moved = head.wrap_targets(expression)
    assert moved[:n] == pytest.approx(sphere_head.wrap_targets(expression))
    assert head.skin_after(expression, moved) == pytest.approx(expression)
