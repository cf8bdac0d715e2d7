"""softdeca train and evaluate: from a corpus to weights, a curve and scores; small enough here to learn little."""

import json
import shutil

import numpy as np
import pytest

from softdeca.benchmarks.surrogates import READY
from softdeca.lhm.base.provenance import list_missing
from softdeca.surrogate import Surrogate
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.plan import CorpusPlan
from softdeca.surrogate.sphere import Spheres

SPACE = Spheres(1)
OF_THE_CHECKOUT = {"clean tree", "commit"}
"""What a results file may lack here: tests run on changed trees, and without git."""
PLAN = CorpusPlan(
    identities=12, groups=3, frames=6, sequences=0, references=0, parameter_responses=0.0,
    varying=0.0, kinds={"few": 0.5, "both": 0.5}, sources={"random": 1.0}, conversations=0, random=6,
)  # fmt: skip


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    people = OfSpace(SPACE, SPACE.mean, SPACE.fit)
    known = {"identities": "spheres:1", "level": 2}
    made = Corpus(tmp_path_factory.mktemp("corpus"), PLAN, people, known)
    made.generate()
    return made.folder


def test_what_is_simulated_is_learned_from_and_tested_on(command, corpus, tmp_path):
    out, scores = tmp_path / "trained", tmp_path / "scores"
    ended = command("train", corpus, "--out", out, "--steps", "4")
    assert ended.status == 0 and f"wrote {out / 'modal.safetensors'}" in ended.out
    curve = json.loads((out / "curve.json").read_text())
    assert curve[-1]["step"] == 4 and (out / "curve.png").read_bytes().startswith(b"\x89PNG")
    trained = Surrogate.load(out / "modal.safetensors")
    assert trained.weights.note.people <= 11 and np.isfinite(trained.weights.network["modes.0"]).all()
    ended = command("evaluate", corpus, "--surrogate", out / "modal.safetensors", "--rivals", "--out", scores, "--json")
    assert ended.status == 0
    rows = json.loads(ended.out)
    kept = json.loads((scores / "scores.json").read_text())
    assert set(list_missing(kept)) <= OF_THE_CHECKOUT and kept["options"]["corpus"]["plan"] == PLAN.digest
    methods = {row["method"]: row for row in rows if row["kind"] == "all"}
    assert set(READY) < set(methods) and methods["bones carried"]["share"] == pytest.approx(1.0)
    # A bind by simulation has the simulator's seconds in it, and whoever needs a head waits for it.
    linearised, settled = methods["linearised simulator"], methods["settled neutral face + blendshapes"]
    assert linearised["bind_ms"] >= 1e3 * kept["bind_costs"]["derivatives"] > 0.0
    assert settled["bind_ms"] >= 1e3 * kept["bind_costs"]["settled"] > 0.0
    assert [name for name, row in methods.items() if row["head_ms"]] == [*READY][1:5]
    assert len(methods) == 13 and rows == kept["scores"] and kept["breakeven"]["training"] > 0
    assert kept["machine"]["commit"] and kept["machine"]["versions"]["numpy"] and kept["corpus"]["seed"] == PLAN.seed
    told = (scores / "scores.md").read_text()
    assert told.count("\n| ") == len(rows) + 1 and told.startswith("The network loses to a rival without learning on")
    everybody = command("evaluate", corpus, "--surrogate", out / "modal.safetensors", "--people", "all", "--out",
                        tmp_path / "everybody", "--json")  # fmt: skip
    frames = [max(row["frames"] for row in json.loads(run.out)) for run in (ended, everybody)]
    assert everybody.status == 0 and frames[1] > frames[0] > 0
    assert (scores / "cost.png").read_bytes().startswith(b"\x89PNG")
    # The study of the same gives the same figures; so little training beats nothing, which is told.
    study = command(
        "bench", "surrogate", "--corpus", corpus, "--weights", out / "modal.safetensors", "--out", tmp_path / "study",
        "--json",
    )  # fmt: skip
    assert study.status == 1 and study.errors == []
    results = json.loads(study.out)
    found = {(line["method"], line["kind"]): line["mean"] for row in results["rows"] for line in row["values"]["rows"]}
    wanted = {(row["method"], row["kind"]): row["mean"] for row in rows}
    assert found == {key: pytest.approx(wanted[key]) for key in found} and len(results["rows"]) == len(READY)
    assert not results["gates"][-1]["passed"]
    assert "<svg" in (tmp_path / "study" / "index.html").read_text()


def test_errors_over_the_number_of_people_are_told_of_networks_trained_on_shares(command, corpus, tmp_path):
    shares = {"0.92": tmp_path / "few", "1.0": tmp_path / "all"}
    for share, out in shares.items():
        assert command("train", corpus, "--share", share, "--out", out, "--steps", "4").status == 0
    few, every = (out / "modal.safetensors" for out in shares.values())
    given = ("evaluate", corpus, "--surrogate", every, "--out", tmp_path / "scores")
    ended = command(*given, "--curve", every, "--curve", few)
    assert ended.status == 0 and (tmp_path / "scores" / "curve.png").read_bytes().startswith(b"\x89PNG")
    curve = json.loads((tmp_path / "scores" / "scores.json").read_text())["curve"]
    people = [point["people"] for point in curve]
    assert people == sorted(people) and people[0] < people[1] <= 11
    assert all(0.0 < point[name] < 10.0 for point in curve for name in ("unseen", "seen"))
    assert "of seen ones |" in (tmp_path / "scores" / "scores.md").read_text()
    alone = command(*given, "--curve", few)
    assert alone.status != 0 and "different numbers of people" in alone.errors[0]


def test_generalisation_needs_people_that_a_command_knows(command, corpus, tmp_path):
    assert command("train", corpus, "--out", tmp_path, "--steps", "2").status == 0
    given = ("--surrogate", tmp_path / "modal.safetensors", "--generalisation", "1", "--out", tmp_path / "scores")
    nameless = tmp_path / "nameless"
    shutil.copytree(corpus, nameless)
    manifest = json.loads((corpus / "corpus.json").read_text())
    (nameless / "corpus.json").write_text(json.dumps(manifest | {"made_with": {}}))
    ended = command("evaluate", nameless, *given)
    assert ended.status != 0 and len(ended.errors) == 1
    assert "bones carried: a head of each person is needed" in ended.errors[0]
    assert "it was made from Python" in ended.errors[0]


def test_the_paper_s_network_is_trained_by_name(command, corpus, tmp_path):
    ended = command("train", corpus, "--network", "paper", "--out", tmp_path, "--steps", "4")
    assert ended.status == 0 and (tmp_path / "paper.npz").is_file()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("train", "no/such/folder"), "no corpus"),
        (("evaluate", "no/such/folder"), "no corpus"),
        (("train", "CORPUS", "--device", "abacus"), "no device 'abacus'"),
        (("evaluate", "CORPUS", "--surrogate", "no.safetensors"), "no such file"),
        (("evaluate", "CORPUS"), "vertices"),
    ],
    ids=["train", "evaluate", "device", "weights", "template"],
)
def test_what_cannot_be_is_one_line(command, corpus, tmp_path, arguments, said):
    given = [corpus if text == "CORPUS" else text for text in arguments]
    ended = command(*given, "--out", tmp_path / "out")
    assert ended.status != 0 and len(ended.errors) == 1 and said in ended.errors[0]
