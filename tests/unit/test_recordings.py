"""A pool of recordings known by name."""

import json

import numpy as np
import pytest

from softdeca.lhm.expressions import recordings, starts
from softdeca.lhm.expressions.made_up import shipped_sentences
from softdeca.lhm.expressions.takes import Take, resample

pytest.importorskip("openfacefx")


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


def test_hard_expressions_are_recordings_too():
    pool = recordings(spoken=(), conversations=0, random=0, hard=2, seconds=1.0)
    assert list(pool) == ["hard/0", "hard/1"] and pool["hard/1"].take().weights.shape == (60, 52)


def write_json_take(path, weights):
    """A take of jawOpen alone at 30 Hz."""
    frames = [{"weights": [weight], "time": number / 30} for number, weight in enumerate(weights)]
    path.write_text(json.dumps({"names": ["jawOpen"], "frames": frames}))


def test_files_that_are_no_takes_are_left_out_by_name(tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "geom.csv").write_text("1 2 3\n4 5 6\n")
    weights = [0.2, 0.0, 0.0]
    write_json_take(tmp_path / "a.json", weights[:2])
    with pytest.warns(UserWarning, match=r"left out .*geom\.csv"):
        pool = recordings(tmp_path, spoken=(), conversations=0, random=0)
    assert list(pool) == ["real/a.json"] and pool["real/a.json"].frames == 3


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
