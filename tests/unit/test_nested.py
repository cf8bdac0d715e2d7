"""A fine mesh's start from the answer on a coarser one: what is carried over, what is mended, and what it saves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import identity

from softdeca.lhm.base.geometry.topology import subdivide
from softdeca.lhm.base.mesh import Surface, tet_volumes
from softdeca.lhm.head import LayeredHead
from softdeca.lhm.remesh import refine_head
from softdeca.reference import Parameters, SceneError, apply_law, facial_scene, nested_start, solve

LAYERS = (2, 3)


@pytest.fixture(scope="module")
def heads(spheres):
    """A head of spheres, and one of its level's next."""
    coarse = spheres(2)
    finer, triangles = subdivide(coarse.skin_wrap.vertices, coarse.skin_wrap.triangles)
    unit = finer / np.linalg.norm(finer, axis=1, keepdims=True)
    wraps = [Surface(radius * unit, triangles) for radius in (100.0, 92.0, 85.0)]
    bone = np.where(unit[:, 1] > 0.0, 1, np.where(unit[:, 1] < -0.8, 2, 0))
    same = identity(len(unit), format="csr")
    return coarse, LayeredHead(wraps[0], *wraps, bone, same, same)


def pulled(head):
    """A skin drawn down and aside below its equator."""
    down = np.clip(-head.skin.vertices[:, 1:2] / 100.0, 0.0, 1.0)
    return head.skin.vertices + down**2 * [6.0, -12.0, 4.0]


def scene_of(head, layers=(1, 1)):
    return apply_law(facial_scene(head, Parameters(), pulled(head), bones="prescribed", layers=layers), "neo-Hookean")


def test_displacements_are_carried_over(heads):
    coarse, fine = heads
    gradient = np.array([[0.02, 0.01, 0.0], [0.0, -0.03, 0.01], [0.02, 0.0, 0.01]])
    scene = scene_of(fine, LAYERS)
    found = nested_start(scene, fine, coarse.vertices + coarse.vertices @ gradient, coarse, layers=LAYERS)
    moved, n = (found - scene.vertices).reshape(-1, len(fine.bone), 3), len(coarse.bone)
    rest = scene.vertices.reshape(moved.shape)
    np.testing.assert_allclose(moved[:, :n], rest[:, :n] @ gradient, atol=1e-12)  # linear, and so it is between wraps
    assert np.abs(moved - rest @ gradient).max() < 0.1  # an edge's middle is off the sphere


def test_the_answer_is_the_same_for_fewer_iterations(heads):
    pytest.importorskip("dolfinx")
    coarse, fine = heads
    scene = scene_of(fine, LAYERS)
    near = solve(scene_of(coarse), solver="fenicsx", tolerance=1e-4)
    start = nested_start(scene, fine, near.positions, coarse, layers=LAYERS)
    from_rest, nested = (solve(scene, solver="fenicsx", start=at, absolute=1e-5) for at in (None, start))
    assert from_rest.converged and nested.converged
    np.testing.assert_allclose(nested.positions, from_rest.positions, atol=1e-6)
    assert nested.iterations < from_rest.iterations


def test_crushed_tets_are_mended(heads):
    coarse, fine = heads
    scene = scene_of(fine)
    rng = np.random.default_rng(0)
    positions = coarse.vertices + rng.normal(0.0, 2.5, coarse.vertices.shape)
    start = nested_start(scene, fine, positions, coarse)
    n, count = len(coarse.bone), len(fine.bone)
    kept = np.concatenate([layer * count + np.arange(n) for layer in range(3)])
    assert np.abs(start[kept] - scene.vertices[kept] - (positions - coarse.vertices)).max() > 1e-3  # some were moved
    assert (tet_volumes(start, scene.tets) > 0.0).all()


def test_what_is_not_nested_is_refused(heads):
    coarse, fine = heads
    scene = scene_of(fine)
    with pytest.raises(SceneError, match="positions: expected shape"):
        nested_start(scene, fine, coarse.vertices[1:], coarse)
    with pytest.raises(SceneError, match="split into four"):
        nested_start(scene_of(coarse), coarse, fine.vertices, fine)
    with pytest.raises(SceneError, match="scene: expected"):
        nested_start(scene, fine, coarse.vertices, coarse, layers=LAYERS)
    with pytest.raises(SceneError, match="volume mesh"):
        nested_start(scene, fine, coarse.vertices, refine_head(replace(coarse)))
