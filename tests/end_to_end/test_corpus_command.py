"""softdeca corpus on coarse default heads: planned, made, looked at, damaged and gone on with."""

import json
import shutil

import pytest

PLAN = """
preset = "tiny"
identities = 2
frames = 1
sequences = 0
[sources]
conversation = 0.5
random = 0.5
"""


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("corpora")
    (folder / "plan.toml").write_text(PLAN)
    return folder


def test_a_corpus_from_plan_to_picture(planned, command):
    plan, out = planned / "plan.toml", planned / "made"
    ended = command("corpus", "generate", plan, "--level", 1, "--out", out, "--dry-run", "--json")
    predicted = json.loads(ended.out)
    assert ended.status == 0 and predicted["statics"] == 2 and predicted["core_hours"] > 0
    assert not out.exists()
    ended = command("corpus", "generate", plan, "--level", 1, "--out", out)
    assert ended.errors == [] and "2 of 2 people" in ended.out and "statics: 2 accepted of 2" in ended.out
    assert ended.status == 0
    assert json.loads((out / "figures.json").read_text())["machine"]["versions"]
    size = sum(path.stat().st_size for path in out.glob("person-*.h5"))
    assert size == pytest.approx(predicted["bytes"], rel=0.3)
    assert command("corpus", "status", out, "--json").status == 0
    assert command("corpus", "sample", out, "--count", 2).status == 0
    assert (out / "sample.png").read_bytes()[:4] == b"\x89PNG"
    ended = command("corpus", "generate", plan, "--level", 1, "--out", out, "--dry-run")
    assert ended.status == 0 and "2 static frames" in ended.out and "recordings in test" in ended.out
    for other, said in ((("--preset", "tiny"), "of another plan (identities 2, expected 3; "),
                        (("--level", 2), "of another level (1, expected 2)")):  # fmt: skip
        ended = command("corpus", "generate", *other, "--out", out)
        assert ended.status == 1 and f"{out}: holds a corpus " in ended.errors[0] and said in ended.errors[0]
    with open(out / "person-00001.h5", "r+b") as file:
        file.truncate(1000)
    ended = command("corpus", "verify", out)
    assert ended.status == 1 and "person-00001.h5: truncated or damaged" in ended.errors[0]
    ended = command("corpus", "status", out)
    assert ended.status == 1 and "DAMAGED shard" in ended.out
    ended = command("corpus", "generate", "--out", out)
    assert ended.status == 0
    verified = command("corpus", "verify", out)
    assert verified.out == f"{out}: 2 shards are whole; 2 frames come out the same when simulated again\n"
    # A study's own corpus lies in its folder, and is found there.
    study = planned / "study"
    shutil.copytree(out, study / "surrogate" / "corpus-0-1")
    assert command("corpus", "status", study).status == command("corpus", "verify", study).status == 0
    assert command("corpus", "sample", study, "--count", 1).out.startswith(str(study / "surrogate" / "corpus-0-1"))
    shutil.copytree(out, study / "surrogate" / "corpus-0-2")
    ended = command("corpus", "status", study)
    assert ended.status == 1 and "a study with 2 corpora" in ended.errors[0]
