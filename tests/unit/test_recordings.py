"""Where expressions come from: speech, random combinations, and a pool of recordings known by name."""

import builtins

import numpy as np
import pytest
from scipy.signal import find_peaks

from softdeca.lhm import InputError
from softdeca.lhm.expressions import ARKIT, combinations, index, recordings, sample_weights, speech, starts
from softdeca.lhm.expressions.made_up import contradict, hard_expressions, shipped_sentences
from softdeca.lhm.expressions.takes import Take, resample

fx = pytest.importorskip("openfacefx")
CLOSED = ("mouthPressLeft", "mouthPressRight", "mouthRollUpper", "mouthRollLower")


def column(take, name):
    return take.weights[:, index(name)]


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
    with pytest.raises(InputError, match="take: 0 frames; expected 1 to 1,000,000"):
        combinations(np.random.default_rng(0), 0)


def test_speech_closes_the_lips_at_every_bilabial():
    """Eight of b, m and p in "Pam, Bob; my map": the lips close at each that is apart from its neighbour."""
    take = speech("Pam, Bob; my map.", pace=8.0)
    closed = column(take, "mouthPressLeft")
    assert len(find_peaks(closed, height=0.4)[0]) >= 6
    assert (column(take, "jawOpen")[closed > 0.4] < 0.2).all()
    assert column(take, "jawOpen").max() > 0.4
    assert take.rate == 60.0 and "openfacefx" in take.synthetic and take.head is None


def test_speech_is_the_same_twice_and_faster_where_asked():
    text = shipped_sentences()[0]
    first, second, fast = speech(text), speech(text), speech(text, pace=24.0)
    np.testing.assert_array_equal(first.weights, second.weights)
    assert 0.5 < fast.duration / first.duration < 0.7  # sounds take half as long, pauses as long


def test_the_sentences_are_varied_and_every_visem_occurs():
    weights = np.concatenate([speech(text).weights for text in shipped_sentences()])
    assert len(set(shipped_sentences())) == len(shipped_sentences()) == 40
    moved = weights.max(axis=0)
    for name in ("jawOpen", "mouthFunnel", "mouthPucker", "mouthStretchLeft", "mouthShrugLower", "tongueOut", *CLOSED):
        assert moved[index(name)] > 0.15, name
    assert column(speech(shipped_sentences()[0]), "eyeBlinkLeft").max() > 0.9


@pytest.mark.parametrize(
    ("text", "pace", "message"),
    [
        ("", 12.0, "no words in ''"),
        ("... !", 12.0, "no words"),
        ("I have 3 cats", 12.0, "'3' is no English word"),
        ("hello", 0.0, "pace: 0 sounds per second, expected 2 to 30"),
        ("hello", float("nan"), "pace: nan"),
    ],
)
def test_what_cannot_be_spoken_is_named(text, pace, message):
    with pytest.raises(InputError, match=message):
        speech(text, pace=pace)


def test_without_openfacefx_its_extra_is_named(monkeypatch):
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.startswith("openfacefx"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=r"softdeca\[speech\]"):
        speech("hello")


def test_the_pool_names_each_recording_and_gives_it_again(data, tmp_path):
    pool = recordings(data / "arkit_sequences", spoken=shipped_sentences()[:3], conversations=2, random=2, seconds=5.0)
    kinds = [recording.kind for recording in pool.values()]
    assert kinds == ["real"] * 2 + ["speech"] * 3 + ["conversation"] * 2 + ["random"] * 2
    for name, recording in pool.items():
        take = recording.take()
        assert name == recording.name and take.rate == recording.rate == 60.0
        assert len(take.times) == recording.frames
        np.testing.assert_allclose(np.diff(take.times)[:-1], 1 / 60, atol=1e-9)
        np.testing.assert_array_equal(take.weights, recording.take().weights)
        assert bool(take.synthetic) == (recording.kind != "real")
    assert np.abs(pool["conversation/0"].take().weights - pool["conversation/1"].take().weights).max() > 0.1


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
    pool = recordings(spoken=(), conversations=0, random=0, hard=2, seconds=1.0)
    assert list(pool) == ["hard/0", "hard/1"] and pool["hard/1"].take().weights.shape == (60, 52)


def test_files_that_are_no_takes_are_left_out_by_name(tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "geom.csv").write_text("1 2 3\n4 5 6\n")
    (tmp_path / "a.json").write_text('{"rate": 30, "frames": [{"jawOpen": 0.2}, {}]}')
    with pytest.warns(UserWarning, match=r"left out .*geom\.csv"):
        pool = recordings(tmp_path, spoken=(), conversations=0, random=0)
    assert list(pool) == ["real/a.json"] and pool["real/a.json"].frames == 3
    (tmp_path / "a.json").write_text('{"rate": 30, "frames": [{"jawOpen": 0.2}, {}, {}]}')
    with pytest.raises(InputError, match="'real/a.json': 5 frames at 60 Hz, not 3"):
        pool["real/a.json"].take()
    with pytest.raises(InputError, match="none: no such folder"):
        recordings(tmp_path / "none")
    with pytest.raises(InputError, match="conversations: -1 recordings; expected at most 10,000"):
        recordings(conversations=-1)


def test_sequences_are_not_drawn_across_a_gap():
    """Frames 0 to 9 and 40 to 49 at 30 Hz: of 99 at 60 Hz those between 0.3 and 1.333 s are made up."""
    times = np.r_[0:10, 40:50] / 30
    take = resample(Take(np.zeros((20, 52)), 30.0, times), 60.0)
    assert len(take.times) == 99 and take.gaps.shape == (1, 2)
    np.testing.assert_array_equal(starts(take, 16), [*range(0, 4), *range(80, 84)])
    assert len(starts(take, 100)) == 0
    assert len(starts(take.part(slice(0, 18)), 16)) == 3


def test_the_pool_of_the_sentences_can_be_split_by_text():
    pool = recordings(conversations=0, random=0)
    assert len(pool) == 40 and all(r.kind == "speech" and r.frames > 120 for r in pool.values())
