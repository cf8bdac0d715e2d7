"""Bad input ends in one line that names the thing, an exit status that is not 0, and no file left half-written."""

import fcntl
import os
import re
import resource
import shlex
import socket
import zipfile

import numpy as np
import pytest
from scipy.sparse import identity

from softdeca.lhm import InputError, SoftdecaError, Surface, expressions, fit_head, load_template
from softdeca.lhm.base.files.atomic import check_place, replaced, write_whole
from softdeca.lhm.base.files.resumable import RowStore, lock_folder
from softdeca.lhm.head.file import load_head, save_head
from softdeca.lhm.template.fit import is_upright
from softdeca.reference import Face, Parameters, Scene, facial_scene, terms
from softdeca.surrogate.corpus.plan import PRESETS

from ..refusals import refused

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, sphere_head):
    """What wrong words speak of: a head, a file that is none, a plan, parameters that no network knows, no takes."""
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
    ("--fast", "--fast"),
    ("head", "Missing command"),
    ("study --expressions jawOpeen", "unknown ARKit expression 'jawOpeen'; did you mean jawOpen"),
    ("study --expressions jawOpen*2", "the weight of jawOpen is 2, outside [0, 1]"),
    ("study --expressions jawOpen+jawOpen", "jawOpen appears twice"),
    ("study --expressions jawOpen*nan", "outside [0, 1]"),
    ("study --expressions ''", "a name is missing"),
    ("study --identities deca", "'deca'"),
    ("head fit --identities ict:nowhere.npz", "nowhere.npz: no such file"),
    ("head fit --skin skin.npz --unit mile", "unit 'mile'"),
    ("head fit --seed 1 --skin a.obj", "--skin and --seed"),
    ("head fit --unit inch", "--unit is of --skin, which is not given"),
    ("head fit --template t.npz --level 1", "--template has a level"),
    ("head fit --template other.npz", "not a template"),
    ("head fit --out head.obj", "head.obj: expected a file that ends in .npz"),
    ("head train-regressor empty --prior 8", "give one"),
    ("head train-regressor nowhere", "no such folder"),
    ("head show head.npz --expression jawOpn", "did you mean jawOpen"),
    ("head show head.npz --expression jawOpen", "not the triangles of 'anny'"),
    ("head mesh head.npz --layers 2", "layers '2': expected two counts"),
    ("head mesh head.npz --layers \u0661,1", "layers '\u0661,1': expected two counts"),
    ("head mesh head.npz --layers 0,1", "from 1 to 32"),
    ("head mesh head.npz --size 0", "size: expected 0.2 to 1000 mm"),
    ("head mesh head.npz --layers 2,2 --size 3", "leave out --layers"),
    ("head mesh head.npz --out head.obj", "expected one of .msh"),
    ("bench verification --solver abaqus", "unknown solver 'abaqus'"),
    ("bench agreement --case slimming", "case 'slimming': none of jawOpen"),
    ("bench depth --skin head.npz", "Missing option '--skull'"),
    ("bench depth --skin none.ply --skull head.npz", "none.ply: no such file"),
    ("animate conversation:1 --head head.npz --level 1", "--level is of a head yet to be fitted"),
    ("animate conversation:1 --targets 4 --dynamic", "--targets are of static frames"),
    ("animate conversation:1 --surrogate none.safetensors", "none.safetensors: no such file"),
    ("animate conversation:1 --parameters p.toml --accuracy none", "is beyond"),
    ("animate conversation:1 --accuracy loose", "expected a length from 1e-6 to 100 mm, 'tight' or 'none'"),
    ("animate conversation:1 --accuracy none --crossing", "knows no contact"),
    *((f"animate {words}", message) for words, message in [
        ("missing.csv", "missing.csv: no such file"),
        ("/dev/zero", "expected"),
        (SPEECH, "expected"),
        ("conversation:-1", "expected conversation[:SECONDS[:SEED]]"),
        ("conversation:1e9", "expected conversation[:SECONDS[:SEED]]"),
        ("conversation:1 --fps 1e12", "rate: 1e+12 Hz, expected a number above 0, 10,000 at most"),
        ("conversation:1 --frames 70:80", "frames '70:80': none of the take's 60"),
        ("conversation:1 --frames 3", "frames '3': expected A:B"),
        ("conversation:1 --head a.npz --level 1", "not of --head"),
    ]),
    ("corpus status nowhere", "nowhere: no corpus.json"),
    ("corpus sample made --out sheet.pdf", "expected a file that ends in .png"),
    ("corpus generate plan.toml --preset tiny", "both say which plan"),
    ("corpus generate --preset huge", "there are " + ", ".join(PRESETS)),
    ("corpus generate --takes empty --dry-run", "no take in it"),
    ("corpus generate --identities external:anny", "has the default's triangles"),
    ("corpus generate --identities external:", "expected 'external:' and a space"),
    ("corpus generate --scheduler nowhere", "'nowhere': expected an address, as tcp://host:8786"),
    ("train nowhere", "no corpus"),
    # Options that nothing would read.
    ("head fit --no-repair", "--no-repair is of --skin, which is not given"),
    ("head fit --find-landmarks l.json --out own.npz", "leave out --out"),
    ("head mesh head.npz --size 3 --layers 1,1", "leave out --layers"),
    ("head train-regressor --unit mm", "--unit is of DIR, which is not given"),
    ("bench material --jaw 0", "No such option '--jaw'"),
    # Counts out of their range.
    ("corpus generate --people 100000", "--people': 100000 is not in the range 2<=x<=99999"),
    (f"train out --steps {'9' * 40}", "1<=x<=100000000"),
    (f"bench heads --seed {'9' * 40}", "0<=x<=9223372036854775807"),
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


@pytest.mark.parametrize("content", ["text", "truncated", "flipped", "other"])
def test_bad_data_of_the_ict_space_are_named(command, tmp_path, content):
    file = tmp_path / "ict.npz"
    np.savez_compressed(file, vertices=np.arange(3000.0).reshape(-1, 3), triangles=np.zeros((5, 3), int))
    whole = file.read_bytes()
    flipped = whole[:200] + bytes(255 - b for b in whole[200:240]) + whole[240:]
    file.write_bytes({"text": b"no zip", "truncated": whole[:100], "flipped": flipped, "other": whole}[content])
    ended = command("head", "fit", "--identities", f"ict:{file}", "--out", tmp_path / "head.npz")
    assert "ict.npz: not ICT-FaceKit's data" in ended.refusal()
    assert [p.name for p in tmp_path.iterdir()] == ["ict.npz"]


def test_an_archive_that_unpacks_to_gigabytes_is_not_unpacked(tmp_path):
    file = tmp_path / "head.npz"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("skin_vertices.npy", bytes(10_000_000))
        archive.filelist[0].file_size = 2_010_000_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused(r"head\.npz: .*2,010,000,000 bytes unpacked; expected at most 2,000,000,000", load_head, file)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000, "kB"


@pytest.mark.parametrize(
    ("turned", "message"),
    [
        (lambda v: v / 1000.0, r"0\.001 times as large"),
        (lambda v: v * 10.0, "10 times as large"),
        (lambda v: v / 25.4, r"0\.0394 times as large"),
        (lambda v: v * [-1.0, 1.0, -1.0], "turned by 180 degrees"),
        (lambda v: v[:, [0, 2, 1]] * [1.0, 1.0, -1.0], "turned by 90 degrees"),
        (lambda v: v * [-1.0, 1.0, 1.0] + 1000.0, "its triangles face inwards: is it mirrored"),
        (lambda v: v * [1.0, 1.0, -1.0], "its triangles face inwards"),
        (lambda v: v[:, [1, 0, 2]], "its triangles face inwards"),
        (lambda v: np.roll(v, 1, axis=0), "its edges are 3.* times as long as .*in the template's order"),
        (lambda v: np.vstack([v[:999][::-1], v[999:]]), "its edges are .* times as long as"),
        (lambda v: v + 1000.0 * (np.arange(len(v)) == 100)[:, None], "an edge at vertex 100 is .* times as long as"),
    ],
)
def test_a_skin_of_another_size_direction_or_order_is_refused(turned, message):
    template = load_template(level=1)
    skin = template.skin.with_vertices(turned(template.skin.vertices))
    refused(f"^skin: {message}", fit_head, template, skin, error=SoftdecaError)
    # The same where the skin is tied to the template by a mapping of its own.
    own = identity(len(skin.vertices), format="csr")
    refused(f"^skin: {message}", fit_head, template, skin, mapping=own, error=SoftdecaError)


def test_a_mapped_skin_that_faces_inwards_is_refused():
    template = load_template(level=1)
    skin = Surface(template.skin.vertices, template.skin.triangles[:, ::-1])
    own = identity(len(skin.vertices), format="csr")
    refused("^skin: its triangles face inwards", fit_head, template, skin, mapping=own, error=SoftdecaError)


def test_a_skin_far_from_the_origin_is_fitted_as_at_the_origin():
    template = load_template(level=1)
    off = np.array([1000.0, -2000.0, 500.0])
    moved = template.skin.with_vertices(template.skin.vertices + off)
    assert is_upright(template.skin, moved)
    there = fit_head(template, template.skin).vertices
    np.testing.assert_allclose(fit_head(template, moved).vertices - off, there, atol=1e-6)


def test_a_head_with_an_array_of_wrong_shape_or_missing_is_refused(tmp_path, sphere_head):
    file = tmp_path / "head.npz"
    save_head(file, sphere_head)
    with np.load(file) as whole:
        arrays = dict(whole)
    for name in arrays:
        lacking = {key: value for key, value in arrays.items() if key != name}
        for wrong in (lacking, arrays | {name: np.arange(7)}):
            np.savez(file, **wrong)
            refused(r"head\.npz: ", load_head, file)


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
@pytest.mark.parametrize("place", ["/dev/null/x.zip", "e" * 300 + ".zip", "/proc/x.zip"])
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


def pipe(file, folder):
    os.mkfifo(file)


def socket_there(file, folder):
    with socket.socket(socket.AF_UNIX) as there:
        there.bind(str(file))


def link(file, folder):
    (folder / "precious").write_text("precious")
    file.symlink_to(folder / "precious")


NO_FILES = {
    "it is a link to .*/precious; give that name": link,
    "it is a link to .*/nowhere; give that name": lambda file, folder: file.symlink_to(folder / "nowhere"),
    "it is a link to /dev/null": lambda file, folder: file.symlink_to("/dev/null"),
    "it is a pipe": pipe,
    "it is a socket": socket_there,
    "Is a directory": lambda file, folder: file.mkdir(),
    "it is read-only": lambda file, folder: file.touch(0o444),
}


@pytest.mark.parametrize("words", NO_FILES)
def test_nothing_is_replaced_but_a_plain_file(tmp_path, command, words):
    file = tmp_path / "out.msh"
    NO_FILES[words](file, tmp_path)
    before = {path.name: path.lstat() for path in tmp_path.iterdir()}
    message = rf"out\.msh: cannot be written \({words}"
    refused(message, check_place, file, folder=False)
    refused(message, write_whole, file, b"new")
    refused(message, RowStore(tmp_path, file=file.name).add, {})
    assert re.search(message, command("head", "mesh", "head.npz", "--out", file).refusal())
    assert {path.name: path.lstat() for path in tmp_path.iterdir()} == before
    assert "precious" not in before or (tmp_path / "precious").read_text() == "precious"


def test_devices_are_not_replaced():
    for device in ("/dev/null", "/dev/full"):
        refused(f"{device}: cannot be written .it is a device", check_place, device, folder=False)
    refused("/dev/stdout: cannot be written .it is a link to ", check_place, "/dev/stdout", folder=False)


def test_a_lock_that_is_a_link_leaves_what_it_leads_to(tmp_path):
    link(tmp_path / ".lock", tmp_path)
    with pytest.raises(InputError, match="lock: cannot be written .it is a link"), lock_folder(tmp_path, "study"):
        pass
    assert (tmp_path / "precious").read_text() == "precious"


def fixed_at(vertex):
    return Scene(CORNERS, [[0, 1, 2, 3]], [terms.Strain(1.0), terms.Fixed([vertex])])


def with_targets(head, move):
    return facial_scene(head, Parameters(), move(head.skin.vertices))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda head: Scene(CORNERS, [[0, 2, 1, 3]], []), "scene: tets: 1 are inverted"),
        (lambda head: fixed_at(4), r"term 1 \(Fixed\): vertex 4 is outside 0..3"),
        (lambda head: fixed_at(-1), r"term 1 \(Fixed\): vertex -1 is outside 0..3"),
        (lambda head: Scene(np.ma.masked_array(CORNERS, False), [[0, 1, 2, 3]], []), "vertices: expected numbers"),
        (lambda head: terms.Strain(np.ma.masked_array([1.0, 2.0])), "stiffness: expected numbers"),
        (lambda head: Parameters(soft_volume=np.ma.masked_array([1.0, 1.1])), "soft_volume: .* masked array"),
        (lambda head: with_targets(head, lambda x: x + 101.0), "targets: .*at most 100 mm"),
        (lambda head: with_targets(head, lambda x: x * 1e9), "targets: 1e.09 times as large as the neutral skin"),
        (lambda head: with_targets(head, lambda x: x / 1000), "targets: 0.001 times as large .* are its units off"),
        (lambda head: with_targets(head, lambda x: x / 25.4), "targets: 0.0394 times as large"),
        (lambda head: with_targets(head, lambda x: x * [-1, 1, 1]), "targets: its likeness .* is it mirrored"),
        (lambda head: with_targets(head, lambda x: x[::-1]), "targets: its likeness"),
        (lambda head: with_targets(head, lambda x: np.ma.masked_less(x, 0.0)), "targets: expected an array of numbers"),
        (lambda head: Face(head).expression_scene(head.skin.vertices / 10), "targets: 0.1 times as large"),
    ],
)
def test_a_bad_scene_is_named_in_one_line(sphere_head, make, message):
    refused(message, make, sphere_head, error=SoftdecaError)
