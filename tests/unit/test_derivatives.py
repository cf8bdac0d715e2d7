"""Derivatives of a settled face against differences of tight solves, and frames that depend on themselves alone."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm.base.errors import InputError
from softdeca.lhm.base.geometry import cholesky
from softdeca.reference import Face, Parameters, SettledFace, facial_scene, prepare, solve, terms
from softdeca.reference.face.correction import predict
from softdeca.reference.face.derivatives import FRAME_ACCURACY, TIGHT_ACCURACY, spring_norm
from softdeca.reference.problems import meshes
from softdeca.surrogate.corpus.spheres import Spheres

SPACE, CODE = Spheres(2), np.array([0.3, -0.5, 0.2, 0.8])
PLAIN = SPACE.fit(SPACE.skin(CODE))
_FRONT = PLAIN.skin_wrap.vertices[:, 2]
EYED = replace(PLAIN, regions={"lids": (_FRONT > 50.0) & (_FRONT <= 80.0), "eyes": _FRONT > 80.0})
DELTAS = SPACE.expression_deltas(CODE)
NEUTRAL = PLAIN.skin.vertices
X, TETS = meshes.block(2)
TARGETS = NEUTRAL + 1.5 * DELTAS[3]
SETTLES = Parameters(soft_volume=1.1, gravity=1.5, soft_stiffness=2.0, mandible_scale_y=1.05)
ALL = Parameters(
    soft_stiffness=2.0, soft_volume=1.05, muscle_volume=0.95, skin_growth=1.02, skin_bending=5.0, gravity=2.0,
    gravity_x=0.2, mandible_scale_y=1.05, cranium_scale_x=1.01, paralysis_left=0.3,
)  # fmt: skip


def scene_at(parameters, targets):
    return facial_scene(EYED, parameters, targets)


def tight_face(parameters, head=PLAIN, **choices):
    return Face(head, DELTAS, parameters, choices=choices, settling={"tolerance": 1e-10}, accuracy=TIGHT_ACCURACY)


def frame(face, weights, accuracy=FRAME_ACCURACY):
    """A frame in the metric of the Hessian at rest, begun at the first order."""
    scene, linear = face.scene(weights), face.derivatives
    absolute = accuracy * spring_norm(scene)
    return linear.prepared.solve(
        scene, start=predict(face, weights), absolute=absolute, metric=linear.tangent, untangle=False
    )


@pytest.fixture(scope="module")
def face():
    return tight_face(SETTLES)


@pytest.fixture(scope="module")
def expressed():
    """An answer with all of p, and its tangent."""
    prepared = prepare(scene_at(ALL, TARGETS))
    answer = prepared.solve(tolerance=1e-12)
    tangent = prepared.tangent(answer)
    assert tangent.is_exact
    return answer, tangent


def assert_near(derivative, difference, share=1e-3, least=1e-9):
    assert np.abs(difference).max() > least, "nothing moves"
    assert np.abs(derivative - difference).max() < share * np.abs(difference).max()


HELD = [{"region": _FRONT > 20.0}, {"bones": "prescribed"}]
"""Choices by which an expression moves what is held."""


@pytest.mark.parametrize("palsied, choices", [(False, {}), (True, {}), *((False, held) for held in HELD)])
def test_shapes_move_vertices_and_skin_as_frames_do(face, palsied, choices):
    """With bones that p scales, what moves beside the targets, and where half of the face is paralysed."""
    if choices:
        face = tight_face(SETTLES, **choices)
    if palsied:
        face = tight_face(ALL, EYED).settled_as(SettledFace(EYED.vertices, NEUTRAL, TARGETS - NEUTRAL))
    vertices, skin = face.first_order, face.responses + DELTAS
    assert face.derivatives.is_exact
    assert vertices.shape == (52, *PLAIN.vertices.shape) and skin.shape == (52, *NEUTRAL.shape)
    for shape in (0, 3, 17, 30):
        weights = [h * np.eye(52)[shape] for h in (0.01, -0.01)]
        solutions = [frame(face, w, 1e-9) for w in weights]
        assert all(solution.converged for solution in solutions)
        assert_near(vertices[shape], (solutions[0].positions - solutions[1].positions) / 0.02)
        skins = [face.skin_after(w, solution.positions) for w, solution in zip(weights, solutions, strict=True)]
        assert_near(skin[shape], (skins[0] - skins[1]) / 0.02)


NAMES = (
    "soft_stiffness", "volume_ratio", "soft_volume", "skin_growth", "skin_bending", "target_stiffness", "gravity",
    "gravity_x", "mandible_scale_y", "paralysis_left",
)  # fmt: skip
FIELDS = ("muscle_volume", "skin_bending", "soft_stiffness", "target_stiffness")


@pytest.mark.parametrize("names", [NAMES, FIELDS])
def test_frames_move_with_p_as_differences_say(names):
    """Each parameter, or each triangle's, moves so far that all change the frame alike; the face settles anew."""
    rng = np.random.default_rng(0)
    cotangent, weights = rng.normal(size=NEUTRAL.shape), np.eye(52)[3] + 0.5 * np.eye(52)[20]
    face = tight_face(ALL, EYED)
    if names is FIELDS:
        triangles = len(EYED.skin_wrap.triangles)
        fields = {name: getattr(ALL, name) * rng.uniform(0.95, 1.05, triangles) for name in names}
        face = replace(face, parameters=replace(ALL, **fields), per="wraps")
    derivatives = face.vjp(cotangent, weights, names)
    if names is NAMES:
        for name, moved in face.jvp(weights, names).items():
            assert np.sum(cotangent * moved) == pytest.approx(derivatives[name], rel=1e-5)
    size = 1e-3 * min(np.linalg.norm(derivative) for derivative in derivatives.values())
    steps = {name: size * derivative / np.sum(derivative**2) for name, derivative in derivatives.items()}
    ahead, behind = (
        replace(
            face, parameters=replace(face.parameters, **{n: getattr(face.parameters, n) + s * steps[n] for n in names})
        )
        for s in (1.0, -1.0)
    )
    difference = np.sum(cotangent * (ahead.frame(weights) - behind.frame(weights)))
    assert difference == pytest.approx(2.0 * size * len(names), rel=1e-4)


@pytest.mark.parametrize(
    "choices, parameters, name, told",
    [
        ({}, SETTLES, "stiffness", "unknown parameter"),
        (
            {},
            Parameters(skin_growth=np.full(len(PLAIN.skin.triangles), 1.1)),
            "skin_growth",
            "per triangle of the wraps",
        ),
        (HELD[1], SETTLES, "gravity", "jvp takes it"),
        ({"contact": [PLAIN.skin_wrap.vertices[:, 1] > 90.0]}, SETTLES, "mandible_scale_x", "in contact"),
    ],
)
def test_what_has_no_derivative_says_so(choices, parameters, name, told):
    face = tight_face(parameters, **choices)
    with pytest.raises(InputError, match=told):
        face.vjp(np.ones_like(NEUTRAL), np.zeros(52), [name])


def test_a_spring_that_vanishes_may_not_be_the_first_target(expressed):
    """Another Target behind the first stays where it is."""
    answer, tangent = expressed
    more = replace(tangent.scene, terms=(*tangent.scene.terms, terms.Target([0], EYED.vertices[:1], 0.0)))
    assert len(prepare(more).tangent(answer).vertices_by_targets(DELTAS[:1])) == 1


def test_a_frame_does_not_depend_on_those_before(face):
    expressions = [np.eye(52)[k] + np.eye(52)[k + 1] for k in (0, 10, 20)]
    forwards = [frame(face, weights).positions for weights in expressions]
    again = (replace(face) for _ in expressions)
    backwards = [frame(other, weights).positions for other, weights in zip(again, expressions[::-1], strict=True)]
    for one, other in zip(forwards, reversed(backwards), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_frame_is_the_minimum_that_a_cold_solve_finds(face):
    weights = 0.5 * np.eye(52)[4]
    quick, cold = frame(face, weights, 1e-8), solve(face.scene(weights), tolerance=1e-9)
    assert quick.iterations < cold.iterations
    np.testing.assert_allclose(quick.positions, cold.positions, atol=1e-4)


@pytest.mark.skipif(not cholesky.has_cholmod(), reason="scikit-sparse is not installed")
def test_another_face_takes_three_factors_and_no_analysis(monkeypatch):
    """Of the PD matrices in which it settles and rests, and of the tangent."""
    made = []

    def count(kind):
        monkeypatch.setattr(cholesky, kind.__name__, lambda *given: made.append(kind.__name__) or kind(*given))

    first, second = (Face(PLAIN, DELTAS, replace(SETTLES, gravity=gravity)) for gravity in (1.5, 2.0))
    assert first.first_order.shape == (52, *PLAIN.vertices.shape)
    count(cholesky.CholmodAnalysis)
    count(cholesky.CholmodFactor)
    assert second.first_order.shape == first.first_order.shape
    assert made == 3 * ["CholmodFactor"]


def test_contact_that_does_not_touch_changes_no_derivative(face):
    touching = replace(face, choices={"contact": [PLAIN.skin_wrap.vertices[:, 1] > 90.0]})
    np.testing.assert_array_equal(touching.responses, face.responses)
