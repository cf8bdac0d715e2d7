"""Contact inside the descent: closed forms of pressed parts, no friction, nothing crosses, and its energy and model."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from softdeca.lhm import Surface
from softdeca.lhm.base.geometry.bvh import BoxTree
from softdeca.lhm.base.geometry.triangles import parting_shifts
from softdeca.lhm.head.layers import prism_tets
from softdeca.reference import Reason, Scene, prepare, solve, terms
from softdeca.reference.problems import meshes
from softdeca.reference.projective.contact.model import Model
from softdeca.reference.projective.contact.pairs import find_free_share
from softdeca.reference.projective.contact.surfaces import Nearby
from softdeca.reference.projective.memory import Memory
from softdeca.reference.projective.policy import ContactPolicy
from softdeca.reference.projective.unknowns import system

OFFSET = ContactPolicy().offset


def bar(cells, size, origin, *, kept=None):
    """A box of cells, or of those `kept`, each of six tets around its diagonal."""
    X, tets = meshes.box(cells, size)
    if kept is not None:
        cell = np.floor(X[tets].mean(axis=1) * np.array(cells) / size).astype(int)
        tets = tets[kept[tuple(cell.T)]]
    used, tets = np.unique(tets, return_inverse=True)
    return X[used] + origin, tets.reshape(-1, 4)


def solve_with_pairs(scene):
    """PD's answer; its frozen pairs, a start a little beside the answer, and what finite elements answer to them."""
    pytest.importorskip("dolfinx")
    prepared = prepare(scene)
    by_pd = prepared.solve(tolerance=1e-10)
    frozen = prepared.freeze_contact(by_pd.positions)
    start = by_pd.positions + np.random.default_rng(0).normal(scale=1e-5, size=scene.vertices.shape)
    solution = solve(frozen, solver="fenicsx", start=start, tolerance=1e-8)
    assert solution.converged, solution.reason
    return by_pd, frozen, start, solution


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
def test_two_bars_meet_where_their_forces_balance(thickness):
    """Held sideways ‖F - R‖² is (stretch - 1)², a spring w A / L: in line, 6 takes a third of the way."""
    scene, lower, upper = two_bars(thickness=thickness)
    solution = solve(scene, tolerance=1e-10)
    assert solution.converged
    overlap = 1.7 - 0.5 + thickness + OFFSET
    y, rest = solution.positions[:, 1], scene.vertices[:, 1]
    np.testing.assert_allclose(y[lower][rest[lower] == 8.0], 8.0 - overlap / 3.0, atol=1e-3)
    np.testing.assert_allclose(y[upper][rest[upper] == 8.5], 8.0 - overlap / 3.0 + thickness + OFFSET, atol=1e-3)
    assert solution.detail["contact_crossings"] == 0 and solution.detail["contact_pairs"] > 0
    assert solution.detail["contact_force"] == pytest.approx(4.0 * overlap, rel=1e-3)


def test_contact_does_not_drag_sideways():
    """A stamp is pressed down and moved sideways to the middle of a block: by symmetry nothing shears it there."""
    X, tets, (block, stamp) = stacked(bar((6, 2, 6), (9, 3, 9), (0, 0, 0)), bar((2, 2, 2), (3, 3, 3), (2.4, 3.2, 3)))
    foot, top = np.flatnonzero(X[:, 1] == 0.0), np.flatnonzero(X[:, 1] == X[:, 1].max())
    values = np.vstack([X[foot], X[top] + [0.6, -0.9, 0]])
    fixed = terms.Fixed(np.concatenate([foot, top]), values)
    contact = terms.Contact(meshes.boundary_triangles(tets), thickness=0.01)
    scene = Scene(X, tets, [terms.Strain(5.0), terms.Volume(5.0), fixed, contact])
    solution = solve(scene, tolerance=1e-8)
    assert solution.converged and solution.detail["contact_pairs"] > 0
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
    assert solution.converged and solution.detail["contact_crossings"] == 0
    assert x[lower][:, 1].max() < 10.5 and x[upper][:, 1].min() > 10.5
    assert x[lower][:half, 1].max() > 10.5 - 2 * OFFSET
    np.testing.assert_allclose(x[upper] * [1, -1, 1] + [0, 21, 0], x[lower], atol=OFFSET)


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
    assert solution.converged and solution.detail["contact_crossings"] == 0
    low, high = np.flatnonzero((X[:, 1] == 1.0) & (X[:, 0] > 15)), np.flatnonzero((X[:, 1] == 4.0) & (X[:, 0] > 15))
    assert (free.positions[low, 1] > free.positions[high, 1] + 0.2).all()
    gaps = solution.positions[high, 1] - solution.positions[low, 1]
    assert (gaps >= 0.02).all() and gaps.min() <= 0.02 + OFFSET


def held_bars(bodies):
    """Two bars with rollers, held vertices and, where asked for, a rigid body in contact."""
    scene, _, _ = two_bars()
    fixed = terms.Fixed(np.arange(5), components=1), terms.Fixed(np.arange(40, 44))
    parts = [*scene.terms[:2], *fixed, terms.RigidBody(np.arange(60, 80)), scene.terms[-1]]
    return replace(scene, terms=parts if bodies else scene.terms[:3] + scene.terms[4:])


@pytest.mark.parametrize("bodies", [False, True])
def test_the_model_of_elasticity_is_l_bfgs_on_the_contact_vertices(bodies):
    """Against the two-loop recursion on the inverse of the dense matrix, restricted, to 1e-10."""
    scene = held_bars(bodies)
    prepared = prepare(scene)
    contact, coordinates, rng = prepared.contact, prepared.system.coordinates, np.random.default_rng(0)
    place = coordinates.start(0.3 * rng.normal(size=scene.vertices.shape))
    solve_start = partial(prepared.system.solve, rotations=place.rotations)
    model = Model(solve_start, coordinates, contact.compliance, contact.points, place.rotations)
    A = np.linalg.inv([prepared.system.solve(unit, place.rotations) for unit in np.eye(coordinates.size)])
    memory = Memory(coordinates.size)
    for _ in range(11):
        step = rng.normal(size=coordinates.size)
        change = A @ step + 0.1 * rng.normal(size=coordinates.size)
        memory.add(step, change)
        model.add(step, change, model.solve_start(change))
    inverse = -np.stack([memory.direction(unit, model.solve_start) for unit in np.eye(coordinates.size)])
    moves = np.stack([coordinates.move(place, 1e-6 * unit).u - place.u for unit in np.eye(coordinates.size)]) / 1e-6
    P = moves[:, contact.points.vertices].reshape(coordinates.size, -1).T
    vector, forces = rng.normal(size=coordinates.size), rng.normal(size=(len(contact.points.vertices), 3))
    near = {"rtol": 2e-5, "atol": 1e-5}
    np.testing.assert_allclose(model.solve(vector, model.solve_start(vector)), inverse @ vector, rtol=1e-8, atol=1e-10)
    found = model.restrict_solution(vector, model.solve_start(vector)).ravel()
    np.testing.assert_allclose(found, P @ inverse @ vector, **near)
    np.testing.assert_allclose(model.spread(forces), P.T @ forces.ravel(), **near)
    np.testing.assert_allclose(model.push(forces).ravel(), P @ inverse @ P.T @ forces.ravel(), **near)
    rows = Nearby(contact.surfaces, ContactPolicy(reach=0.6)).find_rows(scene.vertices[contact.points.vertices])
    one = [rows.select([r]).spread(np.ones(1), len(contact.points)) for r in range(len(rows.ids))]
    C = np.stack(one).reshape(len(one), -1)
    np.testing.assert_allclose(model.between(rows), C @ P @ inverse @ P.T @ C.T, **near)


def test_frozen_pairs_have_the_energy_and_the_forces_that_contact_has():
    """At the answer nothing pushes; beside it the gradient is the energy's slope, and the Hessian the gradient's."""
    bars, _, upper = two_bars(thickness=0.05)
    aside = np.array(bars.vertices)
    aside[upper] += [0.31, 0.0, 0.17]
    scene = Scene(aside, bars.tets, bars.terms)
    prepared = prepare(scene)
    solution = prepared.solve(tolerance=1e-9)
    frozen = prepare(prepared.freeze_contact(solution.positions))
    at_answer = frozen.solve(start=solution.positions, max_iterations=0)
    assert at_answer.energy == pytest.approx(solution.energy, rel=1e-12)
    assert at_answer.history.gradient_norm[-1] <= 2.0 * solution.history.gradient_norm[-1]
    rng, h = np.random.default_rng(1), 1e-7
    u = solution.positions - scene.vertices
    d = np.where(prepared.system.coordinates.held, 0.0, rng.normal(size=u.shape))
    (ahead, up), (behind, down) = (frozen.energy.evaluate(u + side * h * d) for side in (1, -1))
    energy, gradient = frozen.energy.evaluate(u)
    np.testing.assert_allclose(np.vdot(gradient, d), (ahead - behind) / (2 * h), rtol=1e-4, atol=1e-4)
    tangent, coordinates = prepared.tangent(solution), prepared.system.coordinates
    slope = coordinates.pull((up - down) / (2 * h), tangent.place)
    step = coordinates.pull(d, tangent.place)
    np.testing.assert_allclose(tangent.solve(slope), step, atol=1e-3 * np.abs(step).max())


def test_a_tangent_beside_contact_counts_known_pairs_once():
    """With an idle Contact beside Gaps the tangent's energy is at rest where the answer is."""
    scene, _, _ = two_bars(thickness=0.05)
    prepared = prepare(scene)
    frozen = prepared.freeze_contact(prepared.solve(tolerance=1e-10).positions)
    some = meshes.boundary_triangles(scene.tets)[:1]
    both = prepare(replace(frozen, terms=[*frozen.terms, terms.Contact(some)]))
    answer = both.solve(tolerance=1e-10)
    tangent = both.tangent(answer)
    gradient = tangent.coordinates.pull(tangent.energy.evaluate(tangent.place.u)[1], tangent.place)
    assert np.linalg.norm(gradient) == pytest.approx(answer.history.gradient_norm[-1], rel=1e-3, abs=1e-9)


def test_a_step_ends_before_it_meets_anything():
    """A corner falls on a triangle, and an edge across another: to a fifth of their distance, by closed form."""
    x = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, 2.0], [1.0, -3, 2], [1, 3, 2], [-3, 0, 0], [3, 0, 0]])
    fall = np.zeros_like(x)
    fall[3:6, 2] = -4.0
    pairs = np.array([[3, 0, 1, 2], [4, 5, 6, 7]])
    for one, of_vertices in ((pairs[:1], 1), (pairs[1:], 0), (pairs, 1)):
        share = find_free_share(x, fall, one, of_vertices, 0.2)
        assert 0.39 <= share <= 0.4  # of 4 mm, 1.6 mm leave .4 of 2
    assert find_free_share(x, 0.1 * fall, pairs, 1, 0.2) == 1.0


def test_overlapping_boxes_are_those_of_brute_force():
    rng = np.random.default_rng(3)
    ids = rng.integers(0, 300, (200, 3))
    low = rng.uniform(0, 8, (200, 3))
    boxes = np.hstack([low, low + rng.uniform(0, 1.5, (200, 3))])
    others, of_others = boxes[::3] + 0.2, ids[::3]
    tree = BoxTree(rng.permutation(boxes), ids).moved(boxes)

    def overlap(a, b):
        return (a[:3] <= b[3:]).all() and (b[:3] <= a[3:]).all()

    brute = {(i, j) for i in range(200) for j in range(i) if overlap(boxes[i], boxes[j]) and not {*ids[i]} & {*ids[j]}}
    assert {(max(pair), min(pair)) for pair in tree.self_overlaps().tolist()} == brute and len(brute) > 50
    brute = {
        (i, j)
        for i in range(len(others))
        for j in range(200)
        if overlap(others[i], boxes[j]) and not {*of_others[i]} & {*ids[j]}
    }
    assert {tuple(pair) for pair in tree.overlaps(others, of_others).tolist()} == brute


def test_parts_nearer_at_rest_than_the_gap_are_at_peace_there():
    scene, _, _ = two_bars(thickness=0.8)  # at rest .5 apart
    rest = replace(scene, terms=[*scene.terms[:2], replace(scene.terms[2], values=None), *scene.terms[3:]])
    solution = solve(rest)
    assert solution.iterations == 0 and solution.detail["contact_force"] == 0.0


def test_a_start_that_crosses_is_left_for_rest():
    scene, lower, upper = two_bars(thickness=0.05)
    crossed = np.array(scene.vertices)
    crossed[upper, 1] -= 1.7
    prepared = prepare(scene)
    from_there, from_rest = prepared.solve(start=crossed), prepared.solve()
    np.testing.assert_allclose(from_there.positions, from_rest.positions, atol=1e-6)


@pytest.mark.parametrize(("down", "gives_way"), [(0.3, True), (0.8, True), (0.8, False)])
@pytest.mark.parametrize("by", ["plane on carriers", "projective", "skfem"])
def test_what_is_held_does_not_leap_through(by, down, gives_way):
    """A plane on held carriers, or a block that is held, moves to .2 above a block's top, and by .3 into it."""
    pytest.importorskip("ipctk" if by == "skfem" else "numba")
    X, tets = bar((2, 2, 2), (4, 4, 4), (0, 0, 0))
    top, base = meshes.triangles_at(X, tets, 1, 4.0), np.flatnonzero((X[:, 1] == 0.0) | (not gives_way))
    if by == "plane on carriers":
        plane, held = plane_above(4.5), len(X) + np.arange(4)
        contact = terms.Contact(top, obstacles=(terms.Obstacle(plane, held),))
        X = np.vstack([X, plane.vertices + np.diag([0.0, 9.0, 0.0, 0.0])[:, :3]])
    else:
        X, tets, (_, upper) = stacked((X, tets), bar((2, 2, 2), (4, 4, 4), (0, 4.5, 0)))
        held = np.arange(len(X))[upper]
        contact = terms.Contact(np.vstack([top, meshes.triangles_at(X, tets, 1, 4.5)]))
    moved = terms.Fixed(held, X[held] - [0, down, 0])
    prepared = prepare(
        Scene(X, tets, [terms.Strain(5.0), terms.Fixed(base), moved, contact]),
        solver="skfem" if by == "skfem" else "projective",
    )
    answer = prepared.solve()
    assert answer.reason is (Reason.CONVERGED if gives_way else Reason.CONTACT)
    if gives_way:
        edge = answer.positions[np.unique(top), 1]
        np.testing.assert_allclose(edge, min(4.0, 4.5 - down), atol=0.02)
        # The way of this frame begins where the one before has led.
        assert prepared.solve(start=answer.positions).converged


def plane_above(y):
    corners = np.array([[-1.0, y, -1.0], [5, y, -1], [5, y, 5], [-1, y, 5]])
    return Surface(corners, np.array([[0, 2, 1], [0, 3, 2]]))


@pytest.mark.parametrize(
    ("gap", "thickness"), [(0.0, 0.0), (0.0, 1.0), (1e-4, 0.3), (0.01, 0.0), (0.3, 0.05), (0.3, 1.0)]
)
@pytest.mark.parametrize("pressure", [0.3, 300.0])
def test_a_bar_pressed_by_a_plane_pushes_back_as_its_stiffness_says(gap, thickness, pressure):
    """Held sideways ‖F - R‖² is (stretch - 1)²: it is a spring w A / L, pressed further by the gap that is kept."""
    X, tets = bar((2, 4, 2), (4, 8, 4), (0, 0, 0))
    plane, held = plane_above(8.0 + gap), len(X) + np.arange(4)
    X = np.vstack([X, plane.vertices + np.diag([0.0, 9.0, 0.0, 0.0])[:, :3]])
    base, top = (np.flatnonzero(X[: held[0], 1] == y) for y in (0.0, 8.0))
    parts = [
        terms.Strain(16.0 * pressure),
        terms.Fixed(base, components=1),
        terms.Fixed(np.arange(held[0]), components=(0, 2)),
        terms.Fixed(held, X[held] - [0.0, 0.5 + gap, 0.0]),
    ]
    surface = meshes.triangles_at(X, tets, 1, 8.0)
    contact = terms.Contact(surface, thickness=thickness, obstacles=(terms.Obstacle(plane, held),))
    solution = solve(Scene(X, tets, [*parts, contact]), tolerance=1e-8)
    assert solution.converged, solution.reason
    kept = 0.0 if gap < 5e-4 else min(thickness + OFFSET, gap)
    force = 16.0 * pressure * 16.0 * (0.5 + kept) / 8.0
    given = kept / (0.5 + kept) if pressure > 1.0 else 0.0  # stiff parts press the gap together
    assert force * (1.0 - given) * 0.985 <= -solution.contact_forces[top, 1].sum() <= 1.001 * force
    np.testing.assert_allclose(solution.contact_forces.sum(axis=0), 0.0, atol=1e-6 * force)
    np.testing.assert_allclose(solution.reactions[base, 1].sum(), -solution.contact_forces[top, 1].sum(), rtol=1e-6)
    np.testing.assert_allclose(solution.reactions[held, 1].sum(), solution.contact_forces[top, 1].sum(), rtol=1e-6)


def test_a_block_that_falls_far_comes_to_rest_on_a_plane():
    """It would fall by metres, of which the plane leaves half a millimetre: springs and plane then carry its weight."""
    (X, tets), plane, weight = bar((3, 3, 3), (10, 10, 10), (0, -10, 0)), plane_above(0.05), 40.0
    parts = [
        terms.Strain(10.0),
        terms.Volume(40.0),
        terms.Gravity((0, 1e4, 0), weight / 1e7),
        terms.Target(np.arange(len(X)), X, 1e-4),
    ]
    obstacle = terms.Obstacle(plane.with_vertices(10.0 * plane.vertices))
    contact = terms.Contact(meshes.boundary_triangles(tets), obstacles=(obstacle,))
    solution = solve(Scene(X, tets, [*parts, contact]), tolerance=1e-4)
    carried = 1e-4 * np.sum(solution.positions - X, axis=0)[1] - solution.contact_forces.sum(axis=0)[1]
    assert solution.converged and carried == pytest.approx(weight, rel=1e-3), solution.reason


def test_what_slides_along_has_not_met():
    """A vertex goes far along a triangle, and one through it."""
    scene, _, upper = two_bars()
    contact, beside = prepare(scene).contact, np.array(scene.vertices)
    beside[upper] -= [0.0, 0.49, 0.0]
    aside, through = beside.copy(), beside.copy()
    aside[upper] += [30.0, 0.0, 10.0]
    through[upper] += [0.0, -20.0, 0.0]
    assert not contact.leaps(beside, aside) and contact.leaps(beside, through)


def test_without_contact_nothing_changes_and_with_it_nothing_is_factored_again(monkeypatch):
    scene, _, upper = two_bars(thickness=0.05)
    lifted = scene.terms[2].values + np.where(scene.terms[2].values[:, 1:2] > 8, [0, 1.7, 0], 0)
    apart = replace(scene, terms=[*scene.terms[:2], replace(scene.terms[2], values=lifted), *scene.terms[3:]])
    alone = replace(apart, terms=apart.terms[:-1])
    assert prepare(alone).contact is None
    solution = solve(apart)
    np.testing.assert_array_equal(solution.positions, solve(alone).positions)
    assert solution.detail["contact_pairs"] == solution.detail["contact_crossings"] == 0
    calls = []
    factorise = system.factorise_definite
    monkeypatch.setattr(
        system, "factorise_definite", lambda *given, **options: calls.append(1) or factorise(*given, **options)
    )
    prepared = prepare(scene)
    made = len(calls)
    first, second = prepared.solve(scene), prepared.solve(scene)
    assert len(calls) == made
    np.testing.assert_array_equal(first.positions, second.positions)


def test_the_shift_that_parts_two_triangles():
    """A spike 0.3 through a large triangle; turned and moved, and drawn back by as much, it just touches."""
    floor = np.array([[-5.0, 0, -5], [5, 0, -5], [0, 0, 8]])
    spike = np.array([[0.0, -0.3, 0], [0.5, 2, 0.1], [-0.4, 2, 0.3]])
    turn = Rotation.from_euler("xyz", (0.3, 1.1, -0.7)).as_matrix()
    pairs = [(floor, spike), (floor @ turn.T + 3.0, spike @ turn.T + 3.0), (spike, floor), (floor, spike + [0, 0.4, 0])]
    first, second = (np.array(side) for side in zip(*pairs, strict=True))
    np.testing.assert_allclose(parting_shifts(first, second), [0.3, 0.3, 0.3, 0.0], atol=1e-12)
