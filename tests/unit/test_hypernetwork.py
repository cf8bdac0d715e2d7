"""Networks of deformation gradients: torch solve, training, weights and run time, on a small corpus of spheres."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from softdeca.benchmarks.contest import summarise
from softdeca.benchmarks.studies.surrogate.scores import CORPUS, run_trials
from softdeca.lhm import InputError, Surface
from softdeca.lhm.base.geometry.deformation import DeformationTransfer, least_gradients
from softdeca.reference import Face, Parameters
from softdeca.surrogate import Surrogate
from softdeca.surrogate.corpus.face import Heads
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.plan import CorpusPlan
from softdeca.surrogate.corpus.reading import Faces
from softdeca.surrogate.corpus.spheres import Spheres
from softdeca.surrogate.methods import BLENDSHAPES, METHODS, NETWORK, ready_methods
from softdeca.surrogate.networks.frames import FrameSource
from softdeca.surrogate.networks.gradient_training import (
    NETWORKS,
    GradientLesson,
    GradientTraining,
    SparseTransfer,
    still_vertices,
    train_gradients,
)
from softdeca.surrogate.networks.gradients import Widths
from softdeca.surrogate.networks.trainer import Lesson, Muon, Trainer, TrainerConfig
from softdeca.surrogate.networks.weights import FORMS
from softdeca.surrogate.trials import static_trials

SPACE = Spheres(1)
PEOPLE = OfSpace(SPACE, SPACE.mean, SPACE.fit)
N = len(SPACE.mean.vertices)
PLAN = CorpusPlan(
    identities=20, groups=5, frames=2, sequences=0, responses=1.0,
    kinds={"materials": 1.0}, varying=0.0, sources={"random": 1.0}, conversations=0, random=6,
)  # fmt: skip
SMALL = Widths(
    response_tables=4,
    effect_tables=3,
    response_components=3,
    effect_components=3,
    response=16,
    effect=16,
    position=8,
    latent=24,
    expression=64,
    hidden=16,
)
CONFIG = GradientTraining(
    network=SMALL, steps=200, batch=8, frames=2, weight_decay=0.3,
    validate_every=50,
)  # fmt: skip
QUICK = {"network": SMALL, "steps": 90, "batch": 8, "frames": 2, "learning_rate": 2e-3, "validate_every": 30}
"""In place of the paper's protocol."""


@pytest.fixture(scope="module")
def faces(tmp_path_factory):
    corpus = Corpus.from_plan(tmp_path_factory.mktemp("corpus"), PLAN, PEOPLE)
    corpus.generate()
    return {split: Faces(corpus.folder, split, heads=Heads(lambda: PEOPLE)) for split in ("train", "test")}


@pytest.fixture(scope="module")
def samples(faces):
    return FrameSource(faces["train"]).sample(1000, np.random.default_rng(0))


@pytest.fixture(scope="module")
def weights(faces):
    return train_gradients(faces["train"], CONFIG)


@pytest.fixture(scope="module")
def surrogate(weights):
    return Surrogate(weights)


def shapes():
    return SPACE.expression_deltas(np.zeros(SPACE.code_size))


def bind(surrogate, **changes):
    arguments = {"skin": SPACE.mean, "code": np.zeros(SPACE.code_size), "parameters": Parameters()}
    return surrogate.bind(**{**arguments, "expressions": shapes(), **changes})


def test_the_torch_solve_passes_gradcheck_and_agrees():
    skin = SPACE.mean
    transfer = DeformationTransfer(skin, [0, 5])
    generator = torch.Generator().manual_seed(0)
    gradients = 0.1 * torch.randn(2, len(skin.triangles), 9, generator=generator, dtype=torch.float64)
    blended = torch.from_numpy(np.stack([skin.vertices, 1.1 * skin.vertices]))
    solve = SparseTransfer(transfer)
    assert torch.autograd.gradcheck(lambda g: solve(g, blended), (gradients.requires_grad_(),), fast_mode=True)
    found = solve(gradients, blended).detach().numpy()
    np.testing.assert_allclose(found, transfer.delta(gradients.detach().numpy(), blended.numpy()), atol=1e-12)


def test_ours_begins_at_first_order(faces):
    """Before its first step it adds next to nothing."""
    errors = GradientLesson(faces["train"], CONFIG).errors()
    assert (
        errors["network"] == pytest.approx(errors["still"], rel=0.01) and errors["still"] < 0.1 * errors["blendshapes"]
    )


def test_tables_are_those_of_a_start_or_learned_anew(faces, weights):
    few = replace(CONFIG, steps=4, validate_every=4)
    of_tables = {name for name in weights.network if name.startswith(("response_", "effect_", "lag"))}
    kept = train_gradients(faces["train"], few, start=weights)
    assert all(kept.network[name] is weights.network[name] for name in of_tables) and len(kept.note.curve) == 1
    more = train_gradients(faces["train"], few, start=weights, extra_faces=faces["test"])
    moved = {name for name in of_tables if not np.array_equal(more.network[name], weights.network[name])}
    # Materials alone have no effect.
    still = {"effect_first", "effect_gain.bias", "effect_table"}
    assert of_tables - moved == {"response_position", "effect_position"} | still
    assert more.note.all_faces == more.note.faces + len(faces["test"])
    assert more.people == weights.people | faces["test"].name_people()
    unknown = train_gradients(faces["train"], few, start=replace(weights, people=frozenset()))
    assert not unknown.people


def test_scaled_bones_carry_the_skin_before_a_network_without_tables_moves_it(faces):
    """A network that has not seen them gives what it gives to the carried skin."""
    surrogate = Surrogate(train_gradients(faces["train"], replace(NETWORKS["paper"], **QUICK)))
    assert surrogate.needs == "head"
    scaled = Parameters(mandible_scale_y=1.1)
    head = SPACE.fit(SPACE.mean)
    carried = Face(head, parameters=scaled).carried
    assert np.abs(carried).max() > 0.5
    w = np.full(52, 0.2)
    with pytest.warns(UserWarning, match="mandible_scale_y"):
        frame = bind(surrogate, parameters=scaled, head=head, beyond="clamp").frame(w)
    plain = bind(surrogate).frame(w)
    assert np.abs(frame - plain - carried).max() < 0.3 * np.abs(carried).max()


def test_least_gradients_reproduce_the_simulated_skins(samples):
    moved = samples.simulated - samples.blended
    pairs = zip(samples.blended, moved, strict=True)
    gradients = np.array([least_gradients(before, moves, SPACE.mean.triangles) for before, moves in pairs])
    delta = DeformationTransfer(SPACE.mean, [0]).delta(gradients.astype(np.float64), samples.blended.astype(np.float64))
    relative = delta - delta[:, :1] - (moved - moved[:, :1]).astype(np.float64)
    assert np.abs(relative).max() < 0.01 * np.abs(moved).max()


def test_training_beats_blendshapes_on_unseen_people_by_the_same_evaluator(weights, faces):
    methods = ready_methods(Surrogate(weights))[NETWORK], METHODS[BLENDSHAPES]
    scores = summarise(run_trials(static_trials(faces["test"]), *methods), "method", CORPUS)
    network, nothing = scores[NETWORK], scores[BLENDSHAPES]
    assert len(network.frames) == 20
    assert network.everywhere < nothing.everywhere / 1.5
    held, training = set(weights.note.held), set(faces["train"].groups[:, 0].tolist())
    assert held < training and len(training - held) == weights.note.people == len(weights.people)
    weights.check_unseen(faces["test"].name_people(), "corpus")
    with pytest.raises(InputError, match=f"corpus: the weights learned from {len(training - held)} of its"):
        weights.check_unseen(faces["train"].name_people(), "corpus")
    assert ready_methods(Surrogate(weights))[NETWORK].needs == "nothing"


@pytest.mark.parametrize("name", [*NETWORKS])
def test_every_form_s_frames_at_run_time_are_those_of_its_training(name, faces, tmp_path):
    weights = train_gradients(faces["train"], replace(NETWORKS[name], **QUICK))
    losses = [point["loss"] for point in weights.note.curve]
    assert losses[-1] < 0.95 * losses[0] and weights.note.steps == 90
    if "scale" in weights.network:
        weights.network["scale"][:] *= 100.0  # spheres have little beyond first order
    weights.save(tmp_path / "weights.safetensors")
    surrogate = Surrogate.load(tmp_path / "weights.safetensors")
    assert surrogate.weights.people == weights.people
    network = {name: torch.from_numpy(value) for name, value in surrogate.weights.network.items()}
    followed, form = weights.network["followed"] > 0.0, FORMS[weights.kind]
    source = FrameSource(faces["test"], first_order=form.has_tables)
    test = source.sample(2, np.random.default_rng(0))
    codes = np.array([surrogate.inputs.code(code) for code in test.codes]).astype(np.float32)
    parts = test.weights[:, None], codes, np.clip(test.coefficients[:, None, followed, 0], -1.0, 1.0)
    every = form.gradients(network, *map(torch.from_numpy, parts))
    gradients = every.flatten(0, 1).double().numpy()
    transfer = DeformationTransfer(weights.mean, np.flatnonzero(weights.network["anchored"]))
    expected = test.blended + transfer.delta(gradients, test.blended.astype(np.float64))
    assert np.abs(expected - test.blended).max() > 1e-3
    for k, number in enumerate(test.face):
        face = faces["test"].face(int(source.face[number]))
        frame = surrogate.bind_face(face, exact=form.has_tables).frame(test.weights[k])
        assert np.abs(frame - expected[k]).max() < 1e-4


def test_parameters_per_face(surrogate):
    soft, count = Parameters(target_stiffness=2.0), len(SPACE.mean.triangles)
    stiffness = np.full(count, 2.0)

    def frame(parameters):
        return bind(surrogate, parameters=parameters).frame(np.full(52, 0.3), blended=1.02 * SPACE.mean.vertices)

    assert np.abs(frame(Parameters(target_stiffness=stiffness)) - frame(soft)).max() < 1e-4
    stiffness[: count // 2] = Parameters().target_stiffness
    assert np.abs(frame(Parameters(target_stiffness=stiffness)) - frame(soft)).max() > 1e-3


class Diverges(Lesson):
    """A lesson whose loss is infinite at the third step."""

    def __init__(self):
        self.network = {"x": torch.ones(1, requires_grad=True)}

    def loss(self, done, rng):
        return (self.network["x"] / (2.0 - round(9 * done))).sum()


def test_a_loss_that_is_not_finite_ends_a_training():
    with pytest.raises(InputError, match="the loss is not finite at step 3; take a lower learning rate"):
        Trainer(Diverges(), TrainerConfig(steps=9)).train()


@pytest.mark.parametrize("shape", [(24, 40), (40, 24)])
def test_muon_steps_as_that_of_torch(shape):
    """But for bfloat16, which rounds to three digits."""
    generator = torch.Generator().manual_seed(0)
    start, *gradients = torch.randn(4, *shape, generator=generator)
    ends = []
    for make in (Muon, partial(torch.optim.Muon, adjust_lr_fn="match_rms_adamw")):
        matrix = start.clone().requires_grad_()
        optimiser = make([matrix], lr=0.1, weight_decay=0.3)
        for gradient in gradients:
            matrix.grad = gradient.clone()
            optimiser.step()
        ends.append(matrix.detach())
    assert (ends[0] - ends[1]).norm() < 0.02 * (ends[1] - start).norm()


def test_steps_that_tell_how_many_fit_into_hours_are_undone():
    lesson = Stalls()
    trainer = Trainer(lesson, TrainerConfig(hours=0.1, learning_rate=0.5))
    assert lesson.steps > 0 and trainer.steps > 1 and trainer.step == 0
    assert lesson.network["x"].item() == 1.0 and not trainer.optimisers[0].state


class Stalls(Lesson):
    """A lesson whose error is least after its second step."""

    def __init__(self):
        self.network, self.steps = {"x": torch.ones(1, requires_grad=True)}, 0

    def loss(self, done, rng):
        self.steps += 1
        return self.network["x"].sum()

    def errors(self):
        return {"left": abs(self.steps - 2.0)}


def test_held_out_people_end_a_training():
    trainer = Trainer(Stalls(), TrainerConfig(steps=90, validate_every=1, best_by="left", patience=3))
    trainer.train()
    assert trainer.step == 5 and trainer.least == 0.0


def test_anchors_are_the_stillest_of_each_part(samples, faces):
    motion = np.linalg.norm(samples.simulated - samples.blended, axis=2)
    stillest = np.argsort(np.sqrt((motion**2).mean(axis=0)))[:4]
    moved = samples.simulated - samples.blended
    assert set(still_vertices(SPACE.mean, moved, 0.1)) == set(stillest)
    apart = Surface(
        np.vstack([SPACE.mean.vertices, SPACE.mean.vertices + 300.0]),
        np.vstack([SPACE.mean.triangles, SPACE.mean.triangles + N]),
    )
    anchors = still_vertices(apart, np.concatenate([moved, np.full_like(moved, 9.0)], axis=1), 0.1)
    assert set(anchors[:4]) == set(stillest) and len(anchors) == 8 and anchors[4:].min() >= N
    lesson = GradientLesson(faces["train"], CONFIG)
    held = np.flatnonzero(lesson.network["anchored"])
    assert 0 < len(held) < N // 5 and set(held) <= set(np.argsort(motion.mean(axis=0))[: N // 2])
