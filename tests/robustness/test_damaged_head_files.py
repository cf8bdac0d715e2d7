"""Head and template files with one thing wrong each: loading and `head check` refuse them in a line that names it."""

import json
import re
import time
from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm import check_head, identities, load_template
from softdeca.lhm.base.errors import InputError
from softdeca.lhm.head.file import load_head, save_head
from softdeca.lhm.template.file import read_template, save_template
from softdeca.lhm.template.fit import fit_head

from ..refusals import refused


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    template = load_template(level=1)
    save_head(folder / "head.npz", fit_head(template, identities.Anny().mean))
    save_template(folder / "template.npz", template)
    return {name: dict(np.load(folder / f"{name}.npz")) for name in ("head", "template")}


def at(name, place, value):
    def edit(arrays):
        array = arrays[name].copy()
        array[place] = value
        return {name: array}

    return edit


def times(*names, by):
    return lambda arrays: {name: arrays[name] * by for name in names}


def other(name, change):
    return lambda arrays: {name: change(arrays[name])}


def rows(tie, part, change):
    """Change the weights or the indices of each row of a tie by itself."""

    def edit(arrays):
        name, ends = f"{tie}_{part}", arrays[f"{tie}_indptr"][1:-1]
        return {name: np.concatenate([change(row) for row in np.split(arrays[name], ends)])}

    return edit


WRAPS = ("skin_wrap", "muscle_wrap", "skull_wrap")
POINTS = ("skin_vertices", *WRAPS, "rig_deltas")
HEADS = {
    "vertex far off": (at("skin_vertices", (7, 0), 1e30), "skin vertices: 1e\\+30 is too large"),
    "vertex 1.7 km off": (at("skin_vertices", (7, 0), 1.7e6), "skin: vertex 7 lies 1.7e\\+06 mm from"),
    "vertex NaN": (at("skin_vertices", (7, 2), np.nan), "skin vertices: .* the first at \\(7, 2\\)"),
    "weight NaN": (at("skin_from_wrap_data", 5, np.nan), "skin_from_wrap_data: 1 values are not finite"),
    "weights a million times": (times("wrap_from_skin_data", by=1e6), "wrap_from_skin_data: .*expected -1e-05..1"),
    "weights in another order": (
        rows("skin_from_wrap", "data", lambda row: np.roll(row, 1)),
        "skin_from_wrap: it ties vertices .* mm farther away than the surface",
    ),
    "weights beyond their triangles": (
        rows("skin_from_wrap", "data", lambda row: np.append([1.9, -0.9], np.zeros(len(row)))[: len(row)]),
        "skin_from_wrap_data: 1.9 at 0; expected -1e-05..1",
    ),
    "column twice": (
        rows("skin_from_wrap", "indices", lambda row: np.full_like(row, row[0])),
        "skin_from_wrap_indices: row 0 names column .* twice",
    ),
    "skin inside out": (other("skin_triangles", lambda a: a[:, ::-1]), "skin: its triangles face inwards"),
    "skin of a head aside": (other("skin_vertices", lambda a: a + 500.0), "skin_wrap: it lies .* mm from the skin"),
    "three times as large": (times(*POINTS, by=3.0), "skin_wrap is 752.* mm across, a head 100 to 600 mm"),
    "column out of range": (at("skin_from_wrap_indices", 5, 10**9), "skin_from_wrap_indices: 1000000000 at 5"),
    "pointer out of range": (at("wrap_from_skin_indptr", 9, 10**9), "wrap_from_skin_indptr: 1000000000 at 9"),
    "corner negative": (at("triangles", (4, 1), -1), "outside 0..1211, the first is number 4"),
    "complex": (other("skin_vertices", lambda a: a + 1j), "skin vertices: expected real numbers, got complex128"),
    "bone out of range": (at("bone", 2, 7), "bone: 7 at 2; expected 0..2"),
    "rig of a huge mesh": (other("rig_vertices", lambda a: np.array(10**13)), "rig_vertices: .*expected 0..20000000"),
    "rig NaN": (at("rig_deltas", (3, 0, 0), np.nan), "rig_deltas: 1 values are not finite"),
    "rig a thousandfold": (times("rig_deltas", by=1000), "rig_deltas: 3.43e\\+04 is too large"),
    "rig in metres": (times("rig_deltas", by=1e-3), "rig_deltas: they move no vertex farther than .*are they in m"),
    "rig of no expression": (
        lambda arrays: {"rig_about": np.array(json.dumps({"source": "", "missing": ["smirk"]}))},
        "rig_about: smirk is none of ARKit's expressions",
    ),
    "notes deep": (lambda arrays: {"notes": np.array("[" * 5000)}, "JSON: .*levels of brackets"),
    "in metres": (times(*POINTS, by=1e-3), "skin_wrap is 0.2508 mm across, .*is it in m\\? Heads are in mm"),
    "in centimetres": (times(*POINTS, by=0.1), "is it in cm\\? Heads are in mm"),
    "inverted": (other("skull_wrap", lambda a: a * 2), "layers tets: .* are inverted"),
    "skull a point": (other("skull_wrap", lambda a: 0 * a + a.mean(axis=0)), "layers tets: .* are inverted"),
    "wrap of equal vertices": (at("skin_wrap", slice(0, 50), 0.0), "layers tets: .* are inverted"),
}  # fmt: skip


@pytest.mark.parametrize("name", HEADS)
def test_a_damaged_head_is_refused_by_loading_and_by_check(tmp_path, whole, command, name):
    edit, words = HEADS[name]
    path = tmp_path / "damaged.npz"
    np.savez(path, **whole["head"] | edit(whole["head"]))
    began = time.process_time()
    assert str(path) in refused(words, load_head, path)
    said = command("head", "check", path)
    assert said.status == 1 and len(said.errors) == 1 and time.process_time() - began < 10


TOLD = {
    "rig negated": (times("rig_deltas", by=np.float32(-1)), "jaw drop: -"),
    "rig of expressions in another order": (
        other("rig_deltas", lambda a: np.random.default_rng(0).permutation(a)),
        "own side: ",
    ),
    "rig mirrored": (times("rig_deltas", by=np.float32([-1, 1, 1])), "sideways: -"),
}


@pytest.mark.parametrize("name", TOLD)
def test_a_head_that_is_odd_is_told_by_check(tmp_path, whole, command, name):
    edit, words = TOLD[name]
    path = tmp_path / "odd.npz"
    np.savez(path, **whole["head"] | edit(whole["head"]))
    problems = check_head(load_head(path)).problems
    assert any(words in problem for problem in problems), problems
    ended = command("head", "check", path)
    assert ended.status == 1 and ended.errors[-1].startswith("softdeca: error")


def test_regions_that_a_face_lacks_are_counted(tmp_path, whole):
    arrays = whole["head"] | {"region_teeth": whole["head"]["region_teeth"] & False}
    np.savez(tmp_path / "whole.npz", **whole["head"])
    del arrays["region_lids"], arrays["region_ears"]
    np.savez(tmp_path / "less.npz", **arrays)
    counts = [check_head(load_head(tmp_path / name)).regions_unknown for name in ("whole.npz", "less.npz")]
    assert counts == [0, 3]


def test_a_head_that_no_command_would_read_is_not_written(tmp_path, sphere_head):
    path = tmp_path / "head.npz"
    for odd, words in (
        (replace(sphere_head, skin_from_wrap=sphere_head.skin_from_wrap[::-1].tocsr()), "skin_from_wrap: it ties"),
        (replace(sphere_head, notes=("x" * 3000,)), "notes: 3,?000 letters"),
    ):
        refused(f"head.npz: not written, since it could not be read: {words}", save_head, path, odd)
        assert not path.exists()


def test_a_scan_in_its_own_triangles_of_an_earlier_version_is_to_be_fitted_again(tmp_path, whole, command):
    path, skin = tmp_path / "scan.npz", whole["head"]["skin_vertices"]
    np.savez(path, **whole["head"], registered_vertices=skin, registered_triangles=whole["head"]["skin_triangles"])
    ended = command("head", "check", path)
    assert ended.status == 1 and "fit the scan again" in ended.refusal() and str(path) in ended.refusal()


def test_a_simulation_of_a_damaged_head_ends_before_it_begins(tmp_path, whole, command):
    """Weights NaN or a million times gave takes of NaN, and points 1.7 km away, with status 0."""
    take = tmp_path / "take.json"
    take.write_text('{"names": ["jawOpen"], "frames": [{"weights": [0.5], "time": 0}, {"weights": [0], "time": 0.1}]}')
    for name in ("weight NaN", "weights a million times", "vertex far off"):
        path, out = tmp_path / "damaged.npz", tmp_path / "out"
        np.savez(path, **whole["head"] | HEADS[name][0](whole["head"]))
        ended = command("animate", take, "--head", path, "--out", out)
        assert ended.status == 1 and f"error: {path}: damaged, " in ended.errors[-1], ended.errors
        assert not out.exists()


def test_a_head_whose_bits_flip_is_refused_or_the_same(tmp_path, sphere_head):
    """Each array has a checksum in the archive, its texts too; its list of arrays has none, and may lose some."""
    path, rng = tmp_path / "head.npz", np.random.default_rng(0)
    save_head(path, replace(sphere_head, notes=("a note",), skull=sphere_head.skull_wrap))
    whole = path.read_bytes()
    flips = [(int(place), int(bit)) for place, bit in rng.integers((0, 0), (len(whole), 8), (200, 2))]
    for entry in re.finditer(rb"PK\x01\x02", whole):  # lengths of what follows an entry's name
        flips += [(entry.start() + place, bit) for place in range(30, 34) for bit in range(8)]
    for place, bit in flips:
        content = bytearray(whole)
        content[place] ^= 1 << bit
        path.write_bytes(content)
        try:
            again = load_head(path)
        except InputError:
            continue
        assert again.notes == ("a note",) and again.skull is not None, (place, bit)
        assert np.array_equal(again.vertices, sphere_head.vertices), (place, bit)


def test_a_name_of_two_lines_is_told_once(tmp_path, command):
    (tmp_path / "a\nb.npz").write_text("no head")
    (line,) = command("head", "check", tmp_path / "a\nb.npz").errors
    assert line.count("a b.npz") == 1 and "not a layered head, or damaged" in line


def test_notes_cannot_steer_the_terminal(tmp_path, whole, command):
    path = tmp_path / "noted.npz"
    about = {"source": "a\x1b[2J\x9b31m\u202e", "missing": []}
    notes = json.dumps(["red \x1b[31m alarm\r", "Köpfe"])
    np.savez(path, **whole["head"] | {"notes": np.array(notes), "rig_about": np.array(json.dumps(about))})
    head = load_head(path)
    assert head.notes == ("red \\x1b[31m alarm\\r", "Köpfe") and head.rig.source == "a\\x1b[2J\\x9b31m\\u202e"
    ended = command("head", "check", path)
    assert ended.status == 0 and "red \\x1b[31m alarm" in ended.out and "Köpfe" in ended.out
    assert all(c.isprintable() or c == "\n" for c in ended.out + "".join(ended.errors))


TEMPLATES = {
    "stack NaN": (at("stack", (7, 0), np.nan), "stack: 1 values are not finite"),
    "stack cut": (other("stack", lambda a: a[:-1]), "stack: expected three wraps"),
    "parts out of range": (at("parts", 3, 9), "parts: 9 at 3; expected 0..3"),
    "room negative": (at("room", 3, -1.0), "room: -1 at 3; expected 0.."),
    "column out of range": (at("wrap_from_skin_indices", 5, 10**9), "wrap_from_skin_indices: 1000000000 at 5"),
    "in metres": (times("stack", "skin_vertices", by=1e-3), "is it in m\\? Heads are in mm"),
    "name of bytes": (lambda arrays: {"name": np.array(b"x")}, "name: expected a text"),
}


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_damaged_template_is_refused(tmp_path, whole, name):
    edit, words = TEMPLATES[name]
    path = tmp_path / "damaged.npz"
    np.savez(path, **whole["template"] | edit(whole["template"]))
    with pytest.raises(InputError, match=words) as raised:
        read_template(path)
    assert str(path) in str(raised.value)


def test_a_damaged_template_in_the_cache_is_made_anew(tmp_path, whole, monkeypatch):
    """Of right arrays with wrong values too: `load_or_make` asks the reader."""
    from softdeca.lhm.base.files.cache import load_or_make
    from softdeca.lhm.template.file import template_from_arrays

    monkeypatch.setenv("SOFTDECA_CACHE", str(tmp_path))
    np.savez(tmp_path / "thing.npz", **whole["template"] | {"parts": whole["template"]["parts"] + 9})
    made = []

    def make():
        made.append(1)
        return whole["template"]

    for _ in range(2):
        assert load_or_make("thing", make, template_from_arrays).parts.max() <= 3
    assert made == [1]
