"""Made-up conversations: in range, not contradictory, with the rhythm and speeds that they claim."""

import numpy as np
import pytest
from scipy.signal import find_peaks

from softdeca.lhm import InputError
from softdeca.lhm.expressions import ARKIT, conversation, index, read_take, resample

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
PAIRS = [
    (name, name.removesuffix("Left") + "Right")
    for name in ARKIT
    if name.endswith("Left") and name not in ("jawLeft", "mouthLeft", "eyeLookInLeft", "eyeLookOutLeft")
]


@pytest.fixture(scope="module", params=[0, 1, 2])
def talk(request):
    return conversation(np.random.default_rng(request.param), round(MINUTES * 3600))


def column(weights, name):
    return weights[:, index(name)]


def test_weights_are_in_range_and_all_expressions_occur(talk):
    assert talk.shape == (7200, 52) and talk.min() >= 0.0 and talk.max() <= 1.0
    assert talk.max(axis=0).min() > 0.05


def test_the_same_seed_gives_the_same_talk(talk):
    again = [conversation(np.random.default_rng(seed), 500) for seed in (7, 7, 8)]
    np.testing.assert_array_equal(again[0], again[1])
    assert np.abs(again[0] - again[2]).max() > 0.1


def test_contradictory_expressions_are_not_made(talk):
    for first, second in EXCLUSIVE:
        assert np.minimum(column(talk, first), column(talk, second)).max() == 0.0, (first, second)
    for first, second in NEVER_BOTH_LARGE:
        assert np.minimum(column(talk, first), column(talk, second)).max() < 0.45, (first, second)
    assert (column(talk, "mouthClose") <= column(talk, "jawOpen")).all()


def test_both_sides_move_alike_but_not_the_same(talk):
    for left, right in PAIRS:
        assert 0.9 < np.corrcoef(column(talk, left), column(talk, right))[0, 1], left
    assert np.abs(column(talk, "mouthSmileLeft") - column(talk, "mouthSmileRight")).max() > 0.02
    gaze = [column(talk, name) for name in ("eyeLookOutLeft", "eyeLookInRight")]
    assert np.corrcoef(*gaze)[0, 1] > 0.9  # both eyes look the same way


def test_blinks_come_every_few_seconds_and_are_short(talk):
    """A blink and the pause after it last between 2.1 and 6.4 s: 9.4 to 28.6 per minute."""
    lids = column(talk, "eyeBlinkLeft")
    peaks = find_peaks(lids, height=0.7, distance=60)[0]
    assert 9 * MINUTES <= len(peaks) <= 29 * MINUTES
    closed = np.diff(np.flatnonzero(np.diff(np.r_[0, lids > 0.5, 0]))[: 2 * len(peaks)])[::2] / 60.0
    assert closed.max() < 0.4


@pytest.mark.parametrize(("seconds", "rate"), [(2.0, 60.0), (2.0, 30.0), (10.0, 60.0)])
def test_every_conversation_closes_its_lids_and_smiles_broadly(seconds, rate):
    for seed in range(200):
        talk = conversation(np.random.default_rng(seed), round(seconds * rate), rate=rate)
        lids = np.minimum(column(talk, "eyeBlinkLeft"), column(talk, "eyeBlinkRight"))
        smile = np.minimum(column(talk, "mouthSmileLeft"), column(talk, "mouthSmileRight"))
        assert lids.max() > 0.999 and smile.max() > 0.6, seed


def test_lids_follow_the_gaze_and_gazes_reach_far(talk):
    """Between blinks, which are a tenth of the time, eyeBlink is 0.4 of eyeLookDown: so its median at any gaze is."""
    down, lids = column(talk, "eyeLookDownLeft"), column(talk, "eyeBlinkLeft")
    far = down > 0.2
    assert np.median(lids[far] / down[far]) == pytest.approx(0.4, abs=0.05)
    for name in ("eyeLookDownLeft", "eyeLookUpLeft", "eyeLookOutLeft", "eyeLookInLeft"):
        assert column(talk, name).max() > 0.3, name


def test_the_jaw_opens_a_few_times_per_second_of_talk(talk):
    """At most one visible opening per syllable, of which there are 3 to 6 per second."""
    jaw = column(talk, "jawOpen")
    speaking = np.convolve(jaw > 0.12, np.ones(60), "same") > 8
    openings = find_peaks(jaw, prominence=0.04)[0]
    assert 1.5 < speaking[openings].sum() / (speaking.sum() / 60.0) < 6.0
    assert 0.4 < speaking.mean() < 0.95  # the rest is listening


def test_range_and_speed_are_those_of_a_real_take(talk, data):
    """Against a recorded range of motion, which goes farther than talk: half to one time its spread, its speeds."""
    real = resample(read_take(data / "arkit_sequences" / "alex_rom_3.csv"), 60.0).weights
    face = [k for k, name in enumerate(ARKIT) if name.startswith(("mouth", "jaw", "brow"))]
    spread = talk.std(axis=0) / real.std(axis=0)
    fast_talk, fast_real = (np.percentile(60 * np.abs(np.diff(w, axis=0)), 99, axis=0) for w in (talk, real))
    assert 0.4 < np.median(spread) < 1.0  # measured .64 to .70
    assert 0.67 < np.median((fast_talk / fast_real)[face]) < 1.5  # measured 1.00 to 1.05


def test_statistics_do_not_depend_on_the_rate():
    slow, fast = (
        np.concatenate([conversation(np.random.default_rng(s), round(300 * rate), rate=rate) for s in range(2)])
        for rate in (30.0, 120.0)
    )
    ratio = slow.std(axis=0) / fast.std(axis=0)
    assert abs(np.median(ratio) - 1) < 0.08 and ratio.min() > 0.6 and ratio.max() < 1.6


def test_edges():
    assert conversation(np.random.default_rng(0), 1).shape == (1, 52)
    assert conversation(np.random.default_rng(0), 3, rate=0.5).shape == (3, 52)
    with pytest.raises(InputError, match="take: 0 frames; expected 1 to 1,000,000"):
        conversation(np.random.default_rng(0), 0)
    with pytest.raises(InputError, match="rate: 0 Hz"):
        conversation(np.random.default_rng(0), 10, rate=0.0)
    with pytest.raises(InputError, match="rate: nan"):
        conversation(np.random.default_rng(0), 10, rate=np.nan)
