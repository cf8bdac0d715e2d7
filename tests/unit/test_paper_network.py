"""Hypernetwork, its torch solve, checkpoint and run time, on a small corpus of layered spheres."""

import warnings

import numpy as np
import pytest
import torch

from softdeca.lhm import InputError, Surface
from softdeca.lhm.base.geometry.deformation import DeformationTransfer
from softdeca.reference import Parameters
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.plan import CorpusPlan
from softdeca.surrogate.networks.hypernetwork import HypernetworkConfig
from softdeca.surrogate.networks.hypernetwork_training import smooth_positions, transfer_delta
from softdeca.surrogate.paper import HypernetworkSurrogate
from softdeca.surrogate.paper.anchors import still_vertices
from softdeca.surrogate.paper.baselines import Ridge
from softdeca.surrogate.paper.checkpoint import Checkpoint
from softdeca.surrogate.paper.evaluate import evaluate
from softdeca.surrogate.paper.hypernetwork import Hypernetwork
from softdeca.surrogate.paper.principal import least_gradients, principal_gradients
from softdeca.surrogate.paper.samples import samples_of
from softdeca.surrogate.paper.train import TrainConfig, split_identities, train
from softdeca.surrogate.sphere import Spheres

SPACE = Spheres(1)
PLAN = CorpusPlan(
    identities=20, groups=5, frames=2, sequences=0, responses=0.0, kinds={"few": 1.0}, varying=0.0,
    sources={"random": 1.0}, conversations=0, random=6,
)  # fmt: skip
COUNT = 3
SMALL = HypernetworkConfig(latent=24, expression_hidden=32, position=8, gain_hidden=8, hidden=8)
CONFIG = TrainConfig(network=SMALL, steps=400, validate_every=50)


@pytest.fixture(scope="module")
def samples(tmp_path_factory):
    corpus = Corpus(tmp_path_factory.mktemp("corpus"), PLAN, OfSpace(SPACE, SPACE.mean, SPACE.fit))
    corpus.generate()
    return {split: samples_of(corpus.folder, split) for split in ("train", "test")}


@pytest.fixture(scope="module")
def checkpoint(samples):
    return train(samples["train"], CONFIG)


@pytest.fixture(scope="module")
def surrogate(checkpoint, tmp_path_factory):
    path = tmp_path_factory.mktemp("checkpoint") / "surrogate.npz"
    checkpoint.save(path)
    return HypernetworkSurrogate.load(path)


def network_of(checkpoint):
    network = Hypernetwork(
        checkpoint.config,
        code_size=len(checkpoint.code_mean),
        n_parameters=len(checkpoint.parameter_names),
        table=checkpoint.network["table"],
        positions=checkpoint.network["position"],
    )
    network.load_state_dict({name: torch.from_numpy(np.asarray(v)) for name, v in checkpoint.network.items()})
    return network


def test_torch_solve_passes_gradcheck():
    skin = SPACE.mean
    transfer = DeformationTransfer(skin, [0, 5])
    generator = torch.Generator().manual_seed(0)
    gradients = 0.1 * torch.randn(2, len(skin.triangles), 9, generator=generator, dtype=torch.float64)
    blended = torch.from_numpy(np.stack([skin.vertices, 1.1 * skin.vertices]))
    assert torch.autograd.gradcheck(
        lambda g: transfer_delta(g, blended, transfer), (gradients.requires_grad_(),), fast_mode=True
    )


def test_least_gradients_reproduce_the_simulated_skins(samples):
    test = samples["test"]
    transfer = DeformationTransfer(test.reference, [0])
    delta = transfer.delta(least_gradients(test).astype(np.float64), test.blended.astype(np.float64))
    wanted = (test.simulated - test.blended).astype(np.float64)
    relative = delta - delta[:, :1] - (wanted - wanted[:, :1])
    assert np.abs(relative).max() < 0.01 * np.abs(wanted).max()


def test_principal_gradients_span_the_samples(samples):
    gradients = least_gradients(samples["train"])
    table = principal_gradients(samples["train"], len(gradients)).reshape(len(gradients), -1)
    flat = gradients.reshape(len(gradients), -1)
    fitted = np.linalg.lstsq(table.T, flat.T, rcond=None)[0].T @ table
    assert np.abs(fitted - flat).max() < 1e-3 * np.abs(flat).max()


def test_training_splits_by_identity(samples):
    training, validation = split_identities(samples["train"], CONFIG)
    assert not set(training.identity) & set(validation.identity)
    assert len(training) + len(validation) == len(samples["train"])


def test_training_beats_blendshapes_on_unseen_identities(surrogate, samples):
    deltas = SPACE.expression_deltas(np.zeros(SPACE.code_size))
    found = evaluate(surrogate, samples["test"], samples["train"], expressions=deltas)
    assert found.frames == 20 and found.identities == 2
    by_hand = np.linalg.norm(samples["test"].simulated - samples["test"].blended, axis=2)
    assert found.blendshapes.mean == pytest.approx(by_hand.mean(), rel=1e-4)
    assert found.blendshapes.max == pytest.approx(by_hand.max(), rel=1e-4)
    assert found.gain > 1.5
    with pytest.raises(InputError, match="is in training and test"):
        evaluate(surrogate, samples["train"], samples["train"], expressions=deltas)


def test_training_is_deterministic_and_resumes_where_it_stopped(samples, checkpoint, tmp_path):
    state = tmp_path / "state.pt"
    short = TrainConfig(network=SMALL, steps=400, validate_every=50, seconds=1e-9)
    halted = train(samples["train"], short, state=state)
    assert halted.summary.steps == 50
    config = torch.load(state, weights_only=True)
    torch.save({**config, "of": repr(CONFIG)}, state)
    resumed = train(samples["train"], CONFIG, state=state)
    assert [p.validation_mm for p in resumed.summary.history] == [p.validation_mm for p in checkpoint.summary.history]
    for name, value in checkpoint.network.items():
        assert np.array_equal(value, resumed.network[name]), name


def test_a_damaged_training_state_is_named(samples, tmp_path):
    state = tmp_path / "state.pt"
    state.write_text("not a state")
    with pytest.raises(InputError, match="state.pt: damaged"):
        train(samples["train"], CONFIG, state=state)


def test_run_time_equals_torch(surrogate, checkpoint, samples):
    test, network = samples["test"], network_of(checkpoint)
    codes = torch.from_numpy(((test.codes - checkpoint.code_mean) / checkpoint.code_scale).astype(np.float32))
    with torch.no_grad():
        gradients = network(torch.from_numpy(test.weights), codes, torch.from_numpy(test.normalised_parameters()))
    transfer = DeformationTransfer(checkpoint.reference, checkpoint.anchors)
    expected = test.blended + transfer.delta(gradients.double().numpy(), test.blended.astype(np.float64))
    for k in (0, 7, 19):
        parameters = Parameters(**dict(zip(test.parameter_names, test.parameters[k], strict=True)))
        rig = surrogate.bind(SPACE.mean, test.codes[k], parameters)
        assert np.abs(rig.frame(test.weights[k], blended=test.blended[k]) - expected[k]).max() < 1e-4
        assert np.abs(expected[k] - test.blended[k]).max() > 1e-2


def test_saved_and_loaded_is_the_same(checkpoint, surrogate):
    weights = np.linspace(0.0, 1.0, 52)
    arguments = SPACE.mean, np.zeros(SPACE.code_size), Parameters(gravity=2.0)
    deltas = SPACE.expression_deltas(np.zeros(SPACE.code_size))
    before = HypernetworkSurrogate(checkpoint).bind(*arguments, expressions=deltas).frame(weights)
    assert np.array_equal(before, surrogate.bind(*arguments, expressions=deltas).frame(weights))
    assert surrogate.checkpoint.summary == checkpoint.summary
    assert surrogate.checkpoint.config == SMALL


def test_own_expressions_make_the_blendshapes(surrogate):
    deltas = np.random.default_rng(0).normal(size=(52, *SPACE.mean.vertices.shape))
    weights = np.zeros(52)
    weights[[3, 30]] = 0.25, 1.0
    rig = surrogate.bind(SPACE.mean, np.zeros(SPACE.code_size), expressions=deltas)
    expected = SPACE.mean.vertices + 0.25 * deltas[3] + deltas[30]
    assert np.abs(rig.blend(weights) - expected).max() < 1e-4
    assert np.array_equal(rig.frame(weights), rig.frame(weights, blended=rig.blend(weights)))


def test_parameters_per_face(surrogate):
    names, faces = surrogate.checkpoint.parameter_names, len(SPACE.mean.triangles)
    code, weights, soft = np.zeros(SPACE.code_size), np.full(52, 0.3), Parameters(target_stiffness=2.0)
    per_face = np.tile(soft.vector(names), (faces, 1))

    def frame(parameters):
        return surrogate.bind(SPACE.mean, code, parameters).frame(weights, blended=1.02 * SPACE.mean.vertices)

    assert np.abs(frame(per_face) - frame(soft)).max() < 1e-4
    per_face[: faces // 2] = Parameters().vector(names)
    assert np.abs(frame(per_face) - frame(soft)).max() > 1e-3


def test_weights_outside_their_range_are_clipped_and_counted(surrogate):
    rig = surrogate.bind(SPACE.mean, np.zeros(SPACE.code_size), expressions=np.ones((52, 42, 3)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        inside = rig.frame(np.r_[1.0, 0.0, np.full(50, 0.5)])
    with pytest.warns(UserWarning, match="2 of 52"):
        outside = rig.frame(np.r_[1.5, -0.1, np.full(50, 0.5)])
    assert np.array_equal(inside, outside)


def bind(surrogate, **changes):
    arguments = {"skin": SPACE.mean, "code": np.zeros(SPACE.code_size), "parameters": Parameters()}
    return surrogate.bind(**{**arguments, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"skin": Spheres(2).mean}, "skin: 162 vertices, .* has 42"),
        ({"skin": Surface(SPACE.mean.vertices, SPACE.mean.triangles[::-1])}, "its triangles are not"),
        ({"code": np.zeros(3)}, "code: expected 4"),
        ({"code": np.full(4, np.nan)}, "code: expected 4 finite"),
        ({"parameters": Parameters(soft_volume=1.2)}, "soft_volume = 1.2: .* trained at 1 only"),
        ({"parameters": np.zeros((5, COUNT))}, rf"shape \(80, {COUNT}\)"),
        ({"parameters": np.zeros((80, COUNT))}, r"soft_stiffness = 0 is outside \[1, 20\]"),
        ({"expressions": np.zeros((51, 42, 3))}, "expressions: expected finite displacements of shape"),
    ],
)
def test_bad_bindings_are_named(surrogate, changes, message):
    with pytest.raises(InputError, match=message):
        bind(surrogate, **changes)


@pytest.mark.parametrize(
    ("weights", "blended", "message"),
    [
        (np.zeros(51), None, "the 52 of ARKit"),
        (np.r_[np.zeros(51), np.nan], None, "number 51 is not finite"),
        (np.zeros(52), None, "expressions: not known"),
        (np.zeros(52), np.zeros((41, 3)), "blended: expected"),
        (np.zeros(52), np.full((42, 3), np.inf), "blended: expected finite"),
    ],
)
def test_bad_frames_are_named(surrogate, weights, blended, message):
    with pytest.raises(InputError, match=message):
        bind(surrogate).frame(weights, blended=blended)


def test_files_that_are_no_checkpoint_are_named(checkpoint, tmp_path):
    path = tmp_path / "surrogate.npz"
    with pytest.raises(InputError, match="no such file; `softdeca train` makes it"):
        Checkpoint.load(path)
    path.write_text("v 0 0 0\n")
    with pytest.raises(InputError, match="checkpoint of softdeca"):
        Checkpoint.load(path)
    np.savez(path, vertices=np.zeros((3, 3)))
    with pytest.raises(InputError, match="checkpoint of softdeca"):
        Checkpoint.load(path)
    checkpoint.save(path)
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(InputError, match="damaged"):
        Checkpoint.load(path)


def test_positions_start_smooth_and_normalised():
    positions = smooth_positions(SPACE.mean, 8, np.random.default_rng(0))
    assert positions.shape == (80, 8)
    assert np.allclose(positions.mean(axis=0), 0.0, atol=1e-5) and np.allclose(positions.std(axis=0), 1.0, atol=1e-4)


def test_ridge_recovers_a_linear_law(samples):
    train_set, rng = samples["train"], np.random.default_rng(0)
    modes = rng.normal(size=(52, 42 * 3)) / 10.0
    linear = (train_set.weights @ modes).reshape(train_set.blended.shape).astype(np.float32)
    law = type(train_set)(**{**vars(train_set), "simulated": train_set.blended + linear})
    assert np.abs(Ridge.fit(law).predict(law) - law.simulated).mean() < 0.02 * np.abs(linear).mean()


def test_anchors_are_the_stillest_of_each_part(samples):
    train_set = samples["train"]
    motion = np.linalg.norm(train_set.simulated - train_set.blended, axis=2)
    stillest = np.argsort(np.sqrt((motion**2).mean(axis=0)))[:4]
    assert set(still_vertices(train_set, 0.1)) == set(stillest)
    n = 42
    apart = Surface(
        np.vstack([SPACE.mean.vertices, SPACE.mean.vertices + 300.0]),
        np.vstack([SPACE.mean.triangles, SPACE.mean.triangles + n]),
    )
    far = np.concatenate([train_set.simulated, train_set.blended + 9.0], axis=1)
    both = np.concatenate([train_set.blended] * 2, axis=1)
    two = type(train_set)(**{**vars(train_set), "reference": apart, "blended": both, "simulated": far})
    anchors = still_vertices(two, 0.1)
    assert set(anchors[:4]) == set(stillest) and len(anchors) == 8 and anchors[4:].min() >= n
