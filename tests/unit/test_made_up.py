"""Made-up takes: in range, not contradictory, with the rhythm and speeds that they claim."""

import builtins
import importlib.util

import numpy as np
import pytest
from scipy.signal import find_peaks

from softdeca.lhm.base.errors import MissingDependencyError
from softdeca.lhm.expressions import (
    ARKIT,
    combinations,
    conversation,
    conversation_take,
    head_motion,
    index,
    read_take,
    resample,
    sample_weights,
    speech,
)
from softdeca.lhm.expressions.made_up import TALKER, contradict, hard_expressions, shipped_sentences

from ..refusals import refused

needs_openfacefx = pytest.mark.skipif(importlib.util.find_spec("openfacefx") is None, reason="no openfacefx")
CLOSED = ("mouthPressLeft", "mouthPressRight", "mouthRollUpper", "mouthRollLower")
MINUTES = 2.0
EXCLUSIVE = [
    ("jawLeft", "jawRight"),
    ("mouthLeft", "mouthRight"),
    *((f"mouthSmile{side}", f"mouthFrown{side}") for side in ("Left", "Right")),
    *((f"browOuterUp{side}", f"browDown{side}") for side in ("Left", "Right")),
    *((f"eyeLookUp{side}", f"eyeLookDown{side}") for side in ("Left", "Right")),
    *((f"eyeLookIn{side}", f"eyeLookOut{side}") for side in ("Left", "Right")),
]
NEVER_BOTH_LARGE = [
    ("eyeBlinkLeft", "eyeWideLeft"),
    ("eyeBlinkRight", "eyeWideRight"),
    ("mouthPucker", "mouthStretchLeft"),
    ("mouthPucker", "mouthSmileRight"),
]


@pytest.fixture(scope="module", params=[0, 1])
def talk(request):
    return conversation(np.random.default_rng(request.param), round(MINUTES * 3600))


def of(weights, name):
    return weights[:, index(name)]


def test_weights_are_in_range_and_all_expressions_but_the_tongue_occur(talk):
    assert talk.shape == (7200, 52) and talk.min() >= 0.0 and talk.max() <= 1.0
    assert np.flatnonzero(talk.max(axis=0) <= 0.05).tolist() == [index("tongueOut")]


def test_the_same_seed_gives_the_same_talk(talk):
    again = [conversation(np.random.default_rng(seed), 500) for seed in (7, 7, 8)]
    np.testing.assert_array_equal(again[0], again[1])
    assert np.abs(again[0] - again[2]).max() > 0.1


def test_contradictory_expressions_are_not_made(talk):
    for first, second in EXCLUSIVE:
        assert np.minimum(of(talk, first), of(talk, second)).max() == 0.0, (first, second)
    for first, second in NEVER_BOTH_LARGE:
        assert np.minimum(of(talk, first), of(talk, second)).max() < 0.45, (first, second)
    assert (of(talk, "mouthClose") <= of(talk, "jawOpen")).all()


def test_blinks_come_every_few_seconds_and_are_short(talk):
    """A blink and the pause after it last between 2.1 and 6.4 s: 9.4 to 28.6 per minute."""
    lids = of(talk, "eyeBlinkLeft")
    peaks = find_peaks(lids, height=0.7, distance=60)[0]
    assert 9 * MINUTES <= len(peaks) <= 29 * MINUTES
    closed = np.diff(np.flatnonzero(np.diff(np.r_[0, lids > 0.5, 0]))[: 2 * len(peaks)])[::2] / 60.0
    assert closed.max() < 0.4


@pytest.mark.parametrize(("seconds", "rate"), [(2.0, 60.0), (2.0, 30.0), (10.0, 60.0)])
def test_every_conversation_closes_its_lids_and_smiles_broadly(seconds, rate):
    for seed in range(50):
        talk = conversation(np.random.default_rng(seed), round(seconds * rate), rate=rate)
        lids = np.minimum(of(talk, "eyeBlinkLeft"), of(talk, "eyeBlinkRight"))
        smile = np.minimum(of(talk, "mouthSmileLeft"), of(talk, "mouthSmileRight"))
        assert lids.max() > 0.999 and smile.max() > 0.6, seed


def test_range_and_speed_are_those_of_a_real_take(talk, data):
    """Against a recorded range of motion, which goes farther than talk: half to one time its spread, its speeds."""
    real = resample(read_take(data / "arkit_sequences" / "alex_rom_3.csv"), 60.0).weights
    face = [k for k, name in enumerate(ARKIT) if name.startswith(("mouth", "jaw", "brow"))]
    spread = talk.std(axis=0) / real.std(axis=0)
    fast_talk, fast_real = (np.percentile(60 * np.abs(np.diff(w, axis=0)), 99, axis=0) for w in (talk, real))
    assert 0.4 < np.median(spread) < 1.0  # measured .64 to .70
    assert 0.67 < np.median((fast_talk / fast_real)[face]) < 1.5  # measured 1.00 to 1.05


# Head motion


@pytest.mark.parametrize("rate", [24.0, 60.0])
def test_angles_spread_as_stated_about_straight_ahead_from_the_first_on(rate):
    found = head_motion(np.random.default_rng(0), round(1800 * rate), rate=rate)
    spread = np.radians(np.hypot(TALKER.posture, TALKER.beats))
    assert found.std(axis=0) == pytest.approx(spread, rel=0.1)
    assert np.all(np.abs(found.mean(axis=0)) < 0.1 * spread)
    first = np.array([head_motion(np.random.default_rng(k), 1, rate=rate)[0] for k in range(400)])
    assert first.std(axis=0) == pytest.approx(spread, rel=0.15)


def test_a_conversation_as_a_take_has_its_weights_and_a_head():
    take = conversation_take(np.random.default_rng(3), 90, rate=30.0)
    assert np.array_equal(take.weights, conversation(np.random.default_rng(3), 90, rate=30.0))
    assert np.array_equal(take.head, conversation_take(np.random.default_rng(3), 90, rate=30.0).head)
    assert take.rate == 30.0 and take.times[-1] == pytest.approx(89 / 30) and take.synthetic
    assert np.ptp(take.head, axis=0).max() > 0.01


# Random expressions and speech


def test_expressions_are_sparse_and_not_contradictory():
    rng = np.random.default_rng(0)
    drawn = np.stack([sample_weights(rng) for _ in range(500)])
    assert drawn.min() >= 0.0 and drawn.max() <= 1.0
    active = drawn > 0
    assert 2.0 < active.sum(axis=1).mean() < 8.0
    assert 0.55 < active[:, ARKIT.index("jawOpen")].mean() < 0.65
    assert active.any(axis=0).all()
    assert np.all(drawn[:, ARKIT.index("mouthClose")] <= drawn[:, ARKIT.index("jawOpen")])
    for row in active:
        names = [ARKIT[k] for k in np.flatnonzero(row)]
        assert not any(contradict(a, b) for a in names for b in names if a != b)


def test_combinations_move_smoothly_from_one_to_another():
    weights = combinations(np.random.default_rng(0), 20_000)
    assert weights.min() >= 0.0 and weights.max() <= 1.0 and weights.max(axis=0).min() > 0.5
    # A smooth step of at least 0.15 s has a slope of at most 1.5 / 0.15 = 10 a second.
    assert 5.0 < 60.0 * np.abs(np.diff(weights, axis=0)).max() <= 10.0
    still = np.abs(np.diff(weights, axis=0)).max(axis=1) < 1e-9
    assert 0.2 < still.mean() < 0.8
    for k, first in enumerate(ARKIT):
        for j, other in enumerate(ARKIT[:k]):
            if contradict(first, other):
                assert np.minimum(weights[:, k], weights[:, j]).max() < 0.15, (first, other)
    again = combinations(np.random.default_rng(0), 20_000)
    np.testing.assert_array_equal(weights, again)
    refused("take: 0 frames; expected 1 to 1,000,000", combinations, np.random.default_rng(0), 0)


@needs_openfacefx
def test_speech_closes_the_lips_at_every_bilabial():
    """Eight of b, m and p in "Pam, Bob; my map": the lips close at each that is apart from its neighbour."""
    take = speech("Pam, Bob; my map.", pace=8.0)
    closed = of(take.weights, "mouthPressLeft")
    assert len(find_peaks(closed, height=0.4)[0]) >= 6
    assert (of(take.weights, "jawOpen")[closed > 0.4] < 0.2).all()
    assert of(take.weights, "jawOpen").max() > 0.4
    assert take.rate == 60.0 and "openfacefx" in take.synthetic and take.head is None


@needs_openfacefx
def test_speech_is_the_same_twice_and_faster_where_asked():
    text = shipped_sentences()[0]
    first, second, fast = speech(text), speech(text), speech(text, pace=24.0)
    np.testing.assert_array_equal(first.weights, second.weights)
    assert 0.5 < fast.duration / first.duration < 0.7  # sounds take half as long, pauses as long


@needs_openfacefx
def test_the_sentences_are_varied_and_every_visem_occurs():
    weights = np.concatenate([speech(text).weights for text in shipped_sentences()])
    assert len(set(shipped_sentences())) == len(shipped_sentences()) == 40
    moved = weights.max(axis=0)
    for name in ("jawOpen", "mouthFunnel", "mouthPucker", "mouthStretchLeft", "mouthShrugLower", *CLOSED):
        assert moved[index(name)] > 0.15, name
    assert moved[index("tongueOut")] == 0.0
    assert of(speech(shipped_sentences()[0]).weights, "eyeBlinkLeft").max() > 0.9


def test_without_openfacefx_its_extra_is_named(monkeypatch):
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.startswith("openfacefx"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    refused(r"softdeca\[speech\]", speech, "hello", error=MissingDependencyError)


def test_hard_expressions_have_two_to_five_shapes_up_to_full_weight():
    weights = hard_expressions(np.random.default_rng(0), 400)
    counts, largest = np.count_nonzero(weights, axis=1), weights.max(axis=1)
    # mouthClose alone of an open jaw's shapes may be drawn and closed to nothing.
    assert counts.max() == 5 and counts.min() >= 1 and np.mean(counts >= 2) > 0.95
    assert weights.max() > 0.99 and weights.max() <= 1.0 and 0.35 < np.mean(largest > 0.5) < 0.55
    for row in weights:
        active = [ARKIT[k] for k in np.flatnonzero(row)]
        assert not any(contradict(a, b) for a in active for b in active)
        assert row[index("mouthClose")] <= row[index("jawOpen")]
    np.testing.assert_array_equal(weights, hard_expressions(np.random.default_rng(0), 400))
