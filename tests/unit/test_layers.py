"""Sub-layers of the prisms: they fill the same space and agree where they meet."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm import MeshError
from softdeca.lhm.base.geometry.tets import untangle
from softdeca.lhm.base.mesh import tet_volumes
from softdeca.lhm.head.layers import prism_tets, stack_wraps
from softdeca.reference.face.tissue import Stack

from ..refusals import refused


def outer_faces(tets):
    faces = np.sort(tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    unique, count = np.unique(faces, axis=0, return_counts=True)
    assert count.max() <= 2
    return unique[count == 1]


def test_one_layer_each_is_the_head(sphere_head):
    soft, muscle = sphere_head.sub_layers(1, 1)
    assert np.array_equal(soft.tets, sphere_head.soft.tets)
    assert np.array_equal(muscle.vertices, sphere_head.vertices)


@pytest.mark.parametrize("counts", [(2, 1), (1, 3), (4, 2)])
def test_sub_layers_fill_the_same_space(sphere_head, counts):
    soft, muscle = sphere_head.sub_layers(*counts)
    triangles, n = len(sphere_head.skin_wrap.triangles), len(sphere_head.bone)
    assert len(soft.vertices) == (1 + sum(counts)) * n
    assert len(soft.tets) == 3 * triangles * counts[0]
    # The boundary is still both wraps, so the volume is too.
    whole = sphere_head.soft.volumes.sum() + sphere_head.muscle.volumes.sum()
    assert soft.volumes.sum() + muscle.volumes.sum() == pytest.approx(whole, rel=1e-9)
    assert len(outer_faces(np.vstack([soft.tets, muscle.tets]))) == 2 * triangles


def test_sub_layers_of_twisted_prisms_are_upright(spheres):
    # A rough skull wrap: the prisms' tets are upright, but not those between vertices spaced evenly.
    head = spheres(1, (100.0, 80.0, 60.0))
    rough = 7.5 * np.random.default_rng(14).normal(size=head.skull_wrap.vertices.shape)
    head = replace(head, skull_wrap=head.skull_wrap.with_vertices(head.skull_wrap.vertices + rough))
    wraps = [wrap.vertices for wrap in (head.skin_wrap, head.muscle_wrap, head.skull_wrap)]
    n, triangles = len(head.bone), head.skin_wrap.triangles
    even = stack_wraps(wraps, (1, 4))
    inverted = [tet_volumes(even, prism_tets(triangles, k * n, (k + 1) * n)).min() <= 0 for k in range(5)]
    assert any(inverted)
    soft, muscle = head.sub_layers(1, 4)
    assert soft.volumes.sum() == pytest.approx(head.soft.volumes.sum())
    assert muscle.volumes.sum() == pytest.approx(head.muscle.volumes.sum())
    for k, wrap in ((0, 0), (1, 1), (5, 2)):
        assert np.array_equal(soft.vertices[k * n : (k + 1) * n], wraps[wrap])
    # A scene's start at rest is the rest of the mesh, not the even one.
    assert Stack.from_head(head, (1, 4), ()).interpolate(*wraps) == pytest.approx(soft.vertices)


def test_a_tet_that_nothing_may_move_stays_and_is_told():
    x, tet = np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 2, 1, 3]])
    assert tet_volumes(x, tet) < 0
    refused("1 stay inverted", untangle, x, tet, np.zeros(4, dtype=bool), np.array([0.1]), error=MeshError)
    # With one corner free the tet reaches the volume asked for, and the others stay.
    moved = untangle(x, tet, np.arange(4) == 3, np.array([0.1]))
    assert tet_volumes(moved, tet) == pytest.approx([0.1], rel=1e-3) and np.array_equal(moved[:3], x[:3])
