"""Effects: where they act, how a face settles under them, and what is solved of a case."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from softdeca.benchmarks.studies.agreement.solvers import leave_out, start_elsewhere, watch_pd
from softdeca.benchmarks.studies.agreement.study import Agreement
from softdeca.benchmarks.studies.cases import CASES, Case, add_case, get_case
from softdeca.benchmarks.studies.person import person
from softdeca.lhm import check_head, expressions
from softdeca.lhm.base.geometry.mirror import find_twins
from softdeca.lhm.head.flesh import POLICY, cheek_share, flesh_share, mean_on_triangles
from softdeca.reference import Face, Parameters, Reason, facial_scene, settle, solve, terms
from softdeca.reference.face.bones import scale_skull
from softdeca.reference.face.settle import carry_by_bones, neutral_scene
from softdeca.surrogate.methods import CARRIED, FENICSX

from ..conftest import with_regions


@pytest.fixture(scope="module")
def fine_head(spheres):
    return with_regions(spheres(4))


@pytest.fixture(scope="module")
def head(spheres):
    return with_regions(spheres(3))


def test_flesh_fades_in_along_the_skin(fine_head):
    x, share = fine_head.skin_wrap.vertices, flesh_share(fine_head)
    brow = x[fine_head.regions["lids"], 1].max() + 10.0
    none = (x[:, 1] >= brow) | fine_head.regions["lips"] | fine_head.regions["lids"]
    none |= ~(fine_head.regions["face"] | fine_head.regions["neck"])
    assert np.all(share[none] == 0.0)
    straight = cdist(x, x[none]).min(axis=1)  # no way along the skin is shorter
    t = np.minimum(straight / POLICY.fade, 1.0)
    assert np.all(share >= t * t * (3 - 2 * t) - 1e-12)
    assert np.any((share > 0.1) & (share < 0.9)) and np.any(share == 1.0)


def test_cheeks_are_two_beside_and_above_the_mouth(fine_head):
    x, share = fine_head.skin_wrap.vertices, cheek_share(fine_head)
    mirrored = np.argmin(cdist(x * [-1, 1, 1], x), axis=1)
    np.testing.assert_allclose(share[mirrored], share, atol=1e-9)
    lips, lids = (x[fine_head.regions[name]] for name in ("lips", "lids"))
    some = x[share > 0.5]
    assert some[:, 1].min() > lips[:, 1].min() and some[:, 1].max() < lids[:, 1].max()
    assert np.all(np.abs(some[:, 0]) > 10) and len(some) > 10


def test_a_stylised_head_is_fitted_and_simulated():
    usual, case = person(level=1, seed=None), CASES["stylised"]
    skin = case.changed(usual.head)
    mirrored = skin.vertices[find_twins(usual.head.skin.vertices)] * [-1.0, 1.0, 1.0]
    assert np.abs(mirrored - skin.vertices).max() < 1e-6
    assert np.ptp(skin.vertices[:, 1]) > 1.15 * np.ptp(usual.head.skin.vertices[:, 1])
    stylised = usual.change(skin, 1)
    assert check_head(stylised.head).inverted_tets == 0
    answer = watch_pd(stylised.face(case.parameters(stylised.head))).solve(case.weights)
    moved = np.linalg.norm(answer.skin - skin.vertices, axis=1)
    assert 5.0 < moved.max() < 40.0


def test_a_case_of_ones_own_is_asked_like_the_others(monkeypatch):
    monkeypatch.setitem(CASES, "grin", None)  # so that it is gone after the test
    del CASES["grin"]
    grin = add_case(
        Case("grin", "a stiff smile", {"mouthSmileLeft": 0.5}, lambda head: Parameters(skin_stiffness=80.0))
    )
    assert get_case("grin") is grin and grin.weights.sum() == 0.5
    study = Agreement(cases=("grin",))
    assert [task.case for task in study.tasks()] == ["grin"]
    assert {FENICSX, CARRIED} < {getattr(method, "name", method) for method in study.list_methods("grin")}


def test_wraps_are_carried_by_a_scaled_mandible(head):
    parameters = Parameters(mandible_scale_y=1.1)
    n = len(head.bone)
    moved = (carry_by_bones(head, parameters) - head.vertices).reshape(3, n, 3)
    np.testing.assert_allclose(moved[0], moved[2], atol=1e-12)
    jaw, cranium = moved[0][head.bone == 2, 1], moved[0][head.bone == 1]
    y = head.skull_wrap.vertices[head.bone == 2, 1]
    # A scale by 1.1 moves two points of the bone apart by a tenth of their distance.
    np.testing.assert_allclose(np.subtract.outer(jaw, jaw), 0.1 * np.subtract.outer(y, y), atol=1e-12)
    assert np.abs(cranium).max() < 1e-12
    rings = [set() for _ in range(n)]
    for a, b, c in head.skull_wrap.triangles:
        rings[a] |= {b, c}
        rings[b] |= {a, c}
        rings[c] |= {a, b}
    for vertex in np.flatnonzero(head.bone == 0):
        np.testing.assert_allclose(moved[0][vertex], moved[0][list(rings[vertex])].mean(axis=0), atol=1e-9)
    np.testing.assert_array_equal(carry_by_bones(head, Parameters()), head.vertices)


def test_a_face_settles_about_bones_at_their_scaled_rest(head):
    parameters = Parameters(mandible_scale_y=1.15)
    fixed = neutral_scene(head, parameters).of(terms.Fixed)[0]
    bone = head.bone > 0
    np.testing.assert_allclose(fixed.values, scale_skull(head, parameters)[bone], atol=1e-12)
    # A mandible that is prescribed stays there as long as the settled skin over it does.
    settled = settle(head, parameters)
    faces = (Face(head, parameters=parameters, choices=choices) for choices in ({}, {"bones": "prescribed"}))
    still = [term for face in faces for term in face.settled_as(settled).neutral_scene().of(terms.Fixed)]
    np.testing.assert_allclose(still[-1].values, scale_skull(head, parameters)[bone], atol=1e-9)


def test_a_neutral_face_without_an_effect_is_at_rest(head):
    scene = neutral_scene(head, Parameters())
    solution = solve(scene)
    assert solution.iterations == 0 and abs(solution.energy) < 1e-9


def test_flesh_that_grows_is_not_held_by_the_old_surface(head):
    parameters = Parameters(soft_volume=1.0 + 0.2 * mean_on_triangles(head, flesh_share(head)))
    held = solve(facial_scene(head, parameters, head.skin.vertices, bones="prescribed"))
    free = solve(neutral_scene(head, parameters))
    grown = parameters.soft_volume.repeat(3) > 1.19
    volumes = free_volumes = head.soft.volumes[grown]
    gains = [s.volume_ratio[: len(grown)][grown] @ volumes / free_volumes.sum() - 1.0 for s in (held, free)]
    assert 0.0 < gains[0] < gains[1] < 0.2


@pytest.mark.parametrize("changes", [{}, {"soft_stiffness": 2.0, "paralysis_left": 1.0}, {"strain_limit": 1.1}])
def test_what_leaves_the_neutral_face_alone_costs_no_solve(head, changes):
    at_rest = settle(head, Parameters(**changes))
    assert at_rest.solution is None and at_rest.converged and at_rest.reason is Reason.CONVERGED
    np.testing.assert_array_equal(at_rest.skin, head.skin.vertices)
    np.testing.assert_array_equal(
        at_rest.positions, Face(head, parameters=Parameters(**changes)).neutral_scene().vertices
    )


@pytest.mark.parametrize("layers", [(1, 1), (2, 1)])
def test_the_settled_face_moves_with_its_flesh_and_bones(head, layers):
    heavier = settle(
        head, Parameters(soft_volume=1.0 + 0.2 * mean_on_triangles(head, flesh_share(head))), layers=layers
    )
    out = np.einsum("ij,ij->i", heavier.displacement, head.skin.vertices) / 100.0
    share = head.skin_from_wrap @ flesh_share(head)
    assert heavier.converged and out[share > 0.9].mean() > 0.2
    assert np.abs(heavier.displacement[share == 0.0]).max() < 0.3 * out.max()
    face = Face(head, parameters=Parameters(mandible_scale_y=1.15), choices={"layers": layers}, settling={})
    longer, jaw = face.settled(), head.bone == 2
    lower = face.neutral_scene().vertices, longer.positions
    n, first = len(head.bone), sum(layers) * len(head.bone)
    moved = (lower[1] - lower[0])[first : first + n][jaw, 1]
    assert moved.min() < -0.5 and longer.displacement[:, 1].min() < 0.9 * moved.min()


def test_a_head_without_regions_is_held_everywhere(sphere_head):
    scene = facial_scene(sphere_head, Parameters(soft_volume=1.2), sphere_head.skin.vertices, bones="prescribed")
    held = solve(scene, tolerance=1e-6).positions
    np.testing.assert_allclose(settle(sphere_head, Parameters(soft_volume=1.2)).positions, held, atol=1e-3)


def test_an_expression_under_an_effect_starts_from_its_neutral_face(head, monkeypatch):
    # Where all targets let go, and no bone is free, the settled face is in balance with targets that follow it.
    monkeypatch.setattr("softdeca.reference.face.settle.flesh_share", lambda head: np.ones(len(head.bone)))
    toothless = replace(head, bone=np.where(head.bone == 1, 1, 0))
    rig = watch_pd(moved_face(toothless, Parameters(gravity=3.0)))
    at_rest, solution = rig.settled, rig.solve(np.zeros(52)).solution
    first = solve(facial_scene(toothless, Parameters(gravity=3.0), head.skin.vertices, bones="rigid"), max_iterations=0)
    assert at_rest.converged and at_rest.solution.converged
    assert solution.history.gradient_norm[0] < 1e-5 * first.history.gradient_norm[0]


def test_palsy_is_measured(head):
    case = CASES["bells-palsy"]
    face = moved_face(head, case.parameters(head), [0.0, 4.0, 0.0])
    x, _, z = head.skin.vertices.T
    left = (x > 20) & (z > 40)  # of the face; the rest stays tied
    weights = np.eye(52)[0]
    without, answer = (rig.solve(weights) for rig in (leave_out(case, face), watch_pd(face)))
    up = [each.skin[left, 1].mean() - head.skin.vertices[left, 1].mean() for each in (without, answer)]
    assert up[1] < 0.5 * up[0]
    assert answer.told["energy_rise"] < 1e-12 and answer.told["least_ratio"] > 0.0
    assert np.abs(start_elsewhere(face).solve(weights).positions - answer.positions).max() < 1e-5


def test_an_open_jaw_puts_no_lining_through_a_palsied_cheek():
    """And a frame is told in which it is put there by hand."""
    someone = person(level=2, seed=None)
    face = Face(someone.head, someone.shapes, Parameters(paralysis_left=1.0), per="wraps")
    expression = face.blend(expressions.weights_of({"jawOpen": 1.0}))
    answer = solve(face.expression_scene(expression))
    assert answer.converged and face.count_crossings(face.expression_skin(expression, answer.positions)) == 0
    through = expression.copy()
    lining = someone.head.on_skin(["mouth"]) & (expression[:, 0] > 15.0)
    through[lining] += [10.0, 0.0, 10.0]
    assert face.count_crossings(through) > 10


def moved_face(head, parameters, by=(0.0, 0.0, 0.0)):
    """A face whose every expression moves all of the skin by `by` [mm] a weight."""
    return Face(head, np.tile(by, (52, len(head.skin.vertices), 1)), parameters, per="wraps", choices={"cells": "tets"})
