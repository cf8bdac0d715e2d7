"""Finer meshes of an unchanged domain."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from softdeca.lhm import TetMesh
from softdeca.lhm.base.errors import MeshError
from softdeca.lhm.base.geometry.tets import smallest_dihedrals
from softdeca.lhm.remesh import refine_head, refine_tets


def test_a_tet_is_split_into_eight_of_its_volume():
    rng = np.random.default_rng(0)
    for _ in range(20):
        x = rng.normal(size=(4, 3))
        tets = np.array([[0, 1, 2, 3]])
        if np.linalg.det(x[1:] - x[0]) < 0:
            tets = tets[:, [0, 2, 1, 3]]
        mesh = TetMesh(x, tets)
        finer, parent = refine_tets(mesh)
        assert finer.volumes == pytest.approx(np.full(8, mesh.volumes[0] / 8))
        assert np.array_equal(parent, np.zeros(8))


def test_refinement_conforms_and_keeps_its_shape(sphere_head):
    mesh = TetMesh(sphere_head.vertices, sphere_head.tets)
    finer, parent = refine_tets(mesh)
    assert np.bincount(parent, finer.volumes) == pytest.approx(mesh.volumes)
    faces = np.sort(finer.tets[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3), axis=1)
    count = np.unique(faces, axis=0, return_counts=True)[1]
    # Inner faces are shared by two tets, and the border's are four times as many as the two spheres'.
    assert count.max() == 2 and np.count_nonzero(count == 1) == 4 * 2 * len(sphere_head.skin.triangles)
    again, _ = refine_tets(finer)
    assert (
        smallest_dihedrals(again.vertices, again.tets).min() > 0.4 * smallest_dihedrals(mesh.vertices, mesh.tets).min()
    )


def test_a_refined_head_has_the_same_surfaces_and_ties(sphere_head):
    head = refine_head(sphere_head)
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


def test_a_head_of_twisted_prisms_is_refined_all_the_same(spheres):
    # A rough skull wrap: the coarse prisms' tets are upright, but between their edges' middles two would not be.
    head = spheres(1, (100.0, 80.0, 60.0))
    rough = 6.0 * np.random.default_rng(8).normal(size=head.skull_wrap.vertices.shape)
    twisted = replace(head, skull_wrap=head.skull_wrap.with_vertices(head.skull_wrap.vertices + rough))
    finer = refine_head(twisted)
    with pytest.raises(MeshError, match="inverted"):
        replace(finer, volume=None)
    assert len(finer.tets) == 8 * len(twisted.tets)
    for new, old in ((finer.soft, twisted.soft), (finer.muscle, twisted.muscle)):
        assert new.volumes.min() >= 0.999 * old.volumes.min() / 8
        assert new.volumes.sum() == pytest.approx(old.volumes.sum())
    # Each wrap is all of one side of its tissue.
    n, faces = len(finer.bone), set()
    for tet in finer.soft.tets:
        for face in combinations(sorted(tet), 3):
            faces ^= {face}
    wraps = np.sort(finer.skin_wrap.triangles, axis=1)
    assert faces == set(map(tuple, np.vstack([wraps, wraps + n])))


def test_a_volume_must_start_with_the_wraps(sphere_head):
    soft, muscle = sphere_head.soft, sphere_head.muscle
    moved = TetMesh(1.01 * soft.vertices, soft.tets)
    with pytest.raises(MeshError, match="volume"):
        replace(sphere_head, volume=(moved, muscle))
    assert replace(sphere_head, volume=(soft, muscle)).soft is soft
