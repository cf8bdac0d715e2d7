"""Contact as a following solve: closed forms of pressed parts, no friction, and what it promises about factoring."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from softdeca.lhm.base.errors import SceneError
from softdeca.lhm.base.geometry.bvh import TetTree
from softdeca.lhm.base.geometry.triangles import parting_shifts
from softdeca.lhm.head.layers import prism_tets
from softdeca.reference import Scene, prepare, solve, terms
from softdeca.reference.problems import meshes
from softdeca.reference.projective.contact.constraints import Constraints
from softdeca.reference.projective.policy import ContactPolicy
from softdeca.reference.projective.unknowns import system

ALLOWED_DEPTH = ContactPolicy().allowed_depth


def bar(cells, size, origin, *, kept=None):
    """A box of cells, or of those `kept`, each of six tets around its diagonal."""
    X, tets = meshes.box(cells, size)
    if kept is not None:
        cell = np.floor(X[tets].mean(axis=1) * np.array(cells) / size).astype(int)
        tets = tets[kept[tuple(cell.T)]]
    used, tets = np.unique(tets, return_inverse=True)
    return X[used] + origin, tets.reshape(-1, 4)


def stacked(*parts):
    """Vertices and tets of several meshes, and the slice of vertices of each."""
    ends = np.cumsum([0, *(len(X) for X, _ in parts)])
    tets = np.vstack([t + first for (_, t), first in zip(parts, ends[:-1], strict=True)])
    return np.vstack([X for X, _ in parts]), tets, [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]


def two_bars(**contact):
    """Two bars of length 8, 0.5 apart along y, of stiffness 6 and 3; the upper's far end is pushed down by 1.7."""
    X, tets, (lower, upper) = stacked(bar((2, 4, 2), (4, 8, 4), (0, 0, 0)), bar((2, 4, 2), (4, 8, 4), (0, 8.5, 0)))
    near, far = np.flatnonzero(X[:, 1] == 0.0), np.flatnonzero(X[:, 1] == 16.5)
    half = np.arange(len(tets) // 2)
    parts = [
        terms.Strain(6.0, tets=half),
        terms.Strain(3.0, tets=half + len(half)),
        terms.Fixed(np.concatenate([near, far]), np.vstack([X[near], X[far] - [0, 1.7, 0]]), components=1),
        terms.Fixed(np.arange(len(X)), components=(0, 2)),
    ]
    return Scene(X, tets, [*parts, terms.Contact(meshes.boundary_triangles(tets), **contact)]), lower, upper


@pytest.mark.parametrize("thickness", [0.0, 0.05])
@pytest.mark.parametrize("stiffness", [5.0, 100.0])
def test_two_bars_meet_where_their_forces_balance(thickness, stiffness):
    """Held sideways ‖F - R‖² is (stretch - 1)², a spring w A / L: in line, 6 takes a third of the way."""
    scene, lower, upper = two_bars(thickness=thickness, stiffness=stiffness)
    solution = solve(scene, tolerance=1e-10)
    assert solution.converged
    assert solution.detail["contact_pairs_before"] > 0 and solution.detail["contact_depth_before"] > 1.1
    assert solution.detail["contact_depth_after"] <= ALLOWED_DEPTH
    overlap = 1.7 - 0.5 + thickness
    y, rest = solution.positions[:, 1], scene.vertices[:, 1]
    # The method of multipliers leaves less of a gap with each round; the last round is judged by ALLOWED.
    close = ALLOWED_DEPTH if stiffness < 10 else 1e-4
    np.testing.assert_allclose(y[lower][rest[lower] == 8.0], 8.0 - overlap / 3.0, atol=close)
    np.testing.assert_allclose(y[upper][rest[upper] == 8.5], 8.0 - overlap / 3.0 + thickness, atol=close)
    assert thickness == 0.0 or solution.detail["contact_pairs_after"] == 0


def test_contact_does_not_drag_sideways():
    """A stamp is pressed down and moved sideways to the middle of a block: by symmetry nothing shears it there."""
    X, tets, (block, stamp) = stacked(bar((6, 2, 6), (9, 3, 9), (0, 0, 0)), bar((2, 2, 2), (3, 3, 3), (2.4, 3.2, 3)))
    foot, top = np.flatnonzero(X[:, 1] == 0.0), np.flatnonzero(X[:, 1] == X[:, 1].max())
    values = np.vstack([X[foot], X[top] + [0.6, -0.9, 0]])
    fixed = terms.Fixed(np.concatenate([foot, top]), values)
    contact = terms.Contact(meshes.boundary_triangles(tets), 100.0, 0.01)
    scene = Scene(X, tets, [terms.Strain(5.0), terms.Volume(5.0), fixed, contact])
    solution = solve(scene, tolerance=1e-8)
    assert solution.converged and solution.detail["contact_pairs_before"] > 0
    sole = np.flatnonzero(X[:, 1] == 3.2)
    moved = (solution.positions - X)[sole]
    assert moved[:, 1].max() > -0.85  # pushed back up by more than 0.05
    np.testing.assert_allclose(moved[:, 0].mean(), 0.6, atol=0.01)
    np.testing.assert_allclose(moved[:, 2].mean(), 0.0, atol=0.01)


def shell(centre, *, radius=10.0, core=5.0):
    sphere = trimesh.creation.icosphere(2)
    unit, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces)
    return np.vstack([radius * unit, core * unit]) + centre, prism_tets(faces, 0, len(unit))


def test_two_equal_spheres_flatten_each_other_at_the_plane_between():
    (below, t), (above, _) = shell((0, 0, 0)), shell((0, 0, 0))
    above = above * [1, -1, 1] + [0, 21, 0]
    flipped = t[:, [0, 2, 1, 3]]
    X, tets, (lower, upper) = stacked((below, t), (above, flipped))
    half = len(below) // 2
    core = np.concatenate([np.arange(half, 2 * half), np.arange(3 * half, 4 * half)])
    toward = np.where(core < 2 * half, 1.5, -1.5)[:, None] * [0, 1, 0]
    terms_of = [terms.Strain(5.0), terms.Volume(20.0), terms.Fixed(core, X[core] + toward)]
    surface = meshes.boundary_triangles(tets)
    outer = surface[(surface % (2 * half) < half).all(axis=1)]
    scene = Scene(X, tets, [*terms_of, terms.Contact(outer)])
    solution = solve(scene, tolerance=1e-8)
    x = solution.positions
    assert solution.converged and solution.detail["contact_depth_before"] > 1.0
    assert x[lower][:, 1].max() < 10.5 + ALLOWED_DEPTH and x[upper][:, 1].min() > 10.5 - ALLOWED_DEPTH
    assert x[lower][:half, 1].max() > 10.5 - 2 * ALLOWED_DEPTH
    np.testing.assert_allclose(x[upper] * [1, -1, 1] + [0, 21, 0], x[lower], atol=2 * ALLOWED_DEPTH)


def test_a_folded_sheet_does_not_go_through_itself():
    """The arms of a U, one surface, are pushed 0.6 through each other at their ends."""
    kept = np.ones((10, 5, 3), dtype=bool)
    kept[2:, 1:4] = False
    X, tets = bar((10, 5, 3), (20, 5, 5), (0, 0, 0), kept=kept)
    ends = np.flatnonzero((X[:, 0] > 15.0) & ((X[:, 1] == 0.0) | (X[:, 1] == 5.0)))
    push = np.where(X[ends, 1] == 0.0, 1.0, -1.0)[:, None] * [0, 1.8, 0]
    target = terms.Target(ends, X[ends] + push, 5.0)
    held = terms.Fixed(np.flatnonzero(X[:, 0] == 0.0))
    scene = Scene(X, tets, [terms.Strain(5.0), terms.Volume(10.0), target, held])
    free = solve(scene, tolerance=1e-8)
    contact = terms.Contact(meshes.boundary_triangles(tets), thickness=0.02)
    solution = solve(replace(scene, terms=[*scene.terms, contact]), tolerance=1e-8)
    assert solution.converged and solution.detail["contact_pairs_before"] > 0
    low, high = np.flatnonzero((X[:, 1] == 1.0) & (X[:, 0] > 15)), np.flatnonzero((X[:, 1] == 4.0) & (X[:, 0] > 15))
    assert (free.positions[low, 1] > free.positions[high, 1] + 0.2).all()
    assert (solution.positions[low, 1] < solution.positions[high, 1] + ALLOWED_DEPTH).all()
    assert solution.detail["contact_depth_after"] <= ALLOWED_DEPTH


def tangled_rows(scene, rng, count=7):
    ids = np.stack([rng.choice(np.unique(scene.terms[-1].triangles), 4, replace=False) for _ in range(count)])
    at = rng.dirichlet(np.ones(3), count)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    weights = np.column_stack([np.ones(count), -at])
    return Constraints(
        ids, weights, normals, rng.uniform(1, 50, count), rng.normal(size=count), rng.uniform(0, 9, count)
    )


@pytest.mark.parametrize("bodies", [False, True])
def test_woodbury_equals_the_refactored_matrix(bodies):
    """On free vertices, rollers and a rigid body: against the inverse of the dense matrix, to 1e-10."""
    scene, _, _ = two_bars()
    fixed = terms.Fixed(np.arange(5), components=1), terms.Fixed(np.arange(40, 44))
    parts = [*scene.terms[:2], *fixed, terms.RigidBody(np.arange(60, 80)), scene.terms[-1]]
    prepared = prepare(replace(scene, terms=parts if bodies else scene.terms[:3] + scene.terms[4:]))
    coordinates = prepared.system.coordinates
    rng = np.random.default_rng(0)
    place = coordinates.start(0.3 * rng.normal(size=scene.vertices.shape))
    inverse = np.stack([prepared.system.solve(unit, place.rotations) for unit in np.eye(coordinates.size)])
    rows = tangled_rows(scene, rng)
    gradients = []
    for k in range(len(rows.ids)):
        gradient = np.zeros_like(scene.vertices)
        np.add.at(gradient, rows.ids[k], rows.weights[k][:, None] * rows.normals[k])
        gradients.append(coordinates.pull(gradient, place))
    pushing = np.array([True, False, True, True, True, False, True])
    C = np.array(gradients)[pushing]
    refactored = np.linalg.inv(np.linalg.inv(inverse) + C.T @ (rows.stiffness[pushing][:, None] * C))
    vector = rng.normal(size=coordinates.size)
    matrix = prepared.contact.elasticity.with_constraints(rows, place)
    answer = matrix.solve(vector, pushing, place.rotations)
    np.testing.assert_allclose(answer, refactored @ vector, atol=1e-10 * np.abs(refactored @ vector).max())


def test_rows_push_along_normals_and_equal_their_energy_s_derivative():
    scene, _, _ = two_bars()
    rng = np.random.default_rng(1)
    rows = tangled_rows(scene, rng)
    x, d = scene.vertices + 0.1 * rng.normal(size=scene.vertices.shape), rng.normal(size=scene.vertices.shape)
    gradient, dump = np.zeros_like(x), np.zeros_like(x)
    rows.add_to(x, gradient)
    h = 1e-6
    slope = (rows.add_to(x + h * d, dump) - rows.add_to(x - h * d, dump)) / (2 * h)
    np.testing.assert_allclose(np.vdot(gradient, d), slope, rtol=1e-7)
    np.testing.assert_allclose(gradient.sum(axis=0), 0.0, atol=1e-12 * np.abs(gradient).max())
    one = rows.select(rows.forces(x) > 0).select(slice(0, 1))
    single = np.zeros_like(x)
    one.add_to(x, single)
    assert np.abs(np.cross(single, one.normals[0])).max() < 1e-12 * np.abs(single).max()


def test_without_contact_nothing_changes_and_with_it_nothing_is_factored_again(monkeypatch):
    scene, _, upper = two_bars(thickness=0.05)
    lifted = scene.terms[2].values + np.where(scene.terms[2].values[:, 1:2] > 8, [0, 1.7, 0], 0)
    apart = replace(scene, terms=[*scene.terms[:2], replace(scene.terms[2], values=lifted), *scene.terms[3:]])
    alone = replace(apart, terms=apart.terms[:-1])
    assert prepare(alone).contact is None
    solution = solve(apart)
    np.testing.assert_array_equal(solution.positions, solve(alone).positions)
    assert solution.detail["contact_rounds"] == 0 and solution.detail["contact_pairs_before"] == 0
    calls = []
    factorise = system.factorise
    monkeypatch.setattr(system, "factorise", lambda *given, **options: calls.append(1) or factorise(*given, **options))
    prepared = prepare(scene)
    made = len(calls)
    first, second = prepared.solve(scene), prepared.solve(scene)
    assert len(calls) == made
    np.testing.assert_array_equal(first.positions, second.positions)


def test_triangles_that_are_not_the_surface_are_refused():
    scene, _, _ = two_bars()
    surface = scene.terms[-1].triangles
    for triangles, said in (
        (surface[:, ::-1], "triangle 0 .* is seen from inside"),
        ([[0, 1, 40]], "triangle 0 .* is no face"),
    ):
        with pytest.raises(SceneError, match=said):
            prepare(replace(scene, terms=[*scene.terms[:-1], terms.Contact(triangles)]))


def test_the_shift_that_parts_two_triangles():
    """A spike 0.3 through a large triangle; turned and moved, and drawn back by as much, it just touches."""
    floor = np.array([[-5.0, 0, -5], [5, 0, -5], [0, 0, 8]])
    spike = np.array([[0.0, -0.3, 0], [0.5, 2, 0.1], [-0.4, 2, 0.3]])
    turn = Rotation.from_euler("xyz", (0.3, 1.1, -0.7)).as_matrix()
    pairs = [(floor, spike), (floor @ turn.T + 3.0, spike @ turn.T + 3.0), (spike, floor), (floor, spike + [0, 0.4, 0])]
    first, second = (np.array(side) for side in zip(*pairs, strict=True))
    np.testing.assert_allclose(parting_shifts(first, second), [0.3, 0.3, 0.3, 0.0], atol=1e-12)


def test_tets_that_hold_a_point_as_by_brute_force():
    X, tets = bar((3, 3, 3), (3, 3, 3), (0, 0, 0))
    rng = np.random.default_rng(2)
    moved = X + 0.5 * rng.normal(size=X.shape)
    points = rng.uniform(-0.5, 3.5, (200, 3))
    besides = rng.integers(0, len(X), 200)
    pairs, weights = TetTree(X, tets).moved(moved).containing(points, besides)
    expected = []
    for i, p in enumerate(points):
        for t, tet in enumerate(tets):
            edges = (moved[tet[1:]] - moved[tet[0]]).T
            w = np.linalg.solve(edges, p - moved[tet[0]])
            if np.linalg.det(edges) > 0 and min(w.min(), 1 - w.sum()) >= 0 and besides[i] not in tet:
                expected.append((i, t))
    assert len(expected) > 100
    assert sorted(map(tuple, pairs.tolist())) == expected
    np.testing.assert_allclose(
        np.einsum("kj,kjc->kc", weights, moved[tets[pairs[:, 1]]]), points[pairs[:, 0]], atol=1e-9
    )


def test_parts_that_overlap_at_rest_are_refused_and_touching_ones_are_not():
    for gap, apart in ((-1.2, False), (0.0, True)):
        X, tets, _ = stacked(bar((2, 4, 2), (4, 8, 4), (0, 0, 0)), bar((2, 4, 2), (4, 8, 4), (0.3, 8 + gap, 0.2)))
        ends = np.flatnonzero((X[:, 1] == 0.0) | (X[:, 1] == X[:, 1].max()))
        scene = Scene(X, tets, [terms.Strain(5.0), terms.Fixed(ends), terms.Contact(meshes.boundary_triangles(tets))])
        if apart:
            assert solve(scene).converged
        else:
            with pytest.raises(SceneError, match=r"vertex \d+ lies inside another tet at rest"):
                prepare(scene)
