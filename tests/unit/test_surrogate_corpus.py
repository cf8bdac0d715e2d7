"""The corpus: splits that share nothing, content that follows from the plan alone, damage that is named and mended."""

import json

import h5py
import numpy as np
import pytest

from softdeca.lhm import FitError, InputError
from softdeca.reference import Parameters
from softdeca.surrogate.corpus import Corpus
from softdeca.surrogate.plan import STUDY, CorpusPlan
from softdeca.surrogate.sphere import Spheres

SPACE = Spheres(1)
PLAN = CorpusPlan(identities=(2, 1), expressions=(6, 3), parameter_sets=(4, 2), frames=3)


def refuse(skin):
    raise FitError("the skin is open")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    corpus = Corpus(tmp_path_factory.mktemp("corpus"), PLAN, SPACE)
    corpus.generate(SPACE.fit)
    return corpus


def checksums(corpus):
    return [corpus.shard(k).checksum for k in range(corpus.plan.people)]


@pytest.mark.parametrize("plan", [PLAN, STUDY, CorpusPlan(seed=7, identities=(30, 10))])
def test_splits_share_no_identity_expression_or_parameters(plan):
    drawn = {"train": set(), "test": set()}
    for identity in range(plan.people):
        for frame in plan.frames_of(identity):
            drawn[plan.split(identity)] |= {("expression", frame.expression), ("parameters", frame.parameter_set)}
    assert drawn["train"] and drawn["test"] and not drawn["train"] & drawn["test"]
    codes = [plan.sample_identity(SPACE, identity)[0].tobytes() for identity in range(plan.people)]
    assert len(set(codes)) == plan.people
    weights = [plan.weights(number).tobytes() for number in range(sum(plan.expressions))]
    assert len(set(weights)) == len(weights)


def test_parameters_vary_as_planned_and_no_others():
    values = [PLAN.parameters(number) for number in range(40)]
    for info in Parameters.infos():
        spread = np.ptp([getattr(value, info.name) for value in values])
        assert (spread > 0.3 * (info.high - info.low)) == (info.name in PLAN.parameter_names), info.name


def test_samples_are_what_the_simulator_found(made):
    test = made.samples("test")
    assert len(test) == 3 and set(test.identity) == {2}
    code, skin = PLAN.sample_identity(SPACE, 2)
    expected = skin.vertices + np.tensordot(test.weights, SPACE.expression_deltas(code), axes=1)
    assert np.abs(test.blended - expected).max() < 1e-3
    assert 0.001 < np.linalg.norm(test.simulated - test.blended, axis=2).mean() < 5.0
    assert made.status().accepted == 9 and not made.status().rejected


def test_deleted_truncated_and_flipped_shards_are_named_and_made_anew(made):
    before = checksums(made)
    made.shard_path(0).unlink()
    whole = made.shard_path(1).read_bytes()
    made.shard_path(1).write_bytes(whole[: len(whole) // 2])
    with h5py.File(made.shard_path(2), "r+") as file:
        file["corrected"][0, 0, 0] += np.float16(0.5)
    with pytest.raises(InputError, match="identity-00000.*missing"):
        made.verify()
    status = made.status()
    assert status.identities_done == 0
    assert "truncated" in status.damaged[0] and "checksum" in status.damaged[1]
    seen = []
    made.generate(SPACE.fit, on_progress=lambda what, fraction: seen.append(fraction))
    assert checksums(made) == before and seen[-1] == 1.0
    made.generate(refuse)  # nothing is left to do
    assert checksums(made) == before


def test_two_workers_make_the_same(made, tmp_path):
    other = Corpus(tmp_path, PLAN, SPACE)
    other.generate(SPACE.fit, workers=2)
    assert checksums(other) == checksums(made)


def test_what_fails_is_listed_with_its_reason(tmp_path):
    corpus = Corpus(tmp_path, PLAN, SPACE)
    status = corpus.generate(refuse)
    assert status.accepted == 0 and len(status.rejected) == 9
    assert status.rejected[0].reason == "head: the skin is open"
    with pytest.raises(InputError, match="no frame of the train split"):
        corpus.samples("train")


def test_a_solve_that_stops_early_is_kept_out(tmp_path):
    plan = CorpusPlan(identities=(1, 1), expressions=(2, 2), parameter_sets=(1, 1), frames=2, max_iterations=1)
    status = Corpus(tmp_path, plan, SPACE).generate(SPACE.fit)
    assert status.accepted == 0
    assert all(rejection.reason.startswith("solver: iteration limit") for rejection in status.rejected)


def test_another_plan_or_template_is_refused(made, tmp_path):
    with pytest.raises(InputError, match="of another plan"):
        Corpus(made.folder, CorpusPlan(seed=1), SPACE)
    with pytest.raises(InputError, match="of another"):
        Corpus(made.folder, PLAN, Spheres(2))
    (tmp_path / "corpus.json").write_text(json.dumps([1]))
    with pytest.raises(InputError, match="not a corpus"):
        Corpus(tmp_path, PLAN, SPACE)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"identities": (0, 1)}, "identities"),
        ({"frames": 0}, "frames"),
        ({"parameter_names": ("colour",)}, "colour"),
        ({"parameter_names": ()}, "parameter_names"),
    ],
)
def test_bad_plans_are_named(options, message):
    with pytest.raises(InputError, match=message):
        CorpusPlan(**options)
