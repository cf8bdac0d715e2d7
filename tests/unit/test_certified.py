"""A face that knows its error: told against true, by the accuracy that is asked for."""

import pickle
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from softdeca.animation.frames import foresee
from softdeca.lhm import InputError
from softdeca.lhm.expressions import Take
from softdeca.reference import Face, Parameters, solve
from softdeca.surrogate import METHODS, Surrogate, certify
from softdeca.surrogate.corpus.spheres import Spheres

from ..refusals import refused

SPACE, CODE = Spheres(2), np.array([0.3, -0.5, 0.2, 0.8])
HEAD = SPACE.fit(SPACE.skin(CODE))
P = Parameters(soft_volume=1.2, gravity=2.0, soft_stiffness=2.0, target_stiffness=1.0)


@pytest.fixture(scope="module")
def face():
    return certify(Face(HEAD, SPACE.expression_deltas(CODE), P))


def expression(seed, largest=1.0):
    rng = np.random.default_rng(seed)
    weights = np.zeros(52)
    weights[rng.choice(52, 4, replace=False)] = rng.uniform(0.2, largest, 4)
    return weights


def mean_distance(frame, truth):
    return np.linalg.norm(frame.skin - truth.skin, axis=1).mean()


def test_a_take_of_one_frame_is_foreseen(face):
    assert foresee(face, Take(expression(0)[None], 30.0, np.zeros(1)), 0.05).startswith("frames: 1")


@pytest.mark.parametrize("seed", range(3))
def test_the_error_that_is_told_is_the_true_one(face, seed):
    weights = expression(seed)
    truth = face.frame(weights, 1e-6)
    assert truth.certain and truth.error <= 1e-6
    seen = []
    for accuracy in (0.1, 1e-3, 5e-5):
        frame = face.frame(weights, accuracy)
        assert frame.certain and frame.error <= accuracy
        seen.append((frame.error, mean_distance(frame, truth)))
    told, true = np.array(seen).T
    assert (told + 1e-5 > 0.8 * true).all() and (told < 1.25 * true + 1e-5).all(), (told, true)
    assert true[-1] < 0.3 * true[0], "what is asked for makes a difference"


@pytest.mark.parametrize("choices", [{"region": HEAD.skin_wrap.vertices[:, 2] > 20.0}, {"bones": "prescribed"}])
def test_a_frame_with_what_an_expression_holds_is_the_simulators(choices):
    face, weights = Face(HEAD, SPACE.expression_deltas(CODE), P, choices=choices), expression(0)
    frame = certify(face).frame(weights, 1e-5)
    truth = face.skin_after(weights, solve(face.scene(weights), tolerance=1e-9).positions)
    assert frame.certain and np.linalg.norm(frame.skin - truth, axis=1).mean() < 2e-5


def test_threads_share_a_rig(face):
    weights = [expression(seed).astype(np.float32) for seed in range(200)]
    alone, before = [face.rig.frame(each) for each in weights], sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(4) as pool:
            together = list(pool.map(face.rig.frame, weights))
    finally:
        sys.setswitchinterval(before)
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize("name", ["PD", "dial", "derivatives", "bones carried", "blendshapes"])
def test_a_rig_can_be_pickled_or_says_that_it_cannot(face, name):
    rig, weights = METHODS[name].bind(face.face), expression(0)
    if name in ("PD", "dial"):
        refused("cannot be copied or pickled", pickle.dumps, rig)
        return
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(rig)).frame(weights), rig.frame(weights))


def test_a_frame_is_never_told_worse_than_before(face):
    for seed in range(3):
        frames = list(face.improve(expression(seed)))
        bounds, true = [frame.bound for frame in frames], [mean_distance(frame, frames[-1]) for frame in frames]
        assert all(after <= before for before, after in zip(bounds[:-1], bounds[1:-1], strict=False)), bounds
        assert all(after <= 1.1 * before + 1e-6 for before, after in zip(true, true[1:], strict=False)), true
        assert frames[-1].method == "converged"


@pytest.mark.parametrize("why", ["skin: its edges", "parameter connector_ratio"])
def test_a_network_that_refuses_a_face_is_left_out(monkeypatch, why):
    """A scan in the default's triangles may be unlike all of the network's people."""

    def refuse(*given, **options):
        raise InputError(why)

    monkeypatch.setattr(Surrogate, "knows", lambda self, skin: True)
    monkeypatch.setattr(Surrogate, "bind_face", refuse)
    assert certify(Face(HEAD, SPACE.expression_deltas(CODE), P)).method == "derivatives"
