"""A settled face's tangent: responses through what settles first, and frames that depend on themselves alone."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm.base.errors import SceneError
from softdeca.reference import Parameters
from softdeca.reference.face.linearised import linearised
from softdeca.reference.face.settling import settled
from softdeca.surrogate.sphere import Spheres

SPACE, CODE = Spheres(2), np.array([0.3, -0.5, 0.2, 0.8])
HEAD = SPACE.fit(SPACE.skin(CODE))
DELTAS = SPACE.expression_deltas(CODE)
NEUTRAL = HEAD.skin.vertices
P = Parameters(soft_volume=1.1, gravity=1.5, soft_stiffness=2.0, mandible_scale_y=1.05)


@pytest.fixture(scope="module")
def face():
    return linearised(settled(HEAD, P, tolerance=1e-10))


def neutral_skin(parameters):
    """The simulated neutral skin, all solved anew."""
    found = linearised(settled(HEAD, parameters, tolerance=1e-10))
    return found.face.skin + found.offset


@pytest.mark.parametrize("name", ["soft_volume", "gravity", "soft_stiffness", "mandible_scale_y", "cranium_scale_x"])
def test_a_parameter_moves_the_neutral_skin_through_the_face_that_settles(face, name):
    h = 2e-4
    ends = [neutral_skin(replace(P, **{name: getattr(P, name) + t})) for t in (h, -h)]
    difference = (ends[0] - ends[1]) / (2 * h)
    assert np.abs(difference).max() > 1e-3, "nothing moves"
    found = face.of_parameters({name: 1.0, "volume_ratio": 1.0})[name]
    assert np.abs(found - difference).max() < 1e-3 * np.abs(difference).max()


def test_shapes_move_the_skin_as_frames_do(face):
    found = face.of_expressions(DELTAS)
    assert face.exact and found.shape == (52, *NEUTRAL.shape)
    for shape in (2, 30):
        skins = []
        for h in (0.01, -0.01):
            solution = face.solve(NEUTRAL + h * DELTAS[shape], accuracy=1e-9)
            assert solution.converged
            skins.append(face.face.skin_after(NEUTRAL + h * DELTAS[shape], solution.positions))
        difference = (skins[0] - skins[1]) / 0.02
        assert np.abs(found[shape] - difference).max() < 1e-3 * np.abs(difference).max()


def test_a_frame_does_not_depend_on_those_before(face):
    expressions = [NEUTRAL + DELTAS[k] + DELTAS[k + 1] for k in (0, 10, 20)]
    forwards = [face.solve(expression).positions for expression in expressions]
    backwards = [linearised(face.face, like=face).solve(expression).positions for expression in reversed(expressions)]
    for one, other in zip(forwards, reversed(backwards), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_frame_is_the_minimum_that_a_cold_solve_finds(face):
    expression = NEUTRAL + 0.5 * DELTAS[4]
    found, cold = (
        face.solve(expression, accuracy=1e-8),
        face.prepared.solve(face.face.scene(expression), tolerance=1e-9),
    )
    assert found.iterations < cold.iterations
    np.testing.assert_allclose(found.positions, cold.positions, atol=1e-4)


def test_contact_is_refused():
    with pytest.raises(SceneError, match="knows no Contact"):
        linearised(settled(HEAD, P, contact=[HEAD.skin_wrap.vertices[:, 1] > 90.0]))
