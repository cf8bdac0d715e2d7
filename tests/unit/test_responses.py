"""Responses to expressions and parameters against differences of tight solves, with bones that p scales."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm.base.errors import InputError
from softdeca.reference import Parameters, facial_scene, prepare, terms
from softdeca.reference.face.responses import expression_responses, parameter_responses, skin_responses
from softdeca.surrogate.sphere import Spheres

SPACE, CODE = Spheres(2), np.array([0.3, -0.5, 0.2, 0.8])
_FITTED = SPACE.fit(SPACE.skin(CODE))
_FRONT = _FITTED.skin_wrap.vertices[:, 2]
HEAD = replace(_FITTED, regions={"lids": (_FRONT > 50.0) & (_FRONT <= 80.0), "eyes": _FRONT > 80.0})
DELTAS = SPACE.expression_deltas(CODE)
TARGETS = HEAD.skin.vertices + 1.5 * DELTAS[3]
P = Parameters(
    soft_stiffness=2.0,
    soft_volume=1.05,
    muscle_volume=0.95,
    skin_growth=1.02,
    skin_bending=5.0,
    gravity=2.0,
    gravity_x=0.2,
    mandible_scale_y=1.05,
    cranium_scale_x=1.01,
    paralysis_left=0.3,
)
STATIC = [i.name for i in Parameters.infos() if i.name not in ("frequency", "damping", "connector_ratio")]


def scene_at(parameters, targets):
    return facial_scene(HEAD, parameters, targets)


def tight(parameters, targets, near):
    return prepare(scene_at(parameters, targets)).solve(start=near.positions, tolerance=1e-10).positions


@pytest.fixture(scope="module")
def settled():
    prepared = prepare(scene_at(P, TARGETS))
    answer = prepared.solve(tolerance=1e-12)
    tangent = prepared.tangent(answer)
    assert tangent.exact
    return answer, tangent


def assert_near(found, difference, share=1e-3):
    assert np.abs(difference).max() > 1e-9, "nothing moves"
    assert np.abs(found - difference).max() < share * np.abs(difference).max()


@pytest.mark.parametrize("shape", [0, 3, 17])
def test_an_expression_moves_the_face_as_differences_say(settled, shape):
    answer, tangent = settled
    moved = expression_responses(tangent, HEAD, P, DELTAS)
    assert moved.shape == (52, *HEAD.vertices.shape)
    ends = [tight(P, TARGETS + h * DELTAS[shape], answer) for h in (0.01, -0.01)]
    assert_near(moved[shape], (ends[0] - ends[1]) / 0.02)
    goals = [TARGETS + h * DELTAS[shape] for h in (0.01, -0.01)]
    skins = [HEAD.skin_after(goal, x[: len(HEAD.bone)]) for goal, x in zip(goals, ends, strict=True)]
    assert_near(skin_responses(HEAD, moved, DELTAS)[shape], (skins[0] - skins[1]) / 0.02)


@pytest.mark.parametrize("name", [name for name in STATIC if name not in ("strain_limit", "gravity_y")])
def test_a_parameter_moves_the_face_as_differences_say(settled, name):
    """Scaled bones move what is held, and a rigid body's rest."""
    answer, tangent = settled
    info, value = Parameters.info(name), getattr(P, name)
    moved = parameter_responses(tangent, scene_at, P, TARGETS, {name: 1.0})[name]
    side = -1.0 if value >= info.high else 1.0
    h = side * 5e-4 * (info.high - info.low)
    if info.low < value < info.high:
        weights = {h: 0.5 / h, -h: -0.5 / h}
    else:
        weights = {0.0: -1.5 / h, h: 2.0 / h, 2 * h: -0.5 / h}
    difference = sum(w * tight(replace(P, **{name: value + t}), TARGETS, answer) for t, w in weights.items())
    assert_near(moved, difference)


def test_the_strain_limit_where_its_energy_is_smooth():
    """At a limit of 1 each stretch of 1 is a kink; tissue stretched beyond a higher limit has none near."""
    grown = Parameters(strain_limit=1.02, soft_volume=1.5, muscle_volume=1.3, muscle_strain_ratio=1.0)
    prepared = prepare(scene_at(grown, TARGETS))
    answer = prepared.solve(tolerance=1e-12)
    moved = parameter_responses(prepared.tangent(answer), scene_at, grown, TARGETS, {"strain_limit": 1.0})
    ends = [tight(replace(grown, strain_limit=1.02 + h), TARGETS, answer) for h in (1e-4, -1e-4)]
    assert_near(moved["strain_limit"], (ends[0] - ends[1]) / 2e-4, share=2e-2)


def test_a_local_parameter_along_a_direction_and_targets_that_drift(settled):
    answer, tangent = settled
    rng = np.random.default_rng(0)
    local = replace(P, soft_volume=1.05 + np.zeros(len(HEAD.skin.triangles)))
    along, drift = rng.uniform(size=len(HEAD.skin.triangles)), 3.0 * DELTAS[7]
    moved = parameter_responses(tangent, scene_at, local, TARGETS, {"soft_volume": along}, drift={"soft_volume": drift})
    h = 1e-3
    ends = [tight(replace(P, soft_volume=local.soft_volume + t * along), TARGETS + t * drift, answer) for t in (h, -h)]
    assert_near(moved["soft_volume"], (ends[0] - ends[1]) / (2 * h))


def test_a_spring_that_vanishes_may_not_be_the_first_target(settled):
    """Another Target behind the first stays where it is."""
    answer, tangent = settled
    more = replace(tangent.scene, terms=(*tangent.scene.terms, terms.Target([0], HEAD.vertices[:1], 0.0)))
    assert len(prepare(more).tangent(answer).of_targets(DELTAS[:1])) == 1


def test_wrong_directions_are_named(settled):
    _, tangent = settled
    with pytest.raises(InputError, match="unknown parameter 'weight'"):
        parameter_responses(tangent, scene_at, P, TARGETS, {"weight": 1.0})
    with pytest.raises(InputError, match="gravity: a direction to vary it along must be finite and not zero"):
        parameter_responses(tangent, scene_at, P, TARGETS, {"gravity": 0.0})
    both = np.where(np.arange(len(HEAD.skin.triangles)) % 2, 0.8, 1.5)
    with pytest.raises(InputError, match=r"soft_volume: it cannot vary along this direction within \[0.8, 1.5\]"):
        parameter_responses(tangent, scene_at, replace(P, soft_volume=both), TARGETS, {"soft_volume": 1.0})
