"""Eyeballs and teeth as obstacles: they clear at rest, lids and lips lie on them, and the jaw carries its teeth."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from softdeca.lhm import Surface, expressions, fit_head, identities, load_template
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.geometry.topology import connected_parts, join_surfaces
from softdeca.lhm.base.geometry.warp import rigid_motion
from softdeca.lhm.head.head import MANDIBLE
from softdeca.reference import Face, Parameters, Scene, prepare, terms
from softdeca.reference.face.organs import find_organs
from softdeca.reference.problems import meshes
from softdeca.reference.projective.contact.model import Model

from .test_contact import bar, solve_with_pairs, stacked

SPACE = identities.Anny()


@pytest.fixture(scope="module")
def fit():
    return partial(fit_head, load_template(level=2))


@pytest.fixture(scope="module")
def faces(fit):
    """The mean person free, with skin alone in contact, and with organs."""
    free = Face(fit(SPACE.mean), SPACE.expressions)
    touching = free.in_contact()
    return free, replace(touching, choices={**touching.choices, "organs": ()}), touching


def solved(face, named, **how):
    scene = face.scene(expressions.weights_of(named))
    return prepare(face.neutral_scene()).solve(scene, **how)


def count_crossings(face, positions):
    contact = prepare(face.neutral_scene()).contact
    return contact.count_crossings(contact.points.find_places(positions))


def test_nothing_crosses_at_rest_in_random_people(fit):
    """ipctk finds no crossing of an eyeball or a tooth with the whole skin wrap, and contact pushes nothing."""
    ipctk = pytest.importorskip("ipctk")
    rng = np.random.default_rng(11)
    for _ in range(2):
        head = fit(SPACE.skin(SPACE.sample(rng)[0]))
        organs = find_organs(head)
        assert len(organs) == 4
        for organ in organs:
            count, part = connected_parts(organ.surface.triangles, len(organ.surface.vertices))
            assert count > 2 or organ in organs[:2]
            for number in range(count):
                own = organ.surface.triangles[part[organ.surface.triangles[:, 0]] == number]
                both = join_surfaces([head.skin_wrap, Surface(organ.surface.vertices, own)])
                rest, triangles = (np.asfortranarray(each) for each in (both.vertices, both.triangles.astype(np.int32)))
                mesh = ipctk.CollisionMesh(rest, ipctk.edges(triangles), triangles)
                assert not ipctk.has_intersections(mesh, rest)
        scene = Face(head).in_contact().neutral_scene()
        answer = prepare(scene).solve()
        assert answer.is_balanced and answer.detail["contact_force"] == 0.0
        np.testing.assert_allclose(answer.positions, scene.vertices, atol=1e-9)


def test_another_head_has_no_organs(fit):
    head = fit(SPACE.mean)
    other = replace(head, skin=Surface(head.skin.vertices, head.skin.triangles[:, [1, 2, 0]]))
    assert find_organs(other) == ()


BLINK = {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0}


def test_shut_lids_lie_on_the_eyeballs(faces):
    _, skin_alone, touching = faces
    before, after = solved(skin_alone, BLINK), solved(touching, BLINK)
    assert after.converged and count_crossings(touching, before.positions) > 0
    assert count_crossings(touching, after.positions) == 0 == after.detail["contact_crossings"]
    assert after.detail["contact_pairs"] > before.detail["contact_pairs"]
    (gaps,) = prepare(touching.neutral_scene()).freeze_contact(after.positions).of(terms.Gaps)
    assert gaps.places.any(axis=(1, 2)).sum() > 3  # of eyes alone, for the lower teeth are carried


def test_a_lip_that_is_drawn_over_the_teeth_lies_on_them(faces):
    _, skin_alone, touching = faces
    named = {"mouthClose": 1.0, "jawOpen": 1.0}
    before, after = solved(skin_alone, named), solved(touching, named)
    assert after.converged and after.detail["contact_force"] > 0.0
    assert count_crossings(touching, before.positions) > 0 == count_crossings(touching, after.positions)


def test_the_lower_row_goes_with_the_mandible_and_the_others_stay(faces):
    _, _, touching = faces
    prepared, scene = prepare(touching.neutral_scene()), touching.scene(expressions.weights_of({"jawOpen": 0.7}))
    positions = prepared.solve(scene).positions
    jaw = 2 * len(touching.head.bone) + np.flatnonzero(touching.head.bone == MANDIBLE)
    rotation, shift = rigid_motion(scene.vertices[jaw], positions[jaw])
    points = prepared.contact.points
    rest, now = (points.find_places(x)[len(points.vertices) :] for x in (scene.vertices, positions))
    count = len(find_organs(touching.head)[-1].surface.vertices)
    assert np.array_equal(now[:-count], rest[:-count])
    np.testing.assert_allclose(now[-count:], rest[-count:] @ rotation.T + shift, atol=1e-8)
    assert (rest - now)[-count:, 1].min() > 5.0


def test_a_scaled_bone_takes_its_teeth_along(faces):
    free, _, _ = faces
    p = Parameters(mandible_scale_y=1.1, cranium_scale_x=0.95)
    plain, scaled = (find_obstacles(Face(free.head, parameters=each).in_contact()) for each in (Parameters(), p))
    upper, lower = ([each[k].surface.vertices for each in (plain, scaled)] for k in (2, 3))
    assert np.ptp(upper[1][:, 0]) == pytest.approx(0.95 * np.ptp(upper[0][:, 0]))
    settled = Face(free.head, parameters=p).in_contact().settled()
    assert settled.converged and settled.solution.detail["contact_crossings"] == 0
    assert np.array_equal(*lower)  # their carriers are scaled


def find_obstacles(face):
    return face.neutral_scene().of(terms.Contact)[0].obstacles


def ball_between_blocks():
    """A block is pressed on a ball that a rigid block below it carries, off its middle, so that it turns on springs."""
    X, tets, (lower, upper) = stacked(bar((2, 2, 2), (6, 2, 6), (0, 0, 0)), bar((4, 2, 4), (6, 2, 6), (0, 4.1, 0)))
    body, top = np.arange(lower.stop), np.flatnonzero(X[:, 1] == X[:, 1].max())
    of_upper = np.flatnonzero((tets >= upper.start).all(axis=1))
    unit, triangles = geodesic_sphere(3)
    obstacle = terms.Obstacle(Surface([3.7, 2.9, 2.8] + 1.0 * unit, triangles), [0, 2, 6, 26])
    outer = meshes.boundary_triangles(tets)
    parts = [
        terms.Strain(5.0, tets=of_upper),
        terms.Volume(5.0, tets=of_upper),
        terms.RigidBody(body),
        terms.Target(body, X[body], 0.2),
        terms.Fixed(top, X[top] - [0.0, 0.9, 0.0]),
        terms.Contact(outer[(outer >= upper.start).all(axis=1)], 300.0, 0.02, (obstacle,)),
    ]
    return Scene(X, tets, parts), body


def test_frozen_pairs_with_an_obstacle_have_the_energy_and_derivatives_of_contact():
    scene, body = ball_between_blocks()
    prepared = prepare(scene)
    solution = prepared.solve(tolerance=1e-10)
    assert solution.converged and solution.detail["contact_pairs"] > 0 == solution.detail["contact_crossings"]
    rotation, _ = rigid_motion(scene.vertices[body], solution.positions[body])
    assert np.trace(rotation) < 3.0 - 1e-4
    frozen = prepare(prepared.freeze_contact(solution.positions))
    assert frozen.solve(start=solution.positions, max_iterations=0).energy == pytest.approx(solution.energy, rel=1e-12)
    rng, h = np.random.default_rng(1), 1e-6
    u = solution.positions - scene.vertices
    coordinates = prepared.system.coordinates
    place, direction = coordinates.start(u), rng.normal(size=coordinates.size)
    moved = [coordinates.move(place, side * h * direction) for side in (1, -1)]
    (ahead, up), (behind, down) = (frozen.energy.evaluate(each.u) for each in moved)
    slope = coordinates.pull(frozen.energy.evaluate(place.u)[1], place) @ direction
    assert slope == pytest.approx((ahead - behind) / (2 * h), rel=1e-4, abs=1e-4)
    change = (coordinates.pull(up, moved[0]) - coordinates.pull(down, moved[1])) / (2 * h)
    tangent = prepared.tangent(solution)
    np.testing.assert_allclose(tangent.solve(change), direction, atol=2e-3 * np.abs(direction).max())


def test_the_model_turns_an_obstacle_with_its_body():
    """Its P, prepared where the body is not turned, is the points' motion where it is."""
    scene, body = ball_between_blocks()
    prepared, rng, h = prepare(scene), np.random.default_rng(2), 1e-6
    contact, coordinates = prepared.contact, prepared.system.coordinates
    begin = coordinates.start(np.zeros_like(scene.vertices))
    solve_start = partial(prepared.system.solve, rotations=begin.rotations)
    model = Model(solve_start, coordinates, contact.compliance, contact.points, begin.rotations)
    place = coordinates.move(begin, np.r_[np.zeros(coordinates.size - 3), 0.9, -0.7, 1.3])
    assert np.trace(place.rotations[0]) < 2.9
    model.turn(place.rotations)
    moves = [contact.find_places(coordinates.move(place, h * unit)) for unit in np.eye(coordinates.size)]
    P = (np.stack(moves) - contact.find_places(place)).reshape(coordinates.size, -1) / h
    forces = rng.normal(size=(len(contact.points), 3))
    np.testing.assert_allclose(model.spread(forces), P @ forces.ravel(), rtol=1e-4, atol=1e-4)


def test_finite_elements_answer_alike_with_an_obstacle():
    scene, body = ball_between_blocks()
    by_pd, _, _, solution = solve_with_pairs(scene)
    assert np.linalg.norm(solution.positions - by_pd.positions, axis=1).max() <= 1e-5
