"""A facial scene's tets: guards of thin ones, connecting tets, volume meshes, and a start on a finer mesh."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import identity

from softdeca.lhm import fit_head, identities, load_template
from softdeca.lhm.base.geometry.topology import subdivide
from softdeca.lhm.base.mesh import Surface, tet_volumes
from softdeca.lhm.head.head import LayeredHead
from softdeca.lhm.head.remesh import refine_head
from softdeca.reference import Parameters, Scene, apply_law, facial_scene, nested_start, solve, terms
from softdeca.reference.face.tissue import POLICY, Guard, Stack, connecting_tets, group_cells, guard_stiffness, on_cells

# The heights of a corner cut off a cube: its legs are a long, and the one over the slanted face is a / sqrt(3).
CORNER = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def test_stiffness_of_guards_grows_as_tets_get_thinner():
    scales = np.sqrt(3.0) * POLICY.guarded_height * np.array([0.5, 2.0, 0.1])
    vertices = np.vstack([scale * CORNER for scale in scales])
    stiffness = guard_stiffness(vertices, np.arange(12).reshape(3, 4), np.array([2.0, 2.0, 3.0]))
    assert stiffness == pytest.approx(POLICY.guard_stiffness * np.array([2.0, 0.0, 27.0]))


def test_cells_are_whole_prisms_and_what_is_left_of_others():
    kept = np.array([1, 1, 1, 0, 1, 0, 1, 1, 1], dtype=bool)
    prisms, alone = group_cells(kept, "prisms")
    assert prisms.tolist() == [[0, 1, 2], [4, 5, 6]] and alone.tolist() == [3]
    assert [cells.tolist() for cells in group_cells(kept, "tets")] == [list(range(7))]
    values, volumes = np.array([1.0, 1.0, 1.0, 5.0, 0.0, 0.0, 8.0]), np.array([0.1, 0.2, 0.3, 1.0, 1.0, 2.0, 1.0])
    assert on_cells(values, prisms, volumes) == pytest.approx([1.0, 2.0])
    assert on_cells(values, alone, volumes) == pytest.approx([5.0]) and on_cells(3.0, prisms, volumes) == 3.0


def test_what_no_guard_is_for_stays_as_it_was(spheres):
    """Targets that stretch nothing threefold: the same answer without the guard, which only thin layers have."""
    assert not facial_scene(spheres(), Parameters(), spheres().skin.vertices).of(Guard)
    scene = _dragged(spheres, 3.0)
    guarded, plain = (solve(one, tolerance=1e-9) for one in (scene, _unguarded(scene)))
    assert np.abs(guarded.positions - plain.positions).max() < 1e-6
    assert _unguarded(scene).of(terms.Volume) and not apply_law(scene, "neo-Hookean").of(terms.Strain)


@pytest.mark.parametrize("solver", ["fenicsx", "skfem"])
def test_dragged_layers_are_kept_from_inversion_alike(spheres, solver):
    """A spot of skin dragged over the bone and into it: the guard acts, and to every solver as to the first."""
    pytest.importorskip("dolfinx" if solver == "fenicsx" else "skfem")
    scene = _dragged(spheres, 9.0)
    guarded, plain = (solve(one, tolerance=1e-9) for one in (scene, _unguarded(scene)))
    assert guarded.volume_ratio.min() > 1.5 * plain.volume_ratio.min() > 0.0
    other = solve(scene, solver=solver, tolerance=1e-9)
    assert other.converged and np.abs(other.positions - guarded.positions).max() < 1e-4


def _dragged(spheres, distance: float) -> Scene:
    """Layers of 2 mm each, with a spot of skin at the front dragged sideways and inward."""
    head = spheres(2, (30.0, 28.0, 26.0))
    skin = head.skin.vertices
    share = np.exp(-((skin - [0.0, 0.0, 30.0]) ** 2).sum(axis=1) / 20.0)[:, None]
    targets = skin - share * [0.8 * distance, 0.0, 0.5 * distance]
    return facial_scene(head, Parameters(target_stiffness=30.0), targets, cells="tets")


def _unguarded(scene: Scene) -> Scene:
    kept = tuple(term for term in scene.terms if not isinstance(term, Guard))
    assert len(kept) == len(scene.terms) - 1
    return Scene(scene.vertices, scene.tets, kept)


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


def test_connecting_tets_are_sound_and_hold_their_points(sphere_head):
    wrap = sphere_head.skull_wrap
    rng = np.random.default_rng(0)
    points = wrap.vertices[rng.choice(len(wrap.vertices), 50, replace=False)] * 0.97
    triangles, tets = connecting_tets(points, wrap)
    stack = np.vstack([wrap.vertices, points])
    edges = stack[tets[:, 1:]] - stack[tets[:, :1]]
    mean = np.linalg.norm(np.diff(stack[wrap.triangles[triangles]], axis=1, append=0)[:, :2], axis=2).mean(axis=1)
    assert np.all(np.linalg.det(edges) > 0.015 * mean**3)
    assert np.array_equal(np.sort(tets, axis=1)[:, 3], len(wrap.vertices) + np.arange(50))


def test_a_head_of_a_volume_mesh_has_the_same_scene(sphere_head):
    # Its own prisms, told as a volume.
    head = replace(sphere_head, volume=(sphere_head.soft, sphere_head.muscle))
    targets = head.skin.vertices * 1.05
    own, told = (facial_scene(h, Parameters(), targets, bones="prescribed", cells="tets") for h in (sphere_head, head))
    assert np.array_equal(own.tets, told.tets) and np.array_equal(own.vertices, told.vertices)
    for a, b in zip(own.terms, told.terms, strict=True):
        assert type(a) is type(b)
    assert np.array_equal(own.of(terms.Fixed)[0].vertices, told.of(terms.Fixed)[0].vertices)
    assert np.array_equal(own.of(terms.Strain)[1].tets, told.of(terms.Strain)[1].tets)
    merged = facial_scene(head, Parameters(), targets, without=("muscle",))
    assert len(merged.of(terms.Strain)) == 1 and len(merged.tets) == len(own.tets)


def test_a_volume_mesh_is_carried_with_its_wraps(sphere_head):
    head = refine_head(sphere_head)
    stack = Stack.from_head(head, (1, 1), ())
    wraps = [wrap.vertices for wrap in (head.skin_wrap, head.muscle_wrap, head.skull_wrap)]
    assert stack.interpolate(*wraps) == pytest.approx(head.vertices)
    shift = np.array([1.0, -2.0, 3.0])
    assert stack.interpolate(*(wrap + shift for wrap in wraps)) == pytest.approx(head.vertices + shift)
    assert stack.first_of_skull == 2 * len(head.bone)


def test_prisms_that_fold_without_the_muscle_wrap_are_few_and_left_out():
    head = fit_head(load_template(), identities.Anny().sample(np.random.default_rng(0))[1])
    whole = 3 * len(head.skin_wrap.triangles)
    scene = facial_scene(head, Parameters(), head.skin.vertices, without=("muscle",))
    assert whole - 29 < len(scene.tets) < whole
    assert np.array_equal(np.unique(scene.tets), np.arange(len(scene.vertices)))
    crossed = replace(head, muscle_wrap=head.muscle_wrap)
    twisted = np.array(head.skull_wrap.vertices)
    object.__setattr__(crossed, "skull_wrap", head.skull_wrap.with_vertices(twisted[::-1]))
