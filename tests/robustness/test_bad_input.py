"""Bad input ends in one line that names the thing, an exit status that is not 0, and no file left half-written."""

import fcntl
import os
import re
import resource
import shlex
import zipfile

import numpy as np
import pytest

from softdeca.lhm import SoftdecaError, expressions, fit_head, load_template
from softdeca.lhm.base.files.atomic import check_place, replaced, write_whole
from softdeca.lhm.base.files.resumable import add_row
from softdeca.lhm.head.file import load_head, save_head
from softdeca.lhm.template.fit import is_upright

from ..refusals import refused


@pytest.fixture(scope="module")
def folder(tmp_path_factory, sphere_head):
    """Files that wrong words name: a head, a file that is none, a plan, parameters that no network knows, no takes."""
    folder = tmp_path_factory.mktemp("words")
    save_head(folder / "head.npz", sphere_head)
    np.savez(folder / "skin.npz", vertices=sphere_head.skin.vertices, triangles=sphere_head.skin.triangles)
    np.savez(folder / "other.npz", a=1)
    (folder / "plan.toml").write_text('preset = "tiny"\n')
    (folder / "p.toml").write_text("connector_ratio = 20\n")
    (folder / "empty").mkdir()
    return folder


SPEECH = "speech:" + "so " * 70_000
WRONG = [
    ("study --expressions jawOpeen", "unknown ARKit expression 'jawOpeen'; did you mean jawOpen"),
    ("head fit --template t.npz --level 1", "--template has a level"),
    ("head fit --out head.obj", "head.obj: expected a file that ends in .npz"),
    ("head train-regressor empty --prior 8", "give one"),
    ("head show head.npz --expression jawOpn", "did you mean jawOpen"),
    ("head show head.npz --expression jawOpen", "not the triangles of 'anny'"),
    ("bench verification --solver abaqus", "unknown solver 'abaqus'"),
    ("animate conversation:1 --head head.npz --level 1", "--level is of a head yet to be fitted"),
    ("animate conversation:1 --accuracy loose", "expected a length from 1e-6 to 100 mm, or 'none'"),
    ("animate /dev/zero", "expected"),
    (f"animate {SPEECH}", "expected"),
    ("corpus generate plan.toml --preset tiny", "both say which plan"),
    ("train corpus --share nan", "--share': 'nan' is no number"),
    ("animate conversation:1 --surrogate w --bones soft", "--surrogate: nothing reads it"),
    ("animate conversation:1 --surrogate w --dynamic", "--surrogate: nothing reads it"),
    ("animate conversation:1 --surrogate hypernetwork", "--surrogate: nothing reads it without --accuracy none"),
    ("animate conversation:1 --accuracy none --crossing", "--crossing: nothing reads it"),
    ("corpus generate --identities spheres:1 --level 3", "--level: nothing reads it for spheres"),
    ("corpus generate --dry-run --workers 2", "--workers: nothing reads it in a dry run"),
    ("head fit --unit cm", "--unit: nothing reads it without --skin"),
    ("head fit --find-landmarks l.json --seed 1", "--seed: nothing reads it with --find-landmarks"),
    ("head show head.npz --identities anny", "--identities: nothing reads it without --expression"),
    ("head train-regressor --unit m", "--unit: nothing reads it without DIR"),
    ("view --port 8000 --out page.html", "--port: nothing reads it with --out"),
    ("corpus generate --people 100000", "--people': 100000 is not in the range 2<=x<=99999"),
    ("head template --anatomy a.npz --level 4", "--level': 4 is not in the range 1<=x<=3"),
]  # fmt: skip


@pytest.mark.parametrize(("words", "message"), WRONG, ids=[words[:60] for words, _ in WRONG])
def test_wrong_words_are_named_in_one_line_before_anything_is_written(command, folder, monkeypatch, words, message):
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    assert message in command(*shlex.split(words)).refusal()
    assert sorted(folder.rglob("*")) == before


def test_a_factor_scales_and_spaces_do_not_matter():
    weights = expressions.parse_weights(" jawOpen * 0.5 + cheekPuff")
    assert sorted(weights[weights > 0]) == [0.5, 1.0]


def test_an_archive_that_unpacks_to_gigabytes_is_not_unpacked(tmp_path):
    file = tmp_path / "head.npz"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("skin.vertices.npy", bytes(10_000_000))
        archive.filelist[0].file_size = 2_010_000_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused(r"head\.npz: .*2,010,000,000 bytes unpacked; expected at most 2,000,000,000", load_head, file)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000, "kB"


@pytest.mark.parametrize(
    ("turned", "message"),
    [
        (lambda v: v / 1000.0, r"0\.001 times as large"),
        (lambda v: v * [-1.0, 1.0, -1.0], "turned by 180 degrees"),
        (lambda v: np.roll(v, 1, axis=0), "its edges are 3.* times as long as .*in the template's order"),
    ],
)
def test_a_skin_of_another_size_direction_or_order_is_refused(turned, message):
    template = load_template(level=1)
    skin = template.skin.with_vertices(turned(template.skin.vertices))
    refused(f"^skin: {message}", fit_head, template, skin, error=SoftdecaError)


def test_a_skin_far_from_the_origin_is_fitted_as_at_the_origin():
    template = load_template(level=1)
    off = np.array([1000.0, -2000.0, 500.0])
    moved = template.skin.with_vertices(template.skin.vertices + off)
    assert is_upright(template.skin, moved)
    there = fit_head(template, template.skin).vertices
    np.testing.assert_allclose(fit_head(template, moved).vertices - off, there, atol=1e-6)


def test_a_file_in_the_way_of_a_folder_is_named(command, tmp_path, monkeypatch, sphere_head):
    # The fit itself is beside the point here: what is written is a sphere.
    monkeypatch.setattr("softdeca.cli.head.load_template", lambda space, **_: None)
    monkeypatch.setattr("softdeca.cli.head.fit_head", lambda *_, **__: sphere_head)
    (tmp_path / "way").write_text("a file")
    ended = command("head", "fit", "--out", tmp_path / "way" / "x.npz")
    assert str(tmp_path / "way") in ended.refusal()
    assert [p.name for p in tmp_path.iterdir()] == ["way"]  # told before anything is made


@pytest.mark.parametrize(
    "words", [("study", "--out"), ("bench", "heads", "--out"), ("corpus", "generate", "--out"), ("bench", "export")]
)
@pytest.mark.parametrize("place", ["/dev/null/x.zip", "e" * 300 + ".zip", "/dev/full/x.zip"])
def test_a_place_where_nothing_can_be_written_is_refused_before_the_work(command, monkeypatch, words, place):
    for module in ("study", "study_command", "corpus", "bench"):
        monkeypatch.setattr(f"softdeca.cli.{module}.show_progress", None)  # the work would end in a TypeError
    assert "cannot be written" in command(*words, place).refusal()


def test_a_study_in_a_file_is_refused(command, tmp_path):
    (tmp_path / "way").write_text("a file")
    ended = command("study", "--out", tmp_path / "way")
    assert "way" in ended.refusal()
    assert (tmp_path / "way").read_text() == "a file"


def test_a_second_study_in_one_folder_is_refused(command, tmp_path):
    with open(tmp_path / ".lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        ended = command("study", "--out", tmp_path)
    assert "another study runs there" in ended.refusal()
    assert [p.name for p in tmp_path.iterdir()] == [".lock"]


def test_a_file_stays_as_it_was_when_its_writer_fails(tmp_path):
    file = tmp_path / "answer.txt"
    file.write_text("before")
    for error in (RuntimeError, KeyboardInterrupt):
        with pytest.raises(error), replaced(file) as temporary:
            temporary.write_text("half")
            raise error
    assert file.read_text() == "before" and list(tmp_path.iterdir()) == [file]


NO_FILES = {
    "pipe": lambda file: os.mkfifo(file),
    "link to a device": lambda file: file.symlink_to("/dev/null"),
    "folder": lambda file: file.mkdir(),
}


@pytest.mark.parametrize("kind", NO_FILES)
def test_nothing_is_replaced_but_a_plain_file(tmp_path, command, kind):
    file = tmp_path / "out.msh"
    NO_FILES[kind](file)
    before = {path.name: path.lstat() for path in tmp_path.iterdir()}
    message = r"out\.msh: cannot be written \(it is no plain file"
    refused(message, check_place, file, folder=False)
    refused(message, write_whole, file, b"new")
    refused(message, add_row, file, {})
    assert re.search(message, command("head", "mesh", "head.npz", "--out", file).refusal())
    assert {path.name: path.lstat() for path in tmp_path.iterdir()} == before


def test_a_link_to_a_file_is_replaced_and_leaves_what_it_leads_to(tmp_path):
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "out.msh").symlink_to(tmp_path / "precious")
    write_whole(tmp_path / "out.msh", b"new")
    assert (tmp_path / "precious").read_text() == "precious" and (tmp_path / "out.msh").read_bytes() == b"new"


def test_a_private_file_stays_private(tmp_path):
    file = tmp_path / "head.npz"
    file.write_bytes(b"old")
    file.chmod(0o600)
    write_whole(file, b"new")
    assert file.read_bytes() == b"new" and file.stat().st_mode & 0o777 == 0o600
