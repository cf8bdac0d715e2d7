"""Made-up head motion: small, about straight ahead, with speeds and accelerations of a head that talks."""

import numpy as np
import pytest

from softdeca.lhm import InputError
from softdeca.lhm.expressions import conversation, conversation_take, head_motion
from softdeca.lhm.expressions.made_up import BEATS, POSTURE


@pytest.mark.parametrize("rate", [24.0, 60.0])
def test_angles_spread_as_stated_about_straight_ahead_from_the_first_on(rate):
    found = head_motion(np.random.default_rng(0), round(1800 * rate), rate=rate)
    spread = np.hypot(POSTURE, BEATS)
    assert found.std(axis=0) == pytest.approx(spread, rel=0.1)
    assert np.all(np.abs(found.mean(axis=0)) < 0.1 * spread)
    first = np.array([head_motion(np.random.default_rng(k), 1, rate=rate)[0] for k in range(400)])
    assert first.std(axis=0) == pytest.approx(spread, rel=0.15)


def test_it_moves_as_a_head_does_without_jerks():
    """Some 10 deg/s, at most 100; the acceleration goes on from frame to frame: it is no noise."""
    found = head_motion(np.random.default_rng(1), 60 * 600)
    speed = np.degrees(np.linalg.norm(np.diff(found, axis=0), axis=1)) * 60
    assert 5 < np.median(speed) < 20 and speed.max() < 100
    bent = np.diff(found, n=2, axis=0)
    assert np.all(np.sum(bent[1:] * bent[:-1], axis=0) > 0.7 * np.sum(bent**2, axis=0))


def test_a_conversation_as_a_take_has_its_weights_and_a_head():
    take = conversation_take(np.random.default_rng(3), 90, rate=30.0)
    assert np.array_equal(take.weights, conversation(np.random.default_rng(3), 90, rate=30.0))
    assert np.array_equal(take.head, conversation_take(np.random.default_rng(3), 90, rate=30.0).head)
    assert take.rate == 30.0 and take.times[-1] == pytest.approx(89 / 30) and take.synthetic
    assert np.ptp(take.head, axis=0).max() > 0.01


def test_what_it_cannot_make_is_said():
    with pytest.raises(InputError, match="frames: 0, expected 1 or more"):
        head_motion(np.random.default_rng(0), 0)
    with pytest.raises(InputError, match="rate: 0 Hz"):
        head_motion(np.random.default_rng(0), 3, rate=0.0)
