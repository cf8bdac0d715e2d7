"""Meshes, scenes and terms are checked when made, and errors name the thing."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm import MeshError, Surface, TetMesh
from softdeca.lhm.head.layers import prism_tets
from softdeca.reference import Scene, SceneError, prepare, terms
from softdeca.reference.problems.meshes import box

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


def test_surfaces_name_bad_rows():
    with pytest.raises(MeshError, match="first is 1"):
        Surface([[0, 0, 0], [np.nan, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    with pytest.raises(MeshError, match=r"outside 0..2.*number 0: \[0, 1, 7\]"):
        Surface(np.eye(3), [[0, 1, 7]])
    with pytest.raises(MeshError, match="repeat a vertex"):
        Surface(np.eye(3), [[0, 1, 1]])
    with pytest.raises(MeshError, match="shape"):
        Surface(np.eye(3), [[0, 1]])


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


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (lambda: terms.Fixed([0, 9]), r"term 0 \(Fixed\): vertex 9 is outside 0..4"),
        (lambda: terms.Strain(1.0, tets=[2]), r"term 0 \(Strain\): tet 2 is outside 0..1"),
        (lambda: terms.Target([-1], [[0, 0, 0]], 1.0), "vertex -1 is outside"),
        (lambda: terms.Strain([1.0, 1.0, 1.0]), "3 values for 2 tets"),
        (lambda: "gravity", "str is no term"),
        (lambda: terms.SurfaceStrain([[0, 1, 1]], 1.0), "triangle 0 has no area"),
    ],
)
def test_a_scene_names_the_term_that_does_not_fit(term, message):
    with pytest.raises(SceneError, match=message):
        Scene(CORNERS, TETS, [term()])


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ([[0, 1, 2]], r"columns 0: expected shape \(n, n\), got \(3,\)"),
        ([[[0.0, 1.0]]], "columns 0: expected integers, got float64"),
        ([[[0, 1]], [[0, 9]]], r"columns 1: 9 at \(0, 1\); expected 0..4"),
        ([[[0]]], "columns 0: expected at least 2 vertices a row, got 1"),
        ([[[0, 1, 2]], [[3, 1, 4]]], "columns: vertex 1 is inside one row and in another one too"),
    ],
)
def test_a_scene_names_columns_that_do_not_fit(columns, message):
    with pytest.raises(SceneError, match=message):
        Scene(CORNERS, TETS, [], columns=columns)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: terms.Volume([1.0, np.nan], tets=[0, 1]), r"Volume.stiffness.*number 1"),
        (lambda: terms.Target([0, 1], [[0, 0, 0]], 1.0), "expected 2 rows, got 1"),
        (lambda: terms.Fixed([0, 0]), "appears twice"),
    ],
)
def test_a_term_names_the_value_out_of_range(make, message):
    with pytest.raises(SceneError, match=message):
        make()


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


def test_a_prepared_scene_says_what_changed():
    scene = Scene(CORNERS, TETS, [terms.Strain(1.0), terms.Target([0], [[0, 0, 0]], 1.0)])
    moved = scene.with_targets([[1, 0, 0]])
    scene.check_prepared_for(moved)
    with pytest.raises(SceneError, match="Target.positions differs"):
        scene.check_prepared_for(moved, fixed=((terms.Target, "positions"),))
    with pytest.raises(SceneError, match="Strain.stiffness differs"):
        scene.check_prepared_for(Scene(CORNERS, TETS, [terms.Strain(2.0), scene.terms[1]]))
    with pytest.raises(SceneError, match="rest vertices differ"):
        scene.check_prepared_for(Scene(2 * CORNERS, TETS, scene.terms))
    with pytest.raises(SceneError, match="0 Fixed terms"):
        scene.with_fixed([[0, 0, 0]])


def test_unknown_solvers_and_options_are_named():
    scene = Scene(CORNERS, TETS, [terms.Strain(1.0)])
    with pytest.raises(SceneError, match="unknown solver 'abaqus'; there are projective, fenicsx, skfem"):
        prepare(scene, solver="abaqus")
    with pytest.raises(SceneError, match="no option 'mesh'"):
        prepare(scene, solver="projective", mesh="fine")


@pytest.mark.parametrize("again", [[0, 1, 2, 3], [1, 2, 0, 3]])
def test_a_tet_listed_twice_is_refused_before_any_solver_sees_it(again):
    """FEniCSx ended in malloc's abort, and scikit-fem counted its energy twice."""
    with pytest.raises(SceneError, match="number 2 is number 0 again"):
        Scene(CORNERS, [*TETS.tolist(), again], [terms.Strain(1.0)])


def test_no_tet_is_overlooked_among_many():
    vertices, tets = box((6, 5, 4), (1.0, 1.0, 1.0))
    assert len(TetMesh(vertices, tets).tets) == len(tets)
    rng = np.random.default_rng(0)
    for first in rng.integers(len(tets), size=50):
        even = [[0, 1, 2, 3], [1, 2, 0, 3], [3, 2, 1, 0]][rng.integers(3)]
        with pytest.raises(MeshError, match=f"number {len(tets)} is number {first} again"):
            TetMesh(vertices, np.vstack([tets, tets[first][even]]))


def test_a_scene_of_nothing_to_deform_is_refused():
    with pytest.raises(SceneError, match="there are none"):
        Scene(CORNERS, np.zeros((0, 4), int), [terms.Gravity((0, 0, -9810), 1e-6)])
    sheet = Scene(CORNERS, np.zeros((0, 4), int), [terms.SurfaceStrain([[0, 1, 2]], 1.0)])
    for solver in ("skfem", "fenicsx"):
        pytest.importorskip({"skfem": "skfem", "fenicsx": "dolfinx"}[solver])
        with pytest.raises(SceneError, match="the scene has no tets"):
            prepare(sheet, solver=solver)


@pytest.mark.parametrize(
    "term",
    [
        lambda mask, _: terms.Fixed(mask),
        lambda mask, _: terms.RigidBody(mask),
        lambda _, mask: terms.Strain(1.0, tets=mask),
    ],
)
def test_a_mask_of_another_length_is_refused(term):
    """A short one names vertices that are there, and was taken."""
    for vertices, tets in (([True, True], [True]), ([True, True, False, False, False, False], [True, False, False])):
        with pytest.raises(SceneError, match="is a mask of|at least 3"):
            Scene(CORNERS, TETS, [term(np.array(vertices), np.array(tets))])
    whole = terms.Fixed(np.arange(5) < 2)
    assert Scene(CORNERS, TETS, [whole]).terms[0].vertices.tolist() == [0, 1]
    assert Scene(CORNERS, TETS, [replace(whole, vertices=[0, 4])]).terms[0].vertices.tolist() == [0, 4]
