"""Known and unseen people, parameters and recordings in every combination, on layered spheres."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from softdeca.lhm.base.errors import InputError, SoftdecaError
from softdeca.surrogate.corpus.mixture import NAMES, STATIC
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.plan import IDENTITY, CorpusPlan
from softdeca.surrogate.generalisation import (
    KINDS,
    check_learned,
    choose_pairs,
    evaluate_generalisation,
    simulate_pairs,
)
from softdeca.surrogate.methods import Blendshapes, Derivatives
from softdeca.surrogate.rig import CorrectedRig
from softdeca.surrogate.schedule import Schedule
from softdeca.surrogate.sphere import Spheres

SPACE = Spheres(1)
PEOPLE = OfSpace(SPACE, SPACE.mean, SPACE.fit)
PLAN = CorpusPlan(
    identities=24, groups=2, frames=2, sequences=0, references=0, parameter_responses=0.0, varying=0.0,
    kinds={"materials": 0.5, "both": 0.5}, sources={"conversation": 1.0}, conversations=4, random=0, seconds=4.0,
)  # fmt: skip
HELD = (0, 3)
COLUMNS = [NAMES.index(name) for name in STATIC]


def codes(numbers):
    return np.stack([PEOPLE.person(PLAN.rng(IDENTITY, k)).code for k in numbers])


def learned(first=12, held=HELD):
    known = codes(range(first))
    note = SimpleNamespace(people=first - len(held), held=held)
    return SimpleNamespace(note=note, code_mean=known.mean(axis=0), code_scale=known.std(axis=0))


class Watching:
    """Moves nothing, and notes what it was asked."""

    name, simulates, takes = "watching", False, "nothing"

    def __init__(self):
        self.faces, self.weights = [], []

    def fit(self, faces):
        raise AssertionError("it is fitted")

    def bind(self, face):
        self.faces.append((face.code, face.coefficients))

        def correct(weights):
            self.weights.append(weights)
            return np.zeros(face.skin.shape, dtype=np.float32)

        return CorrectedRig(face.person.skin, face.shapes, correct)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("generalisation")


def scored(methods, folder, **changed):
    given = {"weights": learned(), "plan": PLAN, "people": PEOPLE, "count": 2} | changed
    made = simulate_pairs(given.pop("weights"), given.pop("plan"), given.pop("people"), folder, on=Schedule(), **given)
    return evaluate_generalisation(methods, made)


def test_each_combination_has_its_people_parameters_and_recordings(folder):
    watching = Watching()
    scores = scored([watching, Derivatives(), Blendshapes()], folder)
    assert KINDS[0] == "unseen: nothing" and KINDS[1] == "unseen: recordings" and len(set(KINDS)) == 8
    assert KINDS[-1] == "unseen: people, parameters, recordings"
    assert [score.kind for score in scores] == [kind for kind in KINDS for _ in range(3)]
    known, test = (1, 2), (22, 23)
    asked, expressed = (
        np.array(watching.faces, dtype=object).reshape(8, 2, 2),
        np.reshape(watching.weights, (8, 2, 2, 52)),
    )
    for kind, faces, weights in zip(KINDS, asked, expressed, strict=True):
        of = {name: test if name in kind else known for name in ("people", "parameters", "recordings")}
        for k in range(2):
            np.testing.assert_array_equal(faces[k][0], codes(of["people"])[k])
            drawn = PLAN.parameter_set(PLAN.parameter_numbers(of["parameters"][k])[k])
            np.testing.assert_array_equal(faces[k][1], drawn.coefficients[COLUMNS])
            said = PLAN.static(of["recordings"][k], 2 * k)
            assert said.recording in PLAN.pools["test" if "recordings" in kind else "train"]["conversation"]
            np.testing.assert_array_equal(weights[k][0], PLAN.weights(said))
    found = {(score.method, score.kind): score for score in scores}
    for kind in KINDS:
        assert (
            found["watching", kind].share == pytest.approx(found["blendshapes", kind].share, rel=1e-5)
            and found["watching", kind].frames == 4
        )
        assert found["derivatives", kind].share < 0.5


def test_what_is_there_is_not_simulated_again_and_what_is_damaged_is(folder):
    before = [score.mean for score in scored([Blendshapes()], folder)]
    kept, damaged = folder / "pair-00001-00022.npz", folder / "pair-00002-00023.npz"
    when = kept.stat().st_mtime_ns
    damaged.write_bytes(damaged.read_bytes()[:1000])
    told = []
    again = scored([Blendshapes()], folder, on_progress=lambda words, share: told.append(words))
    assert [score.mean for score in again] == before and kept.stat().st_mtime_ns == when
    assert sum("simulated" in words for words in told) == 1
    with pytest.raises(InputError, match="of another plan"):
        scored([Blendshapes()], folder, plan=replace(PLAN, tolerance=1e-3))


def test_faces_that_do_not_settle_are_left_out(tmp_path):
    def refused(skin):
        raise SoftdecaError("no head")

    with pytest.raises(SoftdecaError, match="of unseen: nothing no frame was accepted"):
        scored([Blendshapes()], tmp_path, people=OfSpace(SPACE, SPACE.mean, refused), count=1)


def test_who_is_known_has_to_be_told():
    assert [pair.people["train"] for pair in choose_pairs(PLAN, learned(), 2)] == [1, 2]
    for count in (0, 3):  # of test there are two
        with pytest.raises(InputError, match="expected 1 to 2 pairs"):
            choose_pairs(PLAN, learned(), count)
    check_learned(PLAN, PEOPLE, learned())
    for other in (learned(first=23), SimpleNamespace(**vars(learned()) | {"code_mean": learned().code_mean + 1.0}),
                  SimpleNamespace(**vars(learned()) | {"code_mean": np.zeros(99)})):  # fmt: skip
        with pytest.raises(InputError, match="did not learn from this corpus' people"):
            check_learned(PLAN, PEOPLE, other)
