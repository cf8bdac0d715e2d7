"""Made-up takes: in range, not contradictory, with the rhythm and speeds that they claim."""

import importlib.util

import numpy as np
import pytest
from scipy.signal import find_peaks

from softdeca.lhm.expressions import (
    ARKIT,
    conversation,
    conversation_take,
    index,
    read_take,
    resample,
    speech,
)

needs_openfacefx = pytest.mark.skipif(importlib.util.find_spec("openfacefx") is None, reason="no openfacefx")
MINUTES = 2.0


@pytest.fixture(scope="module", params=[0, 1])
def talk(request):
    return conversation(np.random.default_rng(request.param), round(MINUTES * 3600))


def of(weights, name):
    return weights[:, index(name)]


def test_range_and_speed_are_those_of_a_real_take(talk, data):
    """Against a recorded range of motion, which goes farther than talk: half to one time its spread, its speeds."""
    real = resample(read_take(data / "arkit_sequences" / "alex_rom_3.csv"), 60.0).weights
    face = [k for k, name in enumerate(ARKIT) if name.startswith(("mouth", "jaw", "brow"))]
    spread = talk.std(axis=0) / real.std(axis=0)
    fast_talk, fast_real = (np.percentile(60 * np.abs(np.diff(w, axis=0)), 99, axis=0) for w in (talk, real))
    assert 0.4 < np.median(spread) < 1.0  # measured .64 to .70
    assert 0.67 < np.median((fast_talk / fast_real)[face]) < 1.5  # measured 1.00 to 1.05


# Head motion


def test_a_conversation_as_a_take_has_its_weights_and_a_head():
    take = conversation_take(np.random.default_rng(3), 90, rate=30.0)
    assert np.array_equal(take.weights, conversation(np.random.default_rng(3), 90, rate=30.0))
    assert np.array_equal(take.head, conversation_take(np.random.default_rng(3), 90, rate=30.0).head)
    assert take.rate == 30.0 and take.times[-1] == pytest.approx(89 / 30) and take.synthetic
    assert np.ptp(take.head, axis=0).max() > 0.01


# Random expressions and speech


@needs_openfacefx
def test_speech_closes_the_lips_at_every_bilabial():
    """Eight of b, m and p in "Pam, Bob; my map": the lips close at each that is apart from its neighbour."""
    take = speech("Pam, Bob; my map.", pace=8.0)
    closed = of(take.weights, "mouthPressLeft")
    assert len(find_peaks(closed, height=0.4)[0]) >= 6
    assert (of(take.weights, "jawOpen")[closed > 0.4] < 0.2).all()
    assert of(take.weights, "jawOpen").max() > 0.4
    assert take.rate == 60.0 and "openfacefx" in take.synthetic and take.head is None
