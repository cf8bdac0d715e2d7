"""The modal surrogate, its rivals and its run time, on a small corpus of layered spheres."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from softdeca.benchmarks.contest import summarise
from softdeca.benchmarks.studies.surrogate.scores import CORPUS, run_trials
from softdeca.lhm import InputError, identities
from softdeca.lhm.identities.nearest import nearest_code
from softdeca.reference import Face, Parameters
from softdeca.reference.face.derivatives import TIGHT_ACCURACY
from softdeca.surrogate import Surrogate
from softdeca.surrogate.corpus.card import write_card
from softdeca.surrogate.corpus.face import Derivatives, Frames, Heads, KeptFace, Person
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.mixture import KINDS, NAMES, ParameterSet, draw
from softdeca.surrogate.corpus.people import OfSpace, people_from_text
from softdeca.surrogate.corpus.plan import CorpusPlan
from softdeca.surrogate.corpus.reading import Faces
from softdeca.surrogate.corpus.simulator import make_face
from softdeca.surrogate.corpus.spheres import Spheres
from softdeca.surrogate.methods import BLENDSHAPES, METHODS, Method, ready_methods
from softdeca.surrogate.networks.features import Features
from softdeca.surrogate.networks.modal import ModalConfig, basis, bind_modal, remainder
from softdeca.surrogate.networks.modal_faces import LessonFace, LessonFaces
from softdeca.surrogate.networks.modal_training import ModalTraining, RemainderLesson, draw_network, train_modal
from softdeca.surrogate.networks.table_training import Regression, TableLesson, TableTraining, balance, keep_components
from softdeca.surrogate.networks.tables import Tables, compress, expand, find_first_order, mix_effects, mix_responses
from softdeca.surrogate.networks.trainer import Trainer, to_tensors
from softdeca.surrogate.networks.vertices_only import TRAINING, VerticesOnly
from softdeca.surrogate.networks.weights import Weights
from softdeca.surrogate.rigs.inertia import Looseness
from softdeca.surrogate.runtime import SHIPPED
from softdeca.surrogate.trials import static_trials

SPACE = Spheres(1)
PEOPLE = OfSpace(SPACE, SPACE.mean, SPACE.fit)
N = len(SPACE.mean.vertices)
PLAN = CorpusPlan(
    identities=20, groups=4, frames=5, sequences=0,
    kinds={"effects": 0.5, "both": 0.5}, sources={"random": 1.0}, conversations=0, random=6,
)  # fmt: skip
NETWORK = ModalConfig(
    modes=12,
    response_tables=6,
    effect_tables=4,
    response_components=4,
    effect_components=3,
    position=4,
    local=16,
    response=16,
    effect=16,
    summary=24,
    expression=32,
)
CONFIG = ModalTraining(network=NETWORK, steps=60, frames=4, vertices=42, validate_every=20, validation=0.1)


@pytest.fixture(scope="module")
def faces(tmp_path_factory):
    corpus = Corpus.from_plan(tmp_path_factory.mktemp("corpus"), PLAN, PEOPLE)
    corpus.generate()
    return {split: Faces(corpus.folder, split, heads=Heads(lambda: PEOPLE)) for split in ("train", "test")}


@pytest.fixture(scope="module")
def weights(faces):
    return train_modal(faces["train"], CONFIG)


@pytest.fixture(scope="module")
def surrogate(weights, tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "modal.safetensors"
    weights.save(path)
    return Surrogate.load(path)


def shapes():
    return SPACE.expression_deltas(np.zeros(SPACE.code_size))


def bound(surrogate, **changes):
    arguments = {"skin": SPACE.mean, "code": np.zeros(SPACE.code_size), "parameters": Parameters()}
    return surrogate.bind(**{**arguments, "expressions": shapes(), **changes})


def score(methods, test):
    """Scores over all frames by method."""
    return summarise(run_trials(static_trials(test), *methods), "method", CORPUS)


def learn(learners, training):
    for learner in learners.values():
        learner.fit(training)
    return [Method(name, learner.bind) for name, learner in learners.items()]


def test_the_network_beats_doing_nothing_and_the_hybrid_its_own_derivatives(weights, faces):
    scores = score([*ready_methods(Surrogate(weights)).values()], faces["test"])
    assert scores["network"].everywhere < 0.5 * scores["blendshapes"].everywhere
    # Small spheres answer all but linearly: what is left is float16's rounding.
    hybrid, linearised_alone = scores["network + derivatives"], scores["derivatives"]
    assert hybrid.everywhere < 1.2 * linearised_alone.everywhere < 0.01


def test_networks_of_others_learn_and_are_bound(faces):
    learner = VerticesOnly(replace(TRAINING, steps=300))
    scores = score([*learn({"vertices only": learner}, faces["train"]), METHODS[BLENDSHAPES]], faces["train"])
    *learned, nothing = scores.values()
    assert all(one.everywhere < 0.95 * nothing.everywhere for one in learned)
    # In numpy or torch, a network is the same function of w, p and h.
    face, w = faces["test"].face(0), np.linspace(0.0, 0.5, 52, dtype=np.float32)
    summary = learner._inputs.summary_of(face)[None]
    network = {name: torch.from_numpy(value) for name, value in learner.arrays.items()}
    bound = learner.bound(network, torch.from_numpy(summary))
    answer = learner._size * learner.answer(network, bound, torch.from_numpy(w[None]))[0].numpy()
    assert np.abs(learner.bind(face).correct(w) - answer).max() < 1e-4


def test_training_is_deterministic_and_resumes_where_it_stopped(faces, weights, tmp_path):
    state = tmp_path / "state.pt"

    def interrupt(text, *_):
        if "held-out" in text:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_modal(faces["train"], CONFIG, state=state, on_progress=interrupt)
    of_tables = torch.load(tmp_path / "state.tables.pt", weights_only=True)
    assert 0 < of_tables["step"] < CONFIG.tables.schedule(CONFIG).steps
    resumed = train_modal(faces["train"], CONFIG, state=state)
    assert [point["loss"] for point in resumed.note.curve] == [point["loss"] for point in weights.note.curve]
    for name, value in weights.network.items():
        assert np.array_equal(value, resumed.network[name]), name
    with pytest.raises(InputError, match="of another training"):
        train_modal(faces["train"], replace(CONFIG, steps=7), state=state)
    state.write_text("not a state")
    with pytest.raises(InputError, match="state.pt: damaged"):
        train_modal(faces["train"], CONFIG, state=state)


def test_training_goes_on_from_weights(faces, weights, tmp_path):
    """Frames alone teach the remainder; more faces, or a corpus without frames, teach tables."""
    weights.save(tmp_path / "weights.safetensors")
    start = Weights.load(tmp_path / "weights.safetensors")
    few = replace(CONFIG, steps=10, validate_every=5)
    more = train_modal(faces["train"], few, start=start)
    of_remainder = ("gain_", "remainder_", "modes")
    assert find_learned(more, start) == {name for name in start.network if name.startswith(of_remainder)}
    whole = train_modal(faces["train"], few, start=start, extra_faces=faces["train"])
    fixed = {"size_remainder", "response_position", "effect_position"}
    assert find_learned(whole, start) == set(start.network) - fixed
    assert [point["step"] for point in whole.note.curve] == [20, 40, 45, 50]
    assert more.note.before["steps"] == weights.note.steps and more.note.steps == 10


def find_learned(weights, start):
    return {name for name, value in weights.network.items() if not np.array_equal(value, start.network[name])}


def test_faces_without_frames_teach_tables_alone(weights, tmp_path):
    plan = replace(PLAN, identities=14, frames=0)
    corpus = Corpus.from_plan(tmp_path / "faces", plan, PEOPLE)
    corpus.generate()
    assert write_card(corpus)["frames"] == {"all": 0} | dict.fromkeys(KINDS, 0)
    faces = Faces(corpus.folder, "train", heads=Heads(lambda: PEOPLE))
    few = replace(CONFIG, steps=10, validate_every=5)
    learned = find_learned(train_modal(faces, few, start=weights), weights)
    assert learned and not [name for name in learned if name.startswith(("gain_", "remainder_", "modes", "size_"))]


def divide(faces, split="train"):
    return LessonFaces.divide(faces[split], None, None, validation_share=0.1, rng=np.random.default_rng(0))


@pytest.fixture
def lessons(faces):
    """Lessons of tables and of the remainder, begun, with tables of all vertices."""
    data = divide(faces)
    network = draw_network(data, replace(CONFIG, sampled=20), np.random.default_rng(0))
    of_tables = TableLesson(data, network, TableTraining(vertices=20), 0, "cpu", lambda *_: None)
    trainer = Trainer(of_tables, CONFIG.tables.schedule(CONFIG))
    trainer.run(3)
    network |= {name: value for name, value in trainer.arrays().items() if name in network}
    network |= compress(of_tables.solve_all(lambda *_: None).factorise(4 * N, 3 * N))
    return of_tables, RemainderLesson(data, network, CONFIG, "cpu")


def test_the_run_time_s_arrays_give_the_same_as_the_training_s_tensors(faces, lessons):
    of_tables, of_remainder = lessons
    Trainer(of_remainder, CONFIG).run(3)
    data, tables = of_remainder.data, of_remainder.tables
    face, features, w = faces["test"].face(1), data.features, np.random.default_rng(0).random((3, 52))
    p, code = features.at_vertices(face.coefficients), data.inputs.code(face.code)
    network = to_tensors(of_remainder.whole, "cpu") | of_remainder.network
    arrays = {name: value.detach().numpy() for name, value in network.items()}
    bound = bind_modal(arrays, find_first_order(arrays, tables, features, code, p, face.shapes), features, code, p)
    local, h, effects, summary = (
        torch.from_numpy(array.astype(np.float32))[None]
        for array in (features.local(p), code[None], features.effects(p), features.summary(code, p)[None])
    )
    with torch.no_grad():
        of_tables, strengths = mix_effects(network, local, h, effects)
        offset = torch.einsum("vk,ve,kevc->vc", of_tables[0], strengths[0], multiply(tables.effects))
        factors = np.r_[1.0, code][:, None] * features.bones(p)
        offset = offset + np.einsum("cb,cbvx->vx", factors, tables.carry)
        shares, lag = mix_responses(network, local, h)
        mixed = torch.einsum("vk,kjvc->jvc", shares[0], multiply(tables.responses)) - lag * face.shapes
        amplitudes = remainder(network, summary)(torch.from_numpy(w).float()[None])
        expected = offset, mixed, amplitudes @ basis(network, local, h)
    for one, other in zip((bound.offset, bound.responses, bound.remainder(w)), expected, strict=True):
        assert np.abs(one.ravel() - other.numpy().ravel()).max() < 1e-4 * max(1.0, np.abs(one).max())


def multiply(table):
    """A table as (k, columns, n, 3), from its components."""
    parts = [slice(*ends) for ends in zip(table.first[:-1], table.first[1:], strict=True)]
    return torch.stack([torch.from_numpy(np.tensordot(table.mix[p].T, table.values[p], 1)) for p in parts], dim=2)


@pytest.mark.parametrize("which", [0, 1], ids=["tables", "remainder"])
def test_the_gradient_of_the_whole_loss_by_finite_differences(lessons, which):
    lesson = lessons[which]
    learned = {name: value for name, value in lesson.network.items() if value.requires_grad}
    lesson.network = {name: value.detach().double() for name, value in lesson.network.items()}
    lesson.dtype = torch.float64

    def loss():
        if which == 0:
            return lesson.measure(lesson.arrays.take(np.arange(5)), slice(None), scaled=True).sum()
        return lesson.loss_of(lesson.data.training[:3], np.random.default_rng(5), np.arange(N))

    for name in learned:
        lesson.network[name].requires_grad_()
    loss().backward()
    for name in learned:
        value = lesson.network[name]
        place = np.unravel_index(int(value.grad.abs().reshape(-1).argmax()), value.shape)
        slope, h = float(value.grad[place]), 1e-6
        with torch.no_grad():
            value[place] += h
            ahead = float(loss())
            value[place] -= 2 * h
            behind = float(loss())
            value[place] += h
        assert (ahead - behind) / (2 * h) == pytest.approx(slope, rel=1e-4, abs=1e-7), name


def test_tables_of_vertices_that_no_step_saw_are_as_good(lessons):
    of_tables, of_remainder = lessons
    seen, every = of_tables.sample, np.arange(N)
    solved = of_tables.solve([of_tables.data.read_held()], every)
    again = of_tables.solve([of_tables.data.read_held(seen)], seen)
    for one, other in zip(solved[:2], again[:2], strict=True):
        np.testing.assert_allclose(one[:, :, seen], other, rtol=1e-2, atol=1e-2 * np.abs(other).max())


def test_distances_count_rather_than_squares():
    """Weighed by what a first table misses, a second lets one face of ten, far from the others, pull it less."""
    values = torch.zeros(10, 1, 3)
    values[0] = 1.0
    scale, factors = torch.ones(10, 1), torch.ones(10, 1, 1)

    def solve(lengths):
        regression = Regression("cpu")
        regression.add(factors, values, lengths)
        return regression.solve(1e-6)

    first = solve(scale)
    again = solve(balance(scale, (values - torch.from_numpy(first)).norm(dim=-1)))
    assert np.allclose(first, 0.1, atol=1e-4) and 0.0 < again.max() < 0.02


def test_tables_are_found_again():
    """Faces that are mixed from tables give these tables, but for the ridge."""
    rng = np.random.default_rng(0)
    tables = rng.normal(size=(7, 3, 156)).astype(np.float32)
    factors = rng.normal(size=(200, 7, 3)).astype(np.float32)
    values = np.einsum("fvk,vkm->fvm", factors, tables)
    regression = Regression("cpu")
    regression.add(*map(torch.from_numpy, (factors, values, rng.uniform(0.5, 2.0, (200, 1)).astype(np.float32))))
    solved = regression.solve(0.03, (1, 0.01))
    assert np.abs(solved - tables).mean(axis=(0, 2)).max() < 0.05
    assert np.abs(solved - tables)[:, -1].mean() < 0.6 * np.abs(solved - tables)[:, 0].mean(), "a third of the ridge"


def test_components_that_count_are_kept_in_bytes():
    """Over all vertices those that faces show most: of three and two ranks, and none of a vertex that stands still."""
    rng = np.random.default_rng(0)
    table, faces = np.zeros((7, 52, 3, 3), np.float32), rng.normal(size=(200, 3, 7)).astype(np.float32)
    for v, rank in ((0, 3), (1, 2)):
        table[:, :, v] = np.einsum("kr,rjc->kjc", rng.normal(size=(7, rank)), rng.normal(size=(rank, 52, 3)))
    gram = np.einsum("fvk,fvl->vkl", faces, faces)
    whole = keep_components(table, gram, 5)
    assert whole.first.tolist() == [0, 3, 5, 5]
    assert np.abs(multiply(whole).numpy() - table).max() < 1e-4
    best, shown = keep_components(table, gram, 4), np.einsum("fvk,kjvc->fvjc", faces, table)
    lost = shown - np.einsum("fvk,kjvc->fvjc", faces, multiply(best).numpy())
    worst = min(np.linalg.svd(shown[:, v].reshape(200, -1), compute_uv=False)[rank - 1] for v, rank in ((0, 3), (1, 2)))
    assert np.linalg.norm(lost) == pytest.approx(worst, rel=1e-3), "the least of Eckart and Young"
    carry = rng.normal(size=(3, 6, 3, 3)).astype(np.float32)
    arrays = compress(Tables(whole, best, carry))
    for name in ("response", "effect", "carry"):
        assert np.array_equal(arrays[f"{name}_table"], arrays[f"{name}_table"].astype(np.int8))
    for name in ("response", "effect"):
        arrays |= {f"{name}_share.bias": np.zeros(6), f"{name}_position": np.zeros((3, 1))}
    with pytest.raises(InputError, match="the components of response_table"):
        expand(arrays | {"response_first": np.array([0.0, 3.0, 9.0, 5.0])})
    again = expand(arrays)
    assert np.abs(multiply(again.responses).numpy() - table).max() < 0.01 * np.abs(table).max()
    np.testing.assert_array_equal(again.carry[0], carry[0])


def test_exact_is_the_linearised_simulator_and_the_remainder(surrogate):
    skin, parameters = SPACE.mean, Parameters(soft_volume=1.2, soft_stiffness=3.0)
    head = SPACE.fit(skin)
    rig = bound(surrogate, parameters=parameters, exact=True, head=head)
    face = Face(head, shapes(), parameters, settling={}, accuracy=TIGHT_ACCURACY)
    assert np.abs(rig.neutral - (head.skin.vertices + face.offset)).max() < 1e-2
    weights = np.zeros(52)
    weights[7] = 0.5
    expected = face.blend(weights) + face.offset + 0.5 * face.responses[7] + rig.modes.remainder(weights)
    assert np.abs(rig.frame(weights) - expected).max() < 1e-2


def test_baked_targets_lose_less_the_more_there_are(surrogate):
    rig = bound(surrogate, parameters=Parameters(soft_volume=1.3))
    few, most = rig.bake(8), rig.bake(64)
    assert most.mean_error < 1e-3 < few.mean_error <= few.largest_error
    weights = np.linspace(0.0, 0.4, 52)
    assert np.abs(most.frame(weights) - rig.frame(weights)).max() < 5e-3
    by_hand = most.neutral + np.tensordot(most.target_weights(weights), most.targets, axes=1)
    assert np.abs(most.frame(weights) - by_hand).max() < 1e-3
    assert np.array_equal(rig.bake(np.int64(8)).targets, few.targets)


def test_a_parameter_per_face_is_averaged_alike_for_network_and_simulator():
    head, faces = SPACE.fit(SPACE.mean), np.arange(len(SPACE.mean.triangles))
    p = Parameters(soft_stiffness=np.where(faces % 2, 1.0, 20.0), soft_volume=np.where(faces % 2, 0.9, 1.3))
    face = Face(head, shapes(), p)
    for name, middle in (("soft_stiffness", 4.47), ("soft_volume", 1.1)):
        info, simulated = Parameters.info(name), getattr(face.on_wraps, name)
        learned = info.denormalise(
            (head.wrap_from_skin @ face.at_vertices(name))[head.skin_wrap.triangles].mean(axis=1)
        )
        np.testing.assert_allclose(simulated, learned, rtol=1e-12)
        assert np.median(simulated) == pytest.approx(middle, rel=0.25)


def test_weights_outside_their_range_are_clipped_and_counted(surrogate):
    rig = bound(surrogate)
    inside = rig.frame(np.r_[1.0, 0.0, np.full(50, 0.5)])
    with pytest.warns(UserWarning, match="2 of 52"):
        outside = rig.frame(np.r_[1.5, -0.1, np.full(50, 0.5)])
    assert np.array_equal(inside, outside)
    baked = rig.bake(4)
    with pytest.warns(UserWarning, match="1 of 52 weights outside"):
        found = baked.target_weights(np.r_[1.5, np.full(51, 0.5)])
    assert np.array_equal(found, baked.target_weights(np.r_[1.0, np.full(51, 0.5)]))


def test_weights_that_are_damaged_or_old_are_named(weights, tmp_path):
    path = tmp_path / "modal.safetensors"
    weights.save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[:-300])
    with pytest.raises(InputError, match="damaged, their content does not match"):
        Weights.load(path)
    path.write_bytes(whole.replace(b'format\\": 8', b'format\\": 7', 1))
    with pytest.raises(InputError, match="of format 7, this version reads 8; train them anew"):
        Weights.load(path)


def test_both_shipped_networks_stand_on_the_same_tables():
    """They differ beyond first order alone, on shapes of one's own as on the built-in ones."""
    space = identities.Anny()
    code, skin = space.sample(np.random.default_rng(1))
    networks = [Surrogate.load(name) for name in SHIPPED]
    assert {network.weights.kind for network in networks} == {"modal", "hypernetwork"}
    rigs = [network.bind(skin, code, Parameters(soft_volume=1.2, gravity=2.0)) for network in networks]
    np.testing.assert_allclose(rigs[0].neutral, rigs[1].neutral, atol=1e-4)
    weights = np.zeros(52)
    weights[[17, 26]] = 0.8
    own = skin.vertices + 1.1 * (rigs[0].blend(weights) - skin.vertices)
    moved = [[rig.frame(weights) - rig.blend(weights), rig.frame(weights, own) - own] for rig in rigs]
    for pair in zip(*moved, strict=True):
        apart = np.linalg.norm(pair[0] - pair[1], axis=1).mean()
        assert 0.0 < apart < 0.2 * np.linalg.norm(pair[0], axis=1).mean()
    assert np.abs(moved[1][0] - moved[1][1]).max() > 1e-4, "gradients act on the S that is given"


def test_a_code_and_a_skin_of_two_people_are_refused():
    space, rng, network = identities.Anny(), np.random.default_rng(1), Surrogate.load()
    (code, skin), (other, _) = space.sample(rng), space.sample(rng)
    far = skin.with_vertices(skin.vertices + 500.0)
    weights = np.full(52, 0.1)
    near = [network.bind(one, code).frame(weights) - one.vertices for one in (skin, far)]
    np.testing.assert_allclose(*near, atol=1e-3)
    network.bind(skin, nearest_code(space, skin))
    with pytest.raises(InputError, match="code: its skin is .* mm from the skin given, expected at most"):
        network.bind(skin, other)


def test_dynamics_need_the_looseness_that_weights_keep(weights, surrogate, tmp_path):
    known = Looseness.from_people(OfSpace(SPACE, SPACE.mean, SPACE.fit), count=8)
    path = tmp_path / "modal.safetensors"
    replace(weights, looseness=known).save(path)
    rig = bound(Surrogate.load(path), parameters=Parameters(frequency=3.0))
    assert rig.swing.loose == pytest.approx(np.ones(N), abs=1e-3) and (rig.swing.frequency == 3.0).all()
    moving = rig.dynamic()
    moving.frame(np.zeros(52))
    assert 0.0 < np.abs(moving.frame(np.full(52, 0.1)) - rig.frame(np.full(52, 0.1))).max()


def test_a_mirrored_face_is_what_the_simulator_makes_of_the_mirrored_parameters():
    people = people_from_text("anny", level=1)
    space, features = people.space, Features(people.mean)
    person = Person(np.zeros(space.code_size), people.mean, space.expressions)
    parameters = next(
        p for p in (draw(np.random.default_rng(seed), "single", field=False) for seed in range(99))
        if "paralysis_left" in p.names
    )  # fmt: skip
    order = np.arange(len(NAMES))
    left, right = NAMES.index("paralysis_left"), NAMES.index("paralysis_right")
    order[[left, right]] = right, left
    swapped = ParameterSet(parameters.kind, parameters.varied[order], parameters.coefficients[order])
    head = people.head(person)
    kept = {}
    for side, one in enumerate((parameters, swapped)):
        face = make_face(people, person, head, one)
        kept[side] = KeptFace(
            0, person, one, face.settled().displacement, face.carried, Derivatives(face.offset, face.responses)
        )
    mirrored, simulated = LessonFace(kept[0], features, True), LessonFace(kept[1], features)
    np.testing.assert_allclose(mirrored.parameters, simulated.parameters, atol=1e-6)
    size = np.linalg.norm(simulated.responses, axis=2).mean()
    unlike = np.linalg.norm(kept[0].responses - kept[1].responses, axis=2).mean()
    assert np.linalg.norm(mirrored.responses - simulated.responses, axis=2).mean() < 0.02 * size < 0.1 * unlike
    w = np.linspace(0.0, 0.5, 52, dtype=np.float32)[None]
    frame = Frames(w, (kept[0].responses * w[0, :, None, None]).sum(axis=0)[None].astype(np.float32))
    assert (
        np.abs(mirrored.as_mirrored(frame).remainder(mirrored.offset, mirrored.responses) + mirrored.offset).max()
        < 1e-4
    )
