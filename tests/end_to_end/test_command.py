"""The command does what it says: exit status, results on stdout, files that the next command accepts."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softdeca.benchmarks.studies import load_study
from softdeca.lhm.head.file import load_head, save_head


@pytest.mark.parametrize(
    "words", [(), ("study",), ("animate",), ("head", "fit"), ("head", "check"), ("bench", "verification")]
)
def test_help_says_what_there_is(command, words):
    ended = command(*words, "--help")
    assert ended.status == 0 and ended.errors == []
    assert ended.out.startswith(f"Usage: {' '.join(('softdeca', *words))} ")


def test_a_head_that_is_fitted_is_accepted(command, tmp_path):
    file = tmp_path / "head.npz"
    fitted = command("head", "fit", "--seed", 3, "--level", 1, "--out", file, "--json")
    checked = command("head", "check", file, "--json")
    assert fitted.status == checked.status == 0 and fitted.errors == checked.errors == []
    said = json.loads(fitted.out)
    assert {Path(file).name for file in said.pop("files")} == {path.name for path in tmp_path.iterdir()}
    assert json.loads(checked.out) == said
    assert json.loads(checked.out)["problems"] == [] and json.loads(checked.out)["tets"] == 14520


def test_an_own_skin_in_metres_gives_the_head_in_millimetres(command, tmp_path):
    whole = command("head", "fit", "--level", 1, "--out", tmp_path / "head.npz")
    skin = load_head(tmp_path / "head.npz").skin
    np.savez(tmp_path / "skin.npz", vertices=skin.vertices / 1000, triangles=skin.triangles)
    words = ("--skin", tmp_path / "skin.npz", "--unit", "m", "--level", 1, "--out", tmp_path / "own.npz")
    ended = command("head", "fit", *words)
    assert whole.status == ended.status == 0
    own = load_head(tmp_path / "own.npz")
    np.testing.assert_allclose(own.vertices, load_head(tmp_path / "head.npz").vertices, atol=1e-6)


def test_a_head_that_misses_a_gate_is_not_accepted(command, tmp_path, sphere_head):
    wrap = sphere_head.skin_wrap
    muscle, skull = (wrap.with_vertices(wrap.vertices * factor) for factor in (0.9995, 0.999))
    save_head(tmp_path / "thin.npz", replace(sphere_head, muscle_wrap=muscle, skull_wrap=skull))
    ended = command("head", "check", tmp_path / "thin.npz")
    assert ended.status == 1 and len(ended.errors) == 1
    assert "least thickness: 0.1 mm (at least 0.2 mm)" in ended.errors[0]


def test_a_wrap_that_lies_off_the_skin_says_what_to_do(command, tmp_path, sphere_head):
    skin = sphere_head.skin
    save_head(tmp_path / "off.npz", replace(sphere_head, skin=skin.with_vertices(1.02 * skin.vertices)))
    ended = command("head", "check", tmp_path / "off.npz")
    assert ended.status == 1 and len(ended.errors) == 1
    for words in ("wrap to skin mean: 1.9", "rougher than a wrap can follow", "--landmarks", "`head show`"):
        assert words in ended.errors[0]


def test_a_coarse_head_keeps_its_own_gates_and_is_said_to_be_written(command, tmp_path):
    ended = command("head", "fit", "--level", 1, "--out", tmp_path / "head.npz")
    assert ended.status == 0 and ended.errors == [] and "MISSED" not in ended.out
    said = {line.removeprefix("wrote ") for line in ended.out.splitlines() if line.startswith("wrote ")}
    assert said == {str(path) for path in tmp_path.rglob("*") if path.is_file()}
    assert "share below 5 degrees" in ended.out and "(below 0.05)" in ended.out


def test_a_head_that_misses_a_gate_is_said_to_be_written(command, tmp_path, monkeypatch, sphere_head):
    wrap = sphere_head.skin_wrap
    muscle, skull = (wrap.with_vertices(wrap.vertices * factor) for factor in (0.9995, 0.999))
    thin = replace(sphere_head, muscle_wrap=muscle, skull_wrap=skull)
    monkeypatch.setattr("softdeca.cli.head.load_template", lambda space, **_: None)
    monkeypatch.setattr("softdeca.cli.head.fit_head", lambda *_, **__: thin)
    ended = command("head", "fit", "--out", tmp_path / "thin.npz")
    assert ended.status == 1 and f"wrote {tmp_path / 'thin.npz'}" in ended.out
    assert ended.errors[0].startswith(f"softdeca: error: {tmp_path / 'thin.npz'} is written, but misses ")


def test_the_version_is_that_of_the_package(command):
    from importlib.metadata import version

    assert command("--version").out == f"softdeca {version('softdeca')}\n"
    module = subprocess.run([sys.executable, "-m", "softdeca.cli", "--version"], capture_output=True, text=True)
    assert (module.stdout, module.stderr) == (f"softdeca {version('softdeca')}\n", "")


def test_the_list_of_studies_has_whole_questions(command):
    """Click's own summary ends at the first full stop, as that of "Eq." """
    words = " ".join(command("bench", "--help").out.split())
    assert load_study("work-precision").question in words
    words = " ".join(command("bench", "list").out.split())
    assert load_study("contact").question in words and load_study("agreement").question in words
