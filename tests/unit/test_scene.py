"""Meshes, scenes and terms are checked when made, and errors name the thing."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm import MeshError, TetMesh
from softdeca.lhm.base.mesh import tet_volumes
from softdeca.lhm.head.layers import prism_tets
from softdeca.reference import Scene, SceneError, terms
from softdeca.reference.problems.meshes import box
from softdeca.reference.solution import volume_ratio

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
TETS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])


def test_tet_mesh_names_the_inverted_and_the_flat_tet():
    assert TetMesh(CORNERS, TETS).volumes == pytest.approx([1 / 6, 1 / 3])
    with pytest.raises(MeshError, match="first is number 1 .*volume -0.333"):
        TetMesh(CORNERS, [[0, 1, 2, 3], [1, 3, 2, 4]])
    with pytest.raises(MeshError, match="inverted or flat"):
        TetMesh(np.vstack([CORNERS, [[0.5, 0.5, 0]]]), [[0, 1, 2, 5]])


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_a_thin_tet_is_accepted_whatever_the_unit(size):
    TetMesh(size * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 6e-12]]), [[0, 1, 2, 3]])


def test_prisms_are_positive_and_neighbours_share_their_faces(sphere_head):
    head = sphere_head
    volumes = np.concatenate([head.soft.volumes, head.muscle.volumes])
    assert (volumes > 0).all()

    # The polyhedra between inscribed triangulated spheres: the volume of the outer less the inner one.
    def enclosed(surface):
        a, b, c = (surface.vertices[surface.triangles[:, k]] for k in range(3))
        return np.einsum("ij,ij->", np.cross(a, b), c) / 6

    assert head.soft.volumes.sum() == pytest.approx(enclosed(head.skin_wrap) - enclosed(head.muscle_wrap), rel=1e-12)
    faces = np.sort(np.vstack([head.tets[:, c] for c in ([0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3])]), axis=1)
    counts = np.unique(faces, axis=0, return_counts=True)[1]
    assert counts.max() == 2
    assert (counts == 1).sum() == 2 * len(head.skin_wrap.triangles)


def test_prism_split_handles_every_order_of_corners():
    for corners in ([0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]):
        outer = np.empty((3, 3))
        outer[corners] = [[0, 0, 1], [1, 0, 1], [0, 1, 1]]  # counter-clockwise seen from above, the outside
        vertices = np.vstack([outer, outer - [0, 0, 1]])
        assert TetMesh(vertices, prism_tets(np.array([corners]), 0, 3)).volumes.sum() == pytest.approx(0.5)


PRISM = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1]])
THREE = np.vstack([prism_tets(np.array([[0, 1, 2]]), 3, 0), [[1, 2, 5, 6]]])


def test_a_prism_of_three_tets_has_one_deformation():
    """Its mean over the prism is the mean over the triangles around it; an affine motion is seen as it is."""
    rng = np.random.default_rng(0)
    scene = Scene(np.vstack([PRISM, [[2.0, 2, 2]]]), THREE, [terms.Strain([1.0], tets=[[2, 0, 1]])])
    (A, moved) = rng.normal(size=(3, 3)), scene.vertices + 0.1 * rng.normal(size=(7, 3))
    cells = scene.prism_cells
    assert cells.vertices.tolist() == [[0, 1, 2, 3, 4, 5]] and cells.volumes == pytest.approx([0.5])
    np.testing.assert_allclose(cells.deformation(scene.vertices @ A.T + 1.0), [A], atol=1e-14)
    tets = terms.Cells.from_mesh(scene, np.arange(3)).deformation(moved)
    np.testing.assert_allclose(cells.deformation(moved), [tets.mean(axis=0)], atol=1e-14)
    np.testing.assert_allclose(volume_ratio(scene, moved)[:3], np.linalg.det(tets.mean(axis=0)))
    assert volume_ratio(scene, moved)[3] == pytest.approx(tet_volumes(moved, THREE)[3] / scene.volumes[3])


def test_held_components_and_their_conflicts():
    rollers = terms.Fixed([0, 2], components=(0,))
    moved = terms.Fixed([0], [[9.0, 0.5, 9.0]], components="y")
    held, positions = Scene(CORNERS, TETS, [rollers, moved]).dirichlet()
    assert held.sum() == 3 and held[0].tolist() == [True, True, False]
    assert positions[0].tolist() == [0.0, 0.5, 0.0]
    with pytest.raises(SceneError, match="vertex 0 is held at two places in component 0"):
        Scene(CORNERS, TETS, [rollers, terms.Fixed([0], [[1.0, 0, 0]])])


def test_dead_loads_sum_to_weight_and_traction():
    scene = Scene(CORNERS, TETS, [terms.Gravity((0, -9810, 0), 2e-6), terms.Traction([[0, 1, 2]], (3.0, 0, 0))])
    assert scene.loads().sum(axis=0) == pytest.approx([3.0 / 2, -9810 * 2e-6 / 2, 0.0])


def test_no_tet_is_overlooked_among_many():
    vertices, tets = box((6, 5, 4), (1.0, 1.0, 1.0))
    assert len(TetMesh(vertices, tets).tets) == len(tets)
    rng = np.random.default_rng(0)
    for first in rng.integers(len(tets), size=50):
        even = [[0, 1, 2, 3], [1, 2, 0, 3], [3, 2, 1, 0]][rng.integers(3)]
        with pytest.raises(MeshError, match=f"number {len(tets)} is number {first} again"):
            TetMesh(vertices, np.vstack([tets, tets[first][even]]))


def test_a_mask_has_a_value_for_each_vertex():
    with pytest.raises(SceneError, match="is a mask of"):
        Scene(CORNERS, TETS, [terms.Fixed([True, True])])
    whole = terms.Fixed(np.arange(5) < 2)
    assert Scene(CORNERS, TETS, [whole]).terms[0].vertices.tolist() == [0, 1]
    assert Scene(CORNERS, TETS, [replace(whole, vertices=[0, 4])]).terms[0].vertices.tolist() == [0, 4]
