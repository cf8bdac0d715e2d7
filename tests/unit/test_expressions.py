"""ARKit's names, weights and blending on a made-up space of four vertices."""

import numpy as np
import pytest

from softdeca.lhm import Surface, expressions
from softdeca.lhm.identities import LinearSpace
from softdeca.lhm.identities.arkit import ARKIT, arkit_name, find_arkit_morphs

from ..refusals import refused

CORNERS = 2.0 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


@pytest.fixture
def space():
    deltas = np.zeros((52, 4, 3))
    deltas[expressions.index("jawOpen"), 0] = [0, -2, 0]
    deltas[expressions.index("browInnerUp"), 1] = [0, 1, 0]
    mean = Surface(CORNERS, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    return LinearSpace("corner", mean, np.ones((2, 4, 3)), deltas, np.zeros(4, int))


def test_names_are_apples_52_in_alphabetical_order():
    assert len(set(expressions.ARKIT)) == 52
    assert list(expressions.ARKIT) == sorted(expressions.ARKIT)
    assert expressions.ARKIT[0] == "browDownLeft" and expressions.ARKIT[-1] == "tongueOut"


def test_unknown_names_are_refused_with_near_misses():
    assert expressions.ARKIT[expressions.index("jawOpen")] == "jawOpen"
    refused("'JawOpen'.*jawOpen", expressions.index, "JawOpen")
    refused("'smile'", expressions.weights_of, {"smile": 1.0})


def test_blend_is_linear_in_the_weights(space):
    weights = expressions.weights_of({"jawOpen": 0.5, "browInnerUp": 1.0})
    expected = CORNERS + 1.0 + [[0, -1, 0], [0, 1, 0], [0, 0, 0], [0, 0, 0]]
    np.testing.assert_allclose(expressions.blend(space, [0.25, 0.75], weights), expected[None])
    assert expressions.blend(space, [0, 0], np.zeros((3, 52))).shape == (3, 4, 3)


def test_weights_are_clipped_with_a_count_and_checked(space):
    weights = np.zeros((2, 52))
    weights[0, 3], weights[1, 4] = 1.05, -0.2
    with pytest.warns(UserWarning, match="2 of 104"):
        skins = expressions.blend(space, [0, 0], weights)
    assert np.isfinite(skins).all()


def test_codes_are_checked_and_samples_clipped(space):
    codes = np.array([space.sample(np.random.default_rng(seed))[0] for seed in range(300)])
    assert np.abs(codes).max() == 2.5 and 0.8 < codes.std() < 1.1


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("jawOpen", "jawOpen"),
        ("eyeBlink_L", "eyeBlinkLeft"),
        ("blendShape1.mouthSmile_R", "mouthSmileRight"),
        ("EyeBlinkLeft", "eyeBlinkLeft"),
        ("Face:mouth_smile_left", "mouthSmileLeft"),
        ("browInnerUp_L", "browInnerUp"),
        ("cheekPuff_R", "cheekPuff"),
        ("mouthLeft", "mouthLeft"),
        ("eyeBlink.R", "eyeBlinkRight"),
        ("Head.eyeBlink.R", "eyeBlinkRight"),
        ("eyeBlinkL", "eyeBlinkLeft"),
        ("A25_Jaw_Open", "jawOpen"),
        ("correct_jawOpen", None),
        ("viseme_aa", None),
        ("target 3", None),
    ],
)
def test_names_are_known_however_they_are_written(name, meant):
    assert arkit_name(name) == meant
    assert all(arkit_name(known) == known for known in ARKIT)


def test_halves_are_added():
    found = find_arkit_morphs(
        {"browInnerUp_L": np.ones((2, 3)), "browInnerUp_R": 2 * np.ones((2, 3)), "x": np.ones((2, 3))}
    )
    assert list(found) == ["browInnerUp"] and (found["browInnerUp"] == 3).all()


def test_morph_targets_of_one_expression_are_told():
    face, teeth = np.eye(3)[:1], np.eye(3)[1:2]
    assert (find_arkit_morphs({"a.jawOpen": face, "b.jawOpen": teeth})["jawOpen"] == face + teeth).all()
    for one, other in (("jawOpen", "JawOpen"), ("browInnerUp", "browInnerUp_L"), ("cheekPuff_L", "cheekPuffLeft")):
        words = f"morph targets '{one}' and '{other}' are both {arkit_name(one)}"
        refused(words, find_arkit_morphs, {one: face, other: 2 * face})
