"""The corpus: content that follows from the plan alone, damage that is named and mended, and what a reader finds."""

import fcntl
import json
from dataclasses import replace
from functools import partial

import h5py
import numpy as np
import pytest

from softdeca.lhm import FitError, InputError, fit_head, load_template
from softdeca.lhm.expressions import conversation_take, weights_of
from softdeca.lhm.identities import Anny
from softdeca.lhm.identities.space import LinearSpace
from softdeca.reference import Face, Parameters, Sequence
from softdeca.reference.face.correction import predict
from softdeca.reference.face.dynamics import extrapolate_turns
from softdeca.reference.face.sequence import Velocities
from softdeca.surrogate.corpus import again
from softdeca.surrogate.corpus.again import count_crossings, simulate_again
from softdeca.surrogate.corpus.card import licence_of, write_card
from softdeca.surrogate.corpus.face import Heads
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.hub import to_datasets
from softdeca.surrogate.corpus.mixture import NAMES, basis
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.plan import LENGTH, PRESETS
from softdeca.surrogate.corpus.reading import LARGE, SMALL, Table
from softdeca.surrogate.corpus.references import FEM_LAWS, references
from softdeca.surrogate.corpus.schedule import Schedule
from softdeca.surrogate.corpus.sequences import simulate_sequence
from softdeca.surrogate.corpus.shard import UnreadableError, read_seconds, seconds_path, write_shard
from softdeca.surrogate.corpus.simulator import make_face, simulate_static, solve_frame
from softdeca.surrogate.corpus.spheres import Spheres

SPACE = Spheres(1)
PEOPLE = OfSpace(SPACE, SPACE.mean, SPACE.fit)
PLAN = replace(PRESETS["tiny"], sources={"conversation": 0.4, "random": 0.3, "hard": 0.3})


def parameters_of(identity):
    """The parameter set of a person's first group."""
    return PLAN.parameter_set(PLAN.parameter_numbers(identity)[0])


def refuse(skin):
    raise FitError("the skin is open")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    corpus = Corpus.from_plan(tmp_path_factory.mktemp("corpus"), PLAN, PEOPLE)
    corpus.generate()
    return corpus


def contents(corpus):
    return [corpus.shard_path(k).read_bytes() for k in range(corpus.plan.identities)]


def test_a_frame_is_what_the_simulator_makes_of_its_expression(made):
    identity, row = 0, 1
    shard = made.shard(identity)
    person = PEOPLE.person(PLAN.rng(0, identity))
    face = make_face(PEOPLE, person, PEOPLE.head(person), parameters_of(identity))
    weights = PLAN.weights(PLAN.static(identity, row)).astype(np.float32)
    np.testing.assert_array_equal(shard.statics.weights[row], weights)
    tight = face.derivatives.prepared.solve(face.scene(weights), tolerance=1e-10)
    assert (
        np.abs((face.skin_after(weights, tight.positions) - face.blend(weights)) - shard.statics.corrected[row]).max()
        < 0.01
    )
    assert shard.statics.residual[row] <= PLAN.tolerance


def test_some_frames_are_simulated_again_to_see_that_they_are_what_is_kept(made, monkeypatch):
    assert simulate_again(made, Heads(lambda: PEOPLE)) == 3
    monkeypatch.setattr(again, "SAME", -1.0)
    with pytest.raises(InputError, match=r"person 0, a frame of face 0: .* accepted, and 0\.0.* mm from what is kept"):
        simulate_again(made, Heads(lambda: PEOPLE))


def test_a_sequence_is_shaken_as_its_take_turns_the_head(made):
    """From what is kept of it, rotations in 24 bits, the sequence can be had again; without them it is another."""
    person = PEOPLE.person(PLAN.rng(0, 0))
    face = make_face(PEOPLE, person, PEOPLE.head(person), parameters_of(0))
    n, take = len(person.skin.vertices), conversation_take(np.random.default_rng(0), 40)
    still = Velocities(np.zeros((1, n, 3), np.float32))
    kept = simulate_sequence(PLAN, face, take, 20, still, np.random.default_rng(0))
    turned = kept.rotations.astype(np.float32)
    assert kept.status == "accepted" and np.ptp(turned, axis=0).max() > 0.01
    off = []
    for bases in (turned, np.tile(np.eye(3), (LENGTH, 1, 1))):
        running = Sequence(face, dynamic=True, tolerance=PLAN.tolerance)
        running.begin(face.blend(kept.weights[0]), base=extrapolate_turns(bases))
        again = [
            (face.skin_after(w, running.frame(face.blend(w), base=base).positions) - face.blend(w))
            for w, base in zip(kept.weights, bases, strict=True)
        ]
        off.append(np.abs(np.array(again) - kept.corrected).max())
    assert off[0] < 0.01 and off[1] > 0.1


def test_frames_with_contact_do_not_cross_and_finite_elements_answer_alike():
    """A lower lip raised under 2 g, on a coarse head: it crosses the upper one without contact."""
    space = Anny()
    people = OfSpace(space, space.mean, partial(fit_head, load_template(level=1)))
    person = people.person(np.random.default_rng(1))
    free = Face(people.head(person), person.shapes, Parameters(gravity=2.0))
    weights = weights_of({"mouthShrugLower": 1.0})
    assert PLAN.contact and replace(PLAN, contact=False).digest != PLAN.digest
    pairs = {}
    for contact in (False, True):
        plan = replace(PLAN, contact=contact, tolerance=2e-5)
        face = free.in_contact() if contact else free
        solution = solve_frame(plan, face, weights)
        pairs[contact] = count_crossings(face.head, solution.positions)
    assert pairs[False] > 0 == pairs[True] and solution.detail["contact_pairs"] > 0
    answer = simulate_static(plan, face, weights)
    assert answer.status == "accepted"
    apart = []
    (answers,) = references(plan, face, [(weights, answer)])
    for reference in answers.values():
        assert reference.status == "accepted", reference.status
        apart.append(np.abs(reference.corrected.astype(float) - answer.corrected).max())
    quadratic, by_law = apart
    assert by_law < 0.05 < quadratic < 0.5, apart


def test_derivatives_are_those_of_the_simulated_frames(made):
    person = PEOPLE.person(PLAN.rng(0, 0))
    face = make_face(PEOPLE, person, PEOPLE.head(person), parameters_of(0))
    step = np.zeros(52)
    step[5] = 1e-2

    def tight(weights):
        near = predict(face, weights)
        # After 40 iterations the difference is within 1e-6 of its limit, which rounding keeps from any tolerance.
        solution = face.derivatives.prepared.solve(face.scene(weights), start=near, tolerance=1e-7, max_iterations=40)
        return face.skin_after(weights, solution.positions) - face.blend(weights)

    difference = (tight(step) - tight(-step)) / 2e-2
    found = made.shard(0).responses.expressions[0, 5].astype(float)
    assert np.abs(found - difference).max() < 3e-3 * np.abs(difference + person.shapes[5]).max()


def test_two_workers_write_the_same_bytes_as_one(made, tmp_path):
    """Seconds differ between runs, and lie in files of their own; every other file is the same to the byte."""
    Corpus.from_plan(tmp_path, PLAN, PEOPLE).generate(on=Schedule("processes", 2))
    names = [f"person-{k:05d}.h5" for k in range(3)] + ["corpus.json", "template.npz", "velocities.npz"]
    for name in names:
        assert (tmp_path / name).read_bytes() == (made.folder / name).read_bytes(), name
    beside = {f"person-{k:05d}.json" for k in range(3)}
    assert {path.name for path in tmp_path.iterdir()} - {".lock"} == {*names, *beside}


def test_seconds_lie_beside_a_shard(made, tmp_path):
    shard, path = made.shard(0), tmp_path / "person-00000.h5"
    write_shard(path, replace(shard, seconds={"fit": 1.5}), made.owner, 0)
    before = path.read_bytes()
    assert read_seconds(path) == {"fit": 1.5}
    write_shard(path, replace(shard, seconds={"fit": 2.5}), made.owner, 0)
    assert path.read_bytes() == before and read_seconds(path) == {"fit": 2.5}
    seconds_path(path).unlink()
    assert read_seconds(path) == {}


def test_deleted_truncated_flipped_and_old_shards_are_named_and_made_anew(made):
    before = contents(made)
    made.shard_path(0).unlink()
    whole = made.shard_path(1).read_bytes()
    made.shard_path(1).write_bytes(whole[: len(whole) // 2])
    with h5py.File(made.shard_path(2), "r+") as file:
        file["statics/corrected"][0, 0, 0] += np.float16(0.5)
    with pytest.raises(InputError, match="person-00000.*missing"):
        Corpus.open(made.folder).verify()
    status = made.status()
    assert status.identities_done == 0 and "truncated" in status.damaged[0] and "checksum" in status.damaged[1]
    with pytest.raises(InputError, match="person-00002.*checksum"):
        made.shard(2)
    seen = []
    made.generate(on_progress=lambda what, fraction: seen.append(what))
    assert "0 of 3 people are there" in seen[0] and contents(made) == before
    left, run = made.folder / ".person-00000-abc.h5", made.folder / "velocities.npz"
    left.write_bytes(b"half")
    whole = run.read_bytes()
    run.write_bytes(whole[: len(whole) // 2])
    with h5py.File(made.shard_path(1), "r+") as file:
        file.attrs["format"] = 0
    with pytest.raises(InputError, match="of format 0, this version reads 5; `softdeca corpus generate` makes"):
        Corpus.open(made.folder).verify()
    Corpus.from_plan(made.folder, PLAN, PEOPLE).generate()
    assert contents(made) == before and run.read_bytes() == whole and not left.exists()
    replace_people = OfSpace(SPACE, SPACE.mean, refuse)
    Corpus.from_plan(made.folder, PLAN, replace_people).generate()  # nothing is left to do
    assert contents(made) == before and made.status().versions == {"0.1.0": 3}


def test_what_fails_is_listed_with_its_reason(tmp_path):
    corpus = Corpus.from_plan(tmp_path, replace(PLAN, sequences=0), OfSpace(SPACE, SPACE.mean, refuse))
    status = corpus.generate()
    assert status.accepted["statics"] == 0 and status.rejected_share == 1.0
    assert {r.table for r in status.rejected} == {"groups", "statics"}
    assert {r.reason for r in status.rejected} == {"head: the skin is open"}


def test_a_solve_that_stops_early_is_kept_out(tmp_path):
    plan = replace(PLAN, max_iterations=1, tolerance=1e-7, sequences=0)
    status = Corpus.from_plan(tmp_path, plan, PEOPLE).generate()
    stopped = [r for r in status.rejected if r.table == "statics"]
    assert stopped and all(r.reason.startswith("solver: iteration limit") for r in stopped)


def test_another_plan_or_template_is_refused(made, tmp_path):
    with pytest.raises(InputError, match="of another plan"):
        Corpus.from_plan(made.folder, replace(PLAN, seed=1), PEOPLE)
    other = Spheres(2)
    with pytest.raises(InputError, match="of another people"):
        Corpus.from_plan(made.folder, PLAN, OfSpace(other, other.mean, other.fit))
    (tmp_path / "corpus.json").write_text(json.dumps([1]))
    with pytest.raises(InputError, match="of format None"):
        Corpus.from_plan(tmp_path, PLAN, PEOPLE)


@pytest.fixture(scope="module")
def referenced(tmp_path_factory):
    """Test people with answers by FEniCSx."""
    pytest.importorskip("dolfinx")
    corpus = Corpus.from_plan(tmp_path_factory.mktemp("referenced"), replace(PLAN, references=1), PEOPLE)
    corpus.generate()
    return corpus


def test_a_reader_finds_the_references_of_test_people(referenced):
    found, shard = Table(referenced.folder, "references", "test"), referenced.shard(2)
    assert set(found.rows[:, 0]) == {2}
    assert "PD" in {found[k]["law"].decode() for k in range(len(found))} <= set(FEM_LAWS)
    for index, (_, number) in enumerate(found.rows):
        for name in (*SMALL["references"], *LARGE["references"]):
            np.testing.assert_array_equal(found[index][name], getattr(shard.references, name)[number])


@pytest.mark.parametrize("table", [table for table in SMALL if table != "references"])
def test_a_reader_finds_what_the_shards_hold(made, table):
    found = Table(made.folder, table, "train")
    assert len(found)
    for index in range(len(found)):
        row = found[index]
        identity, number = found.rows[index]
        held = getattr(made.shard(int(identity)), table)
        for name in (*SMALL[table], *LARGE[table]):
            np.testing.assert_array_equal(row[name], getattr(held, name)[number])
        np.testing.assert_array_equal(row["code"], made.shard(int(identity)).persons.code[0])
    assert set(found.rows[:, 0]) <= {0, 1}
    assert set(Table(made.folder, table, "test").rows[:, 0]) == {2}
    for identity in (0, 1):
        person = PEOPLE.person(PLAN.rng(0, identity))
        np.testing.assert_allclose(found.skin(identity).vertices, person.skin.vertices, atol=1e-4)
        np.testing.assert_allclose(found.shapes(identity), person.shapes, rtol=1e-3, atol=1e-6)


def test_torch_reads_it_in_several_processes(made):
    torch = pytest.importorskip("torch")
    from softdeca.surrogate.corpus.reading import CorpusDataset

    data = CorpusDataset(made.folder, "train")
    loaded = [batch["corrected"] for batch in torch.utils.data.DataLoader(data, batch_size=1, num_workers=2)]
    for index, corrected in enumerate(loaded):
        assert corrected.dtype == torch.float16
        np.testing.assert_array_equal(corrected[0].numpy(), data.table[index]["corrected"])
    with pytest.raises(IndexError):
        data[len(data)]
    assert CorpusDataset(made.folder, "train", table="sequences")[0]["corrected"].shape[0] == LENGTH


def test_hugging_faces_datasets_have_every_parameter_by_its_name(made, monkeypatch, tmp_path):
    datasets = pytest.importorskip("datasets", reason="no datasets: they are of the extra hub")
    monkeypatch.setattr(datasets.config, "HF_DATASETS_CACHE", tmp_path)
    kept = to_datasets(made.folder)
    table = Table(made.folder, "statics", "train")
    assert len(kept["train"]) == len(table) and len(kept["test"])
    row, own, given = kept["train"].with_format("numpy")[1], table[1], table.parameters(1)
    assert row["simulated"] - row["blendshapes"] == pytest.approx(own["corrected"], abs=1e-4)
    assert {name: float(row[name]) for name in NAMES} == pytest.approx({name: given.level(name) for name in NAMES})


def test_a_corpus_of_heads_of_others_has_no_licence_of_ours(made):
    space = Spheres(1)
    other = LinearSpace("others", space.mean, np.zeros((4, 42, 3)), np.zeros((52, 42, 3)), np.zeros(42, dtype=int))
    assert licence_of(PEOPLE) == "cc0-1.0" and licence_of(OfSpace(other, other.mean, SPACE.fit)) == "other"
    write_card(made, licence="other")
    assert "license: other" in (made.folder / "README.md").read_text()
    assert "owners" in (made.folder / "README.md").read_text()


def test_parameters_of_a_head_are_those_of_the_fields(made):
    number = next(k for k in range(50) if not PLAN.parameter_set(k).uniform)
    drawn = PLAN.parameter_set(number)
    head = SPACE.fit(SPACE.mean)
    p = drawn.parameters(head, SPACE.mean)
    assert isinstance(p, Parameters)
    waves = basis(SPACE.mean.vertices)[SPACE.mean.triangles].mean(axis=1)
    on_faces = np.clip(waves @ drawn.coefficients.T.astype(np.float64), -1.0, 1.0)
    for k, name in enumerate(NAMES):
        info, value = Parameters.info(name), getattr(p, name)
        if not drawn.varied[k]:
            assert value == info.default
        # A sphere's wraps have its skin's triangles, so the two agree triangle by triangle.
        there = on_faces[:, k] if np.ndim(value) else on_faces[0, k]
        np.testing.assert_allclose(info.normalise(np.asarray(value)), there, atol=1e-5)


def test_where_nothing_more_is_asked_the_neutral_face_settles(made, tmp_path):
    """The same people and parameters give the same neutral faces, at a share of the price."""
    plan = replace(PLAN, frames=0, sequences=0, responses=0.0)
    corpus = Corpus.from_plan(tmp_path, plan, PEOPLE)
    status = corpus.generate()
    assert status.accepted["groups"] == plan.identities and status.asked["statics"] == 0
    for identity in range(plan.identities):
        np.testing.assert_array_equal(corpus.shard(identity).groups.settled, made.shard(identity).groups.settled)
    table = Table(tmp_path, "groups", "train")
    assert len(table) == 2 and table[1]["settled"].shape == (len(SPACE.mean.vertices), 3)
    np.testing.assert_array_equal(table.face(0).displacement, table[0]["settled"])


@pytest.fixture
def copied(made, tmp_path):
    """A copy of the corpus, to be damaged."""
    for path in made.folder.iterdir():
        if path.is_file():
            (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def test_a_part_of_a_corpus_can_be_read(copied):
    (copied / "person-00000.h5").unlink()
    with pytest.raises(InputError, match="1 of 2 people of the train split .* person-00000.h5 is missing; .*partial"):
        Table(copied, "statics", "train")
    assert set(Table(copied, "statics", "train", partial=True).rows[:, 0]) == {1}
    assert set(Table(copied, "statics", None, partial=True).rows[:, 0]) == {1, 2}
    assert set(Table(copied, "statics", None, partial=True, share=0.5).rows[:, 0]) == {1}


@pytest.fixture(scope="module")
def stranger(tmp_path_factory):
    """A corpus of another plan and of other people."""
    other = Spheres(2)
    plan = replace(PLAN, seed=1, identities=2, groups=1, frames=1, responses=0.0)
    corpus = Corpus.from_plan(tmp_path_factory.mktemp("stranger"), plan, OfSpace(other, other.mean, other.fit))
    corpus.generate()
    return corpus


OTHERS = ("person-00001.h5", "template.npz", "velocities.npz")


@pytest.mark.parametrize("name", OTHERS)
def test_files_of_another_corpus_are_refused_and_stay(copied, stranger, name):
    whole = (stranger.folder / name).read_bytes()
    (copied / name).write_bytes(whole)
    with pytest.raises(InputError, match=f"{name}: of another corpus"):
        Corpus.from_plan(copied, PLAN, PEOPLE)
    assert (copied / name).read_bytes() == whole


def test_shards_without_their_description_wait_for_their_own_plan(copied, stranger, command):
    (copied / "corpus.json").unlink()
    before = {path: path.read_bytes() for path in copied.iterdir() if path.is_file()}
    assert "give the PLAN.toml" in command("corpus", "generate", "--out", copied).refusal()
    with pytest.raises(InputError, match="of another corpus"):
        Corpus.from_plan(copied, stranger.plan, stranger.people)
    assert {path: path.read_bytes() for path in copied.iterdir() if path.is_file()} == before
    assert Corpus.from_plan(copied, PLAN, PEOPLE).generate().identities_done == 3
    assert all(path.read_bytes() == content for path, content in before.items())


def test_a_shard_that_is_locked_is_not_made_anew(copied, command):
    path = copied / "person-00001.h5"
    with path.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(UnreadableError, match="person-00001.h5: cannot be read .*another program has it open"):
            Corpus.from_plan(copied, PLAN, PEOPLE).generate()
        assert "person-00001.h5: cannot be read" in command("corpus", "status", copied).refusal()
    assert Corpus.from_plan(copied, PLAN, PEOPLE).is_whole(1)


@pytest.mark.parametrize("content", [b'{"fit": 1', b"", b'{"fit": -1}'])
def test_damaged_seconds_are_not_known(copied, content):
    (copied / "person-00001.json").write_bytes(content)
    status = Corpus.from_plan(copied, PLAN, PEOPLE).generate()
    assert status.identities_done == 3 and status.damaged == () and status.seconds == {}


def test_swapped_shards_are_of_another_person(copied, command):
    one, other = copied / "person-00000.h5", copied / "person-00001.h5"
    shards = one.read_bytes(), other.read_bytes()
    one.write_bytes(shards[1])
    other.write_bytes(shards[0])
    with pytest.raises(InputError, match="person-00000.h5: of another person, 1, expected 0"):
        Table(copied, "statics", "train")
    for words in (("sample", copied), ("verify", copied)):
        ended = command("corpus", *words)
        assert ended.status == 1 and "person-00000.h5: of another person" in ended.errors[-1]
    ended = command("corpus", "status", copied)
    assert ended.status == 1 and ended.out.count("DAMAGED") == 2


@pytest.mark.parametrize(
    "change",
    [
        lambda a: a | {"vertices": a["vertices"][::-1]},
        lambda a: a | {"triangles": a["triangles"][:, ::-1]},
        lambda a: a | {"vertices": 1.1 * a["vertices"]},
    ],
    ids=["reversed", "flipped", "larger"],
)
def test_another_template_is_named_and_made_anew(copied, command, change):
    path = copied / "template.npz"
    whole = path.read_bytes()
    np.savez_compressed(path, **change(dict(np.load(path))))
    for word in ("verify", "status", "sample"):
        assert "template.npz: damaged, its checksum is another" in command("corpus", word, copied).refusal()
    Corpus.from_plan(copied, PLAN, PEOPLE).generate()
    assert path.read_bytes() == whole and Corpus.open(copied).verify() == 3
