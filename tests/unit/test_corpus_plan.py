"""Plans: splits that share nothing, parameter sets as the mixture says, and files that are checked."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm import InputError, identities
from softdeca.reference import Parameters
from softdeca.reference.face.settle import changes_neutral
from softdeca.surrogate import Surrogate
from softdeca.surrogate.corpus.mixture import INFOS, KINDS, MATERIALS, NAMES, select_static
from softdeca.surrogate.corpus.plan import IDENTITY, PRESETS, CorpusPlan, read_plan
from softdeca.surrogate.corpus.spheres import Spheres
from softdeca.surrogate.ruler import EFFECTS, kind_of_coefficients

PLAN = CorpusPlan(identities=30, groups=3, frames=4, conversations=10, random=10, seconds=10.0)
MADE_UP = replace(PLAN, sources={"conversation": 0.4, "random": 0.3, "hard": 0.3})
"""Without speech, which takes seconds to make."""


@pytest.mark.parametrize("plan", [PLAN, replace(MADE_UP, seed=7, groups=1)])
def test_splits_share_no_person_parameter_set_or_recording(plan):
    drawn = {"train": set(), "test": set()}
    people, sets = [], []
    for identity in range(plan.identities):
        split = drawn[plan.split(identity)]
        people.append(Spheres(1).sample(plan.rng(0, identity))[0].tobytes())
        split.add(("person", people[-1]))
        for number in plan.parameter_numbers(identity):
            sets.append(number)
            split.add(("parameters", plan.parameter_set(number).coefficients.tobytes()))
        for index in range(plan.groups * plan.frames):
            split.add(("recording", plan.static(identity, index).recording))
        for index in range(plan.sequences):
            split.add(("recording", plan.sequence(identity, index)[0]))
    assert drawn["train"] and drawn["test"] and not drawn["train"] & drawn["test"]
    assert len(set(people)) == plan.identities and sorted(sets) == list(range(plan.identities * plan.groups))
    assert sum(plan.split(k) == "test" for k in range(plan.identities)) == max(1, round(0.1 * plan.identities))


def test_a_plan_is_the_same_each_time_and_another_seed_makes_another():
    again = replace(MADE_UP)
    assert again.digest == MADE_UP.digest != replace(MADE_UP, seed=1).digest
    assert again.static(3, 2) == MADE_UP.static(3, 2) and again.sequence(3, 0) == MADE_UP.sequence(3, 0)


def test_the_shipped_network_knows_whom_it_learned_from():
    network, space = Surrogate.load(), identities.Anny()

    def draw_codes(plan, count):
        return np.array([space.sample(plan.rng(IDENTITY, k))[0] for k in range(count)])

    # Of the preset `contact` those for training who had a head, but for those held out.
    contact, held = PRESETS["contact"], network.weights.note.trainings[-1].held
    codes = draw_codes(contact, contact.trained)
    learned = np.array([network.has_learned_from(code) for code in codes])
    assert not learned[list(held)].any()
    learned[list(held)] = True
    assert contact.trained - 2 < learned.sum() and np.array_equal(
        codes[learned].mean(axis=0), network.weights.code_mean
    )
    # Of the preset `faces` some of those for training, and nobody else.
    plan = PRESETS["faces"]
    known = [network.has_learned_from(code) for code in draw_codes(plan, plan.identities)]
    assert sum(known) == network.weights.note.people and not any(known[plan.trained :])
    # No two presets share a seed, by which alone people differ; nor is anybody of a small seed in one but the trial's.
    assert len({plan.seed for plan in PRESETS.values()}) == len(PRESETS)
    small = {space.sample(np.random.default_rng(seed))[0].tobytes() for seed in range(20)}
    for name, plan in PRESETS.items():
        codes = draw_codes(plan, 30)
        assert name in ("faces", "contact") or not any(map(network.has_learned_from, codes))
        assert name == "tiny" or small.isdisjoint(code.tobytes() for code in codes)


@pytest.mark.parametrize(
    "kinds", [{"materials": 0.3, "single": 0.35, "effects": 0.15, "both": 0.2}, {"materials": 0.3, "both": 0.4}]
)
def test_a_plan_read_from_its_own_text_is_the_same(kinds):
    plan = CorpusPlan(kinds=kinds, sources=MADE_UP.sources)
    content = {key: value for key, value in json.loads(plan.to_json()).items() if key != "recordings"}
    assert CorpusPlan(**content).digest == plan.digest


def test_parameter_sets_are_of_their_kind_and_within_their_ranges():
    head = Spheres(1).fit(Spheres(1).mean)
    kinds, varying, moving = [], [], []
    for number in range(200):
        drawn = PLAN.parameter_set(number)
        p = drawn.parameters(head, Spheres(1).mean)  # Parameters checks the ranges
        kinds.append(drawn.kind)
        varying.append(not drawn.uniform)
        moving.append(changes_neutral(p) or p.paralysis_left > 0 or p.paralysis_right > 0)
        if drawn.kind in ("materials", "both"):
            assert set(MATERIALS) <= set(drawn.names)
        if drawn.kind == "materials":
            assert not changes_neutral(p)
        if np.max(p.skin_growth) > 1.0 or np.max(p.skin_stiffness) > 40.0:
            assert p.skin_bending > 0.0
        for name in drawn.names:
            row = drawn.coefficients[NAMES.index(name)]
            assert INFOS[name].local or not row[1:].any()
    shares = [kinds.count(kind) / 200 for kind in KINDS]
    assert np.abs(np.array(shares) - [PLAN.kinds[kind] for kind in KINDS]).max() < 0.12
    assert 0.4 < np.mean(varying) < 0.6 and np.mean(moving) > 0.6
    seen = {name for number in range(200) for name in PLAN.parameter_set(number).names}
    assert seen == {info.name for info in Parameters.infos()} - {"connector_ratio"}


def test_expressions_come_from_every_source():
    names = [PLAN.static(identity, k).recording for identity in range(27) for k in range(12)]
    shares = {source: np.mean([name.startswith(source) for name in names]) for source in PLAN.sources}
    assert shares["real"] == 0.0 and min(shares["speech"], shares["conversation"], shares["random"]) > 0.2


def test_a_plan_without_speech_says_no_sentence(monkeypatch):
    """It needs no openfacefx then."""
    monkeypatch.setattr(sys.modules["softdeca.lhm.expressions.recordings"], "speech", None)
    assert {recording.kind for recording in replace(MADE_UP).recordings.values()} == {"conversation", "random", "hard"}


def test_plans_from_files(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text('preset = "tiny"\nidentities = 5\nseed = 3\n[kinds]\neffects = 1.0\n')
    plan = read_plan(path)
    assert (plan.identities, plan.seed, plan.groups) == (5, 3, 1) and plan.kinds["effects"] == 1.0
    path.write_text('preset = "huge"')
    with pytest.raises(InputError, match=f"there are {', '.join(PRESETS)}"):
        read_plan(path)


def test_a_single_effect_is_alone_and_hard_expressions_are_in_no_sequence():
    plan = CorpusPlan(
        identities=30, groups=3, sequences=2, kinds={"single": 1.0}, sources={"conversation": 0.2, "hard": 0.8},
        conversations=4, random=0, hard=4, seconds=5.0,
    )  # fmt: skip
    assert {kind_of_coefficients(select_static(plan.parameter_set(k).coefficients)) for k in range(90)} == set(EFFECTS)
    drawn = [plan.static(identity, k).recording for identity in range(20) for k in range(6)]
    assert 0.6 < np.mean([name.startswith("hard") for name in drawn]) < 0.95
    assert all(plan.sequence(identity, k)[0].startswith("conversation") for identity in range(20) for k in range(2))
