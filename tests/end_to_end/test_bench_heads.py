"""The study of random identities: repeated, killed and gone on with, and with failures in its list."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from softdeca.benchmarks.harness import Row, run
from softdeca.benchmarks.studies.heads import fit as study
from softdeca.benchmarks.studies.heads.fit import FITTED, Heads, sample, try_fit
from softdeca.lhm import FitError, InputError, check_head, fit_head, identities, load_template

COMMAND = (sys.executable, "-c", "from softdeca.cli import main; main()", "bench", "heads", "--level", "1")


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Two heads, of which one is drawn: the folder and its results."""
    out = tmp_path_factory.mktemp("heads")
    return out, run(Heads(count=2, gallery=1, level=1), out, workers=1)


def test_each_head_is_that_of_its_seed(two):
    _, results = two
    space = identities.Anny()
    _, skin = space.sample(np.random.default_rng(1))
    report = check_head(fit_head(load_template(space, level=1), skin))
    assert results.passed and results.rows[1].case == "seed 1"
    assert results.rows[1].values["figures"]["smallest_dihedral"] == report.smallest_dihedral
    found = {figure.name: [value for value, _ in values] for figure, values in study.collect_figures(results.rows[:2])}
    assert report.lip_path in found["lip_path"] and len(set(found["lip_path"])) == 2 and min(found["fit_s"]) > 0


def test_the_gallery_shows_a_head_as_it_moves(two):
    out, results = two
    shown = results.rows[2].values["shown"]
    assert results.rows[2].case == "seed 0" and shown["gates missed at rest"] == "none"
    assert shown["crossings of the wraps"] == shown["openings of the skin"] == 0
    assert 0 <= shown["skin torn by jawOpen [mm²]"] < 900
    # A jaw opens by centimetres, lids close by one.
    assert 20 < shown["jawOpen: farthest motion [mm]"] < 60 and 4 < shown["blink: farthest motion [mm]"] < 25
    text = (out / "index.html").read_text()
    assert text.count('<div class="panels">') == 2 and text.count("src=") == text.count('src="data:')
    assert "<svg" in text and "at least 2 °" in text and "missed by" in text
    # Of a head from a file it also says what was found and changed there.
    own = replace(results.rows[2], values=results.rows[2].values | {"notes": ["unit: taken for cm"]})
    assert ("seed 0", "found in its file", "unit: taken for cm") in Heads().tables([own])[-1].rows


def test_scaled_samples_reach_further():
    space = identities.Anny()
    mean = space.mean.vertices
    default, far = (sample(space, 0, sigma).vertices - mean for sigma in (2.5, 4.0))
    np.testing.assert_allclose(far, 1.6 * default, atol=1e-9)


@pytest.mark.parametrize("bad", [{"count": 0}, {"gallery": -1}, {"seed": -1}, {"sigma": float("nan")}, {"sigma": 11.0}])
def test_options_outside_their_range_are_refused(bad):
    with pytest.raises(InputError, match=next(iter(bad))):
        Heads(**bad).tasks()


def test_what_cannot_be_fitted_has_a_reason(monkeypatch):
    def flat(template, skin):
        raise FitError("layers: 3 tets are flat")

    monkeypatch.setattr(study, "fit_head", flat)
    assert try_fit(None, None)["error"] == "layers: 3 tets are flat"
    monkeypatch.setattr(study, "fit_head", lambda template, skin: 1 / 0)
    assert try_fit(None, None)["error"] == "ZeroDivisionError: division by zero"


def test_one_failure_in_a_thousand_passes_and_two_do_not(two):
    good = two[1].rows[0]
    failed = Row("seed 7", FITTED, "done", "", {"error": "x: y", "problems": []}, 1.0, None, 0.0, "")
    missed = Row("seed 8", FITTED, "done", "", good.values | {"problems": ["smallest dihedral"]}, 1.0, None, 0.0, "")
    for bad, passed in (([failed], True), ([missed], True), ([failed, missed], False)):
        rows = [good] * (1000 - len(bad)) + bad
        (gate,) = Heads().gates(rows)
        assert gate["passed"] is passed and gate["value"] == len(bad)
        assert len(Heads().tables(rows)[0].rows) == len(bad)
    assert Heads().words([failed]) == "0 of 1 random identities have a layered head."
    assert Heads().pictures([failed]) == {}


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_study_goes_on_and_leaves_no_worker(how, tmp_path):
    arguments = [*COMMAND, "--count", "400", "--gallery", "0", "--workers", "2", "--out", str(tmp_path)]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        for line in process.stderr:
            if line.startswith("heads: seed"):
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
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert 1 <= len(rows) < 400 and not (tmp_path / "results.json").exists()
    again = run(Heads(count=400, gallery=0, level=1), tmp_path, match=rows[0]["case"], workers=1)
    kept = next(row for row in again.rows if row.case == rows[0]["case"])
    assert kept.values == rows[0]["values"] and kept.seconds == rows[0]["seconds"]


def _alive(group):
    """Whether a process of the group is left that is not a zombie."""
    found = subprocess.run(["ps", "-eo", "pgid=,stat="], capture_output=True, text=True, check=True).stdout
    return any(line.split()[0] == str(group) and line.split()[1][0] != "Z" for line in found.splitlines())
