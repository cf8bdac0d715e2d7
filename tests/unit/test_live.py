"""The live page's parts without a browser: changes in, frames out, answers better and better, newer changes first."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.animation.live.face import FirstAnswer
from softdeca.animation.live.messages import Change, DerivativesFound, Frame, Note
from softdeca.animation.live.refinement import Refinement, SupersededError
from softdeca.animation.live.worker import Newest, refine_newest
from softdeca.lhm import fit_head, identities, load_template
from softdeca.reference import Face, Parameters
from softdeca.surrogate import Surrogate
from softdeca.surrogate.corpus.spheres import Spheres
from softdeca.surrogate.methods import BLENDSHAPES, DERIVATIVES, PD
from softdeca.surrogate.runtime import SHIPPED

SPACE, CODE = Spheres(2), np.array([0.3, -0.5, 0.2, 0.8])


@pytest.fixture(scope="module")
def face():
    head = SPACE.fit(SPACE.skin(CODE))
    return Face(head, SPACE.expression_deltas(CODE))


def change(number=1, *, volume=1.2, weight=0.6):
    weights = np.zeros(52, dtype=np.float32)
    weights[[3, 20]] = weight
    return Change(number, weights, Parameters(soft_volume=volume, soft_stiffness=2.0, target_stiffness=1.0))


def never():
    return False


def test_answers_come_better_and_better(face):
    refinement, asked = Refinement(face), change()
    refinement.prepare(asked.parameters, never)
    frames = list(refinement.frames(asked, never))
    assert [frame.method for frame in frames] == [DERIVATIVES] + [PD] * (len(frames) - 1)
    assert [frame.is_last for frame in frames] == [False] * (len(frames) - 1) + [True]
    assert frames[-1].mean_error < 1e-4 and frames[-1].error.max() < 0.01
    last = frames[-1].skin
    true = np.array([np.linalg.norm(frame.skin - last, axis=1).mean() for frame in frames])
    told = np.array([frame.error.mean() for frame in frames])
    assert true[0] > 1e-4 and (told[:-1] > 0.3 * true[:-1]).all() and (told[:-1] < 3.0 * true[:-1] + 1e-5).all()


def test_the_first_answer_is_the_best_that_is_known_of_p(face):
    first, asked = FirstAnswer(face, Surrogate.load()), change()
    frame = first.frame(asked)
    assert frame.method == BLENDSHAPES and frame.error is None and not frame.is_last
    assert np.abs(frame.skin - face.blend(asked.weights)).max() < 1e-4
    refinement = Refinement(face)
    found = refinement.prepare(asked.parameters, never)
    first.learn(found)
    again = first.frame(asked)
    assert again.method == DERIVATIVES and not again.certain and again.error.mean() > 0.0
    assert np.abs(again.skin - next(refinement.frames(asked, never)).skin).max() < 1e-4
    assert first.frame(change(volume=1.1)).method == BLENDSHAPES


@pytest.mark.parametrize("name", SHIPPED)
def test_a_network_tells_more_error_on_a_head_that_is_none_of_its_people(name):
    space, template, asked = identities.Anny(), load_template(level=1), change()
    code, skin = space.sample(np.random.default_rng(4))
    wavy = skin.vertices + 4.0 * np.sin(skin.vertices[:, 1:2] / 20.0) * [1.0, 0.0, 0.0]
    told = []
    for each in (skin, skin.with_vertices(wavy)):
        face = Face(fit_head(template, each), space.expression_deltas(code))
        frame = FirstAnswer(face, Surrogate.load(name)).frame(asked)
        assert frame.method == name
        moved = np.linalg.norm(frame.skin - face.blend(asked.weights), axis=1)
        told.append(float((frame.error / np.maximum(moved, 1e-6)).max()))
    assert 0.0 < 1.5 * told[0] < told[1]


def test_a_newer_change_ends_the_work_on_one_before(face):
    refinement, asked = Refinement(face), change()
    with pytest.raises(SupersededError):
        refinement.prepare(asked.parameters, lambda: True)
    assert not refinement.is_prepared_for(asked.parameters)
    refinement.prepare(asked.parameters, never)
    with pytest.raises(SupersededError):
        list(refinement.frames(asked, lambda: True))
    assert refinement.is_prepared_for(asked.parameters)


def test_only_the_newest_change_is_refined_and_a_moving_slider_settles_nothing(face):
    newest, refinement, sent = Newest(), Refinement(face), []
    newest.put(change(1, volume=1.1))
    newest.put(change(2, volume=1.2))
    taken = newest.take()
    assert taken.number == 2 and not newest.comes_within(0.01)
    newest.put(taken)
    refine_newest(refinement, newest, sent.append)
    assert isinstance(sent[0], Note) and isinstance(sent[1], DerivativesFound)
    assert {message.change for message in sent if isinstance(message, Frame | Note)} == {2}

    def send_and_move(message):
        sent.append(message)
        if isinstance(message, DerivativesFound):
            newest.put(change(4, volume=1.3, weight=0.1))

    sent.clear()
    newest.put(change(3, volume=1.3))
    refine_newest(refinement, newest, send_and_move)
    assert not [message for message in sent if isinstance(message, Frame)]
    refine_newest(refinement, newest, sent.append)
    frames = [message for message in sent if isinstance(message, Frame)]
    assert {frame.change for frame in frames} == {4} and len([m for m in sent if isinstance(m, DerivativesFound)]) == 1


def test_a_face_that_does_not_settle_is_told(face):
    newest, sent = Newest(), []
    newest.put(change(5, volume=1.5))
    refine_newest(Refinement(replace(face, settling={"max_iterations": 1})), newest, sent.append)
    assert sent[-1].kind == "failed" and sent[-1].change == 5
    assert sent[-1].text.startswith("the face does not settle under these parameters (iteration limit")
