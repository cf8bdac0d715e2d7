"""The campaign over random identities: resumed, repeated, interrupted, and with failures in its list."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from softdeca.benchmarks import heads as campaign
from softdeca.benchmarks.heads import HeadsConfig, run_heads, sample
from softdeca.benchmarks.heads_gallery import Shown
from softdeca.benchmarks.heads_report import page, summary
from softdeca.lhm import FitError, InputError, check_head, fit_head, identities, load_template
from softdeca.lhm.progress import silent

COMMAND = (sys.executable, "-c", "from softdeca.cli import main; main()", "bench", "heads", "--level", "1")


def figures(results):
    """What must not depend on workers, order or interruption: all but times."""
    return [{key: row[key] for key in ("seed", "error", "problems", "figures")} for row in results["heads"]]


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """Three heads by one worker: the folder and its results."""
    out = tmp_path_factory.mktemp("heads")
    return out, run_heads(HeadsConfig(count=3, out=out, gallery=1, level=1), silent)


def test_each_head_is_that_of_its_seed(three):
    _, results = three
    space = identities.Anny()
    _, skin = space.sample(np.random.default_rng(2))
    report = check_head(fit_head(load_template(space, level=1), skin))
    assert results["heads"][2]["seed"] == 2
    assert results["heads"][2]["figures"]["smallest_dihedral"] == report.smallest_dihedral
    low, high = (results["distributions"]["lip_path"][key] for key in ("min", "max"))
    assert low <= report.lip_path <= high and low < high
    assert results["distributions"]["fit_seconds"]["min"] > 0


def test_the_gallery_shows_a_head_as_it_moves(three):
    out, results = three
    (row,) = results["gallery"]
    assert row["head"] == "seed 0" and row["gates missed at rest"] == "none" and row["crossings of the wraps"] == 0
    assert row["openings of the skin"] == 0 and 0 <= row["skin torn by jawOpen [mm²]"] < 900
    # A jaw opens by centimetres, lids close by one.
    assert 20 < row["jawOpen: farthest motion [mm]"] < 60 and 4 < row["blink: farthest motion [mm]"] < 25
    assert (out / "index.html").read_text().count("data:image/png") >= 2
    # Of a head from a file it also says what was found and changed there.
    assert "unit: taken for cm" in page(results, [Shown("own.npz", {}, b"", b"", ("unit: taken for cm",))])


def test_scaled_samples_reach_further(three):
    space = identities.Anny()
    mean = space.mean.vertices
    default, far = (sample(space, 0, sigma).vertices - mean for sigma in (2.5, 4.0))
    np.testing.assert_allclose(far, 1.6 * default, atol=1e-9)


def test_page_stands_alone_and_shows_what_was_measured(three):
    out, results = three
    text = (out / "index.html").read_text()
    assert json.loads((out / "results.json").read_text()) == results
    assert text.count("<svg") == 1 and "<link" not in text and "http-equiv" not in text
    assert text.count("src=") == text.count('src="data:')
    for name in ("smallest dihedral", "share below 5 degrees", "wrap to skin max", "fit seconds"):
        assert name in text
    assert "at least 2 °" in text and "missed by" in text


def test_two_workers_resume_a_torn_file_to_the_same_result(three, tmp_path):
    whole, results = three
    for name in ("campaign.json", "heads.jsonl"):
        (tmp_path / name).write_bytes((whole / name).read_bytes())
    rows = tmp_path / "heads.jsonl"
    first = rows.read_bytes().splitlines(keepends=True)[0]
    rows.write_bytes(first + b'{"seed": 1, "err')
    said = []
    again = run_heads(HeadsConfig(count=3, workers=2, out=tmp_path, level=1), lambda what, fraction: said.append(what))
    assert figures(again) == figures(results)
    assert again["heads"][0] == results["heads"][0], "what was done is kept, times included"
    lines = [json.loads(line) for line in rows.read_text().splitlines()]
    assert sorted(line["seed"] for line in lines) == [0, 1, 2]
    assert said[-1].startswith("heads: 3 of 3, 0 failed, ")


def test_workers_end_without_a_word(tmp_path):
    arguments = [*COMMAND, "--count", "2", "--workers", "2", "--gallery", "0", "--out", str(tmp_path)]
    ended = subprocess.run(arguments, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0 and all(line.endswith(" s)") for line in ended.stderr.splitlines() if line)


def test_another_campaign_in_the_folder_is_refused(three):
    out, _ = three
    with pytest.raises(InputError, match="another sigma .2.5, expected 4"):
        run_heads(HeadsConfig(count=3, sigma=4.0, out=out, level=1), silent)
    for bad in ({"count": 0}, {"workers": 0}, {"seed": -1}, {"sigma": float("nan")}, {"sigma": 11.0}):
        with pytest.raises(InputError, match=next(iter(bad))):
            HeadsConfig(out=out, **bad)


def test_failures_are_listed_with_seed_and_reason_and_fail_the_command(tmp_path, monkeypatch, command):
    def failing(template, skin, fitted=[]):  # noqa: B006  counts its calls: the first warms the worker
        fitted.append(skin)
        if len(fitted) == 2:
            raise FitError("layers: 3 tets are flat")
        if len(fitted) == 3:
            raise ZeroDivisionError("a defect of ours")
        return fit_head(template, skin)

    monkeypatch.setattr(campaign, "fit_head", failing)
    ended = command("bench", "heads", "--count", 3, "--seed", 7, "--workers", 1, "--level", 1, "--out", tmp_path)
    assert ended.status == 1 and ended.errors == []
    lines = ended.out.splitlines()
    assert lines[:2] == ["FAILED seed 7: layers: 3 tets are flat", "FAILED seed 8: ZeroDivisionError: a defect of ours"]
    assert any(line.startswith("MISS heads of 3") and ": 2 (at most 0.003)" in line for line in lines)
    results = json.loads((tmp_path / "results.json").read_text())
    assert [f["seed"] for f in results["failures"]] == [7, 8] and results["fitted"] == 1
    assert "a defect of ours" in (tmp_path / "index.html").read_text()


def test_one_failure_in_a_thousand_passes_and_two_do_not(three):
    _, results = three
    good, failed = results["heads"][0], results["heads"][0] | {"error": "x", "figures": None}
    missed = good | {"problems": ["smallest dihedral: 1 ° (at least 2 °)"]}
    for bad, passed in (([failed], True), ([missed], True), ([failed, missed], False)):
        found = summary([good] * (1000 - len(bad)) + bad)
        assert found["gates"][0]["passed"] is passed and found["gates"][0]["value"] == len(bad)
    nothing = results | summary([failed])
    assert nothing["distributions"] == {} and "could not be fitted" in page(nothing)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_campaign_goes_on_and_leaves_no_worker(how, tmp_path):
    arguments = [*COMMAND, "--count", "400", "--workers", "2", "--out", str(tmp_path)]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        for line in process.stderr:
            if line.startswith("heads: 1 of 400"):
                break
        if how == signal.SIGINT:
            os.killpg(process.pid, how)
        else:
            process.kill()
        rest = process.stderr.read()
        process.wait(60)
    assert process.returncode == (130 if how == signal.SIGINT else -signal.SIGKILL)
    if how == signal.SIGINT:
        said = [line for line in rest.splitlines() if line and not line.endswith(" s)")]
        assert said == ["softdeca: interrupted; what was finished is kept and used by the next run"]
    for _ in range(100):
        if not _alive(process.pid):
            break
        time.sleep(0.1)
    assert not _alive(process.pid), "a worker outlived its parent"
    rows = [json.loads(line) for line in (tmp_path / "heads.jsonl").read_text().splitlines()]
    assert 1 <= len(rows) < 400 and not (tmp_path / "results.json").exists()
    seed = min(row["seed"] for row in rows)
    again = run_heads(HeadsConfig(count=1, seed=seed, out=tmp_path, level=1), silent)
    assert again["heads"] == [row for row in rows if row["seed"] == seed]


def _alive(group):
    """Whether a process of the group is left that is not a zombie."""
    found = subprocess.run(["ps", "-eo", "pgid=,stat="], capture_output=True, text=True, check=True).stdout
    return any(line.split()[0] == str(group) and line.split()[1][0] != "Z" for line in found.splitlines())
