"""Sub-layers of the prisms: they fill the same space and agree where they meet."""

import numpy as np
import pytest

from softdeca.lhm import InputError


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


@pytest.mark.parametrize("counts", [(0, 1), (1, -1)])
def test_counts_below_one_are_refused(sphere_head, counts):
    with pytest.raises(InputError, match="at least 1"):
        sphere_head.sub_layers(*counts)
