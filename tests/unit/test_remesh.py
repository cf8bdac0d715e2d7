"""Other tets of the layers: each split into eight, or free ones by gmsh, left out by name where that is missing."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from softdeca.lhm import TetMesh
from softdeca.lhm.base.geometry.tets import smallest_dihedrals
from softdeca.lhm.head.remesh import refine_head, refine_tets, remesh
from softdeca.reference import Parameters, facial_scene, solve, terms


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
    # Affine motions are alike on both.
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


@pytest.fixture(scope="module")
def gmsh():
    return pytest.importorskip("gmsh", reason="gmsh is not installed", exc_type=(ImportError, OSError))


def test_the_layers_are_filled_between_unchanged_wraps(gmsh, spheres):
    sphere_head = spheres(2, (100.0, 60.0, 25.0))
    coarse, fine = remesh(sphere_head, 100.0), remesh(sphere_head, 8.0)
    n = len(sphere_head.bone)
    for mesh in (coarse, fine):
        assert np.array_equal(mesh.vertices[: 3 * n], sphere_head.vertices)
        for ours, prisms in ((mesh.soft, sphere_head.soft), (mesh.muscle, sphere_head.muscle)):
            assert ours.volumes.sum() == pytest.approx(prisms.volumes.sum(), rel=1e-9)
        assert smallest_dihedrals(mesh.vertices, mesh.tets).min() > 2.0
    assert len(fine.vertices) > len(coarse.vertices) >= 3 * n
    edges = fine.vertices[fine.tets[:, 1:]] - fine.vertices[fine.tets[:, :1]]
    whole = coarse.vertices[coarse.tets[:, 1:]] - coarse.vertices[coarse.tets[:, :1]]
    assert np.median(np.linalg.norm(edges, axis=2)) < np.median(np.linalg.norm(whole, axis=2))


def test_a_scene_on_it_moves_as_on_prisms(gmsh, sphere_head):
    targets = sphere_head.skin.vertices * [1.0, 1.0, 1.03]
    skins = []
    for head in (sphere_head, remesh(sphere_head, 10.0)):
        scene = facial_scene(head, Parameters(), targets, bones="prescribed", cells="tets")
        # Besides, a guard of the few tets that gmsh may leave flat.
        assert {len(head.soft.tets), len(head.muscle.tets)} <= {len(strain.tets) for strain in scene.of(terms.Strain)}
        solution = solve(scene)
        assert solution.converged
        skins.append(head.skin_after(targets, solution.positions[: len(head.bone)]))
    moved = np.linalg.norm(targets - sphere_head.skin.vertices, axis=1).max()
    # Another mesh of the same space: another discretisation error, but no other answer.
    assert 0.0 < np.abs(skins[0] - skins[1]).max() < 0.25 * moved
