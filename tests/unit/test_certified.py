"""A face that knows its error: told against true, by the accuracy that is asked for."""

import numpy as np
import pytest

from softdeca.reference import Parameters
from softdeca.surrogate.certified import CertifiedFace
from softdeca.surrogate.sphere import Spheres

SPACE, CODE = Spheres(2), np.array([0.3, -0.5, 0.2, 0.8])
HEAD = SPACE.fit(SPACE.skin(CODE))
P = Parameters(soft_volume=1.2, gravity=2.0, soft_stiffness=2.0, target_stiffness=1.0)


@pytest.fixture(scope="module")
def face():
    return CertifiedFace.from_head(HEAD, SPACE.expression_deltas(CODE), P)


def expression(seed, largest=1.0):
    rng = np.random.default_rng(seed)
    weights = np.zeros(52)
    weights[rng.choice(52, 4, replace=False)] = rng.uniform(0.2, largest, 4)
    return weights


def mean_distance(frame, truth):
    return np.linalg.norm(frame.skin - truth.skin, axis=1).mean()


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
