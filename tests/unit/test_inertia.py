"""Where a face is loose: not at lips, lids, or close to bone; closed lips of fast speech stay closed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from softdeca.lhm import expressions, fit_head, identities, load_template
from softdeca.lhm.flesh import flesh_share
from softdeca.reference import Parameters, SceneError, Sequence
from softdeca.reference.face.dynamics import CLOSE, DEEP, RING, Recurrence, measure_looseness

STEP = 1 / 60


@pytest.fixture(scope="module")
def default():
    """The default head of 1,212 vertices a wrap, and its expressions."""
    space = identities.from_text("anny")
    code = np.zeros(space.code_size)
    return fit_head(load_template(space, level=1), space.skin(code)), space.expression_deltas(code)


def test_lips_lids_and_skin_close_to_bone_follow_and_cheeks_are_loose(default):
    head, _ = default
    x, share = head.skin_wrap.vertices, measure_looseness(head)
    bone = cdist(x, head.skull_wrap.vertices[head.bone != 0]).min(axis=1)
    assert np.all(share[head.regions["lips"] | head.regions["lids"] | (bone <= CLOSE)] == 0.0)
    assert share.min() >= 0.0 and share.max() == 1.0
    assert np.all(bone[share > 0.99] > 0.9 * DEEP)
    middle = x[head.regions["lips"]].mean(axis=0)
    beside = head.regions["face"] & (np.abs(np.abs(x[:, 0] - middle[0]) - 45) < 8) & (np.abs(x[:, 1] - middle[1]) < 12)
    assert beside.any() and np.median(share[beside]) > 0.7


def test_the_recurrence_of_a_head_is_one_call(default, sphere_head):
    head, _ = default
    p = Parameters(frequency=3.0, damping=0.2)
    found, share = Recurrence.from_head(head, p, STEP), measure_looseness(head)
    uniform = Recurrence.from_oscillator(3.0, 0.2, STEP)
    flesh, follows = share == 1.0, share == 0.0
    assert flesh.any() and np.all(found.alpha[flesh] == uniform.alpha) and np.all(found.beta[flesh] == uniform.beta)
    assert np.all(found.gamma[follows] == 1.0) and np.all(found.alpha[follows] == 0.0)
    skin = found.at(head.skin_from_wrap)
    assert skin.gamma.shape == (len(head.skin.vertices),)
    everywhere = Recurrence.from_head(sphere_head, p, STEP)  # without regions
    assert np.ptp(everywhere.gamma) == 0.0 and everywhere.gamma[0] == uniform.gamma
    with pytest.raises(SceneError, match="parameter damping: 7 values for"):
        Recurrence.from_head(head, Parameters(damping=np.full(7, 0.3)), STEP)


def test_without_bone_all_flesh_is_loose(default):
    head, _ = default
    boneless = replace(head, bone=np.zeros_like(head.bone))
    loose, whole = measure_looseness(boneless), measure_looseness(head)
    assert np.array_equal(loose, flesh_share(head, fade=RING))
    assert np.all(loose >= whole) and loose.sum() > 1.2 * whole.sum()


def test_closed_lips_of_fast_speech_stay_closed(default):
    """Within 1 mm of statics wherever those have them closed; with one frequency everywhere they miss it by far."""
    head, deltas = default
    take = expressions.speech("Bob, pop my puppy.", pace=18.0)
    frames = [head.skin.vertices + np.tensordot(w, deltas, axes=1) for w in take.weights[10:28]]
    still, lagging, uniform = (Sequence(head, Parameters(), dynamic=d, tolerance=1e-4) for d in (False, True, True))
    uniform.recurrence = Recurrence.from_oscillator(4.0, 0.3, STEP)
    n = len(head.bone)
    lips = np.flatnonzero(head.regions["lips"])
    below = (head.wrap_from_skin @ deltas[expressions.index("jawOpen")])[lips, 1]
    upper, lower = lips[below > 0.5 * below.min()], lips[below <= 0.5 * below.min()]

    def moved(sequence):
        return np.array([sequence.frame(s).positions[:n] for s in frames])

    def apart(skins):
        return np.array([cdist(x[upper], x[lower]).min(axis=1).mean() for x in skins])

    skins, now, before = moved(still), moved(lagging), moved(uniform)
    closed = apart(skins) < apart(skins).min() + 1.0
    assert 3 < closed.sum() < len(frames)
    off = [np.linalg.norm(x[closed][:, lips] - skins[closed][:, lips], axis=2).max() for x in (now, before)]
    assert off[0] < 1.0 and off[1] > 4.0
    cheeks = measure_looseness(head) > 0.9
    assert np.linalg.norm(now[:, cheeks] - skins[:, cheeks], axis=2).max() > 1.0
