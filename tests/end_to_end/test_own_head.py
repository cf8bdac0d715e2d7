"""A head of one's own from file to animation by two commands: found, repaired, fitted, animated."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from softdeca.animation.eyes_and_teeth import find_eyes_and_teeth
from softdeca.lhm import check_head, expressions, identities, load_template, scans
from softdeca.lhm.base.geometry.bvh import TriangleTree
from softdeca.lhm.head.detail import FineSkin
from softdeca.lhm.head.file import load_head
from softdeca.lhm.identities.space import OUTSIDE
from softdeca.lhm.template.registration import landmark_ids
from softdeca.surrogate import Surrogate

from ..rig_files import read_glb
from ..robustness.whole_files import grouped_obj

STATUE = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


@pytest.fixture(scope="module")
def person():
    return identities.Anny().sample(np.random.default_rng(4))[1]


@pytest.fixture(scope="module")
def file(person, tmp_path_factory):
    """The person in centimetres, z up, open at the neck, over vertices in another order; and a loose tooth."""
    order = np.random.default_rng(1).permutation(len(person.vertices))
    number = np.argsort(order)
    kept = person.triangles[person.vertices[person.triangles][:, :, 1].min(axis=1) > -95]
    path = tmp_path_factory.mktemp("scan") / "person.obj"
    x = 0.1 * person.vertices[order] @ STATUE.T
    tooth = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]) + len(x)
    corners = x.mean(axis=0) + 0.01 * np.eye(4)[:, :3]
    path.write_text(grouped_obj(np.vstack([x, corners]), np.vstack([number[kept], tooth]), 2))
    return path


@pytest.fixture(scope="module")
def fitted(file, tmp_path_factory):
    """The head's file, and the ended command. 20 s of processor: registration."""
    out = tmp_path_factory.mktemp("head") / "head.npz"
    code = "from softdeca.cli import main; main()"
    arguments = [sys.executable, "-c", code, "head", "fit", "--skin", file, "--level", "1", "--out", out]
    return out, subprocess.run(arguments, capture_output=True, text=True)


def test_the_fit_says_what_it_found(fitted):
    out, ended = fitted
    assert ended.returncode == 0, ended.stderr
    said = ("of 2 separate pieces", "unit: taken for cm", "z is up, -y the front")
    assert all(words in ended.stderr for words in said)
    assert any("taken for cm" in note for note in load_head(out).notes)


def test_it_is_one_of_the_default_people_whom_the_network_knows(fitted, person):
    head = load_head(fitted[0])
    assert np.array_equal(head.skin.triangles, person.triangles) and check_head(head).problems == ()
    assert head.rig.source == "anny" and head.rig.missing == ("tongueOut",)
    assert any(note.startswith("registered: the face lies 0.") for note in head.notes)
    assert find_eyes_and_teeth(head.skin) is not None
    network = Surrogate.load()
    assert network.knows(head.skin) and network.find_nearest(head.skin) is not None


def test_its_transferred_shapes_are_the_persons_own(fitted, person):
    head, space = load_head(fitted[0]), identities.Anny()
    # The head is upright and in millimetres again, and each vertex near its own place.
    moved = (head.skin.vertices - person.vertices)[space.parts == OUTSIDE]
    assert np.median(np.linalg.norm(moved - np.median(moved, axis=0), axis=1)) < 1.0
    for name, least in (("jawOpen", 0.9), ("mouthSmileLeft", 0.8), ("browInnerUp", 0.8)):
        k = expressions.index(name)
        own, found = space.shapes_on(person)[k].ravel(), head.rig.deltas[k].astype(float).ravel()
        assert own @ found / np.linalg.norm(own) / np.linalg.norm(found) > least, name


def test_it_is_shown_and_simulated_without_a_word_more(fitted, command, tmp_path):
    head = fitted[0]
    ended = command("head", "show", head, "--expression", "jawOpen", "--detail", "--out", tmp_path / "shown")
    assert ended.status == 0 and (tmp_path / "shown" / "skin.png").is_file()
    options = ("--head", head, "--detail", "--out", tmp_path / "take", "--json")
    ended = command("animate", "conversation:0.1:2", *options)
    assert ended.status == 0 and json.loads(ended.out)["failed"] == []
    assert (tmp_path / "take" / "preview.gif").is_file()
    fine = load_head(head).fine_skin
    with h5py.File(tmp_path / "take" / "take.vtkhdf") as file:
        assert np.array_equal(file["VTKHDF/Polygons/Connectivity"][()].reshape(-1, 3), fine.triangles)
        assert file["VTKHDF/NumberOfPoints"][0] == len(fine.heights)


def test_the_fine_skin_lies_on_the_scan(fitted, file):
    head = load_head(fitted[0])
    placed = scans.place_scan(load_template(level=1), file).skin
    smooth = FineSkin.from_skin(placed).refine(placed.vertices)  # the scan is coarse
    tree = TriangleTree(smooth.vertices, smooth.triangles)
    off = []
    for fine in (FineSkin.from_skin(head.skin), head.fine_skin):
        drawn = fine.refine(head.skin.vertices).vertices
        off.append(np.median(tree.closest(drawn[drawn[:, 2] > np.quantile(drawn[:, 2], 0.7)])[2]))
    assert off[1] < 0.5 * off[0] < 0.1


def test_the_scans_own_mesh_is_exported_with_its_shapes(fitted, file, person, command, tmp_path):
    ended = command("head", "export", fitted[0], "--scan", file, "--out", tmp_path / "own.glb", "--json")
    notes = json.loads(ended.out)
    assert ended.status == 0 and {"mouth", "lids"}.isdisjoint(notes) and notes["without"] == ["tongueOut"]
    lines = [line.split() for line in file.read_text().splitlines()]
    moved = [["v", *line[1:3], str(float(line[3]) + 0.3)] if line[:1] == ["v"] else line for line in lines]
    (tmp_path / "moved.obj").write_text("\n".join(map(" ".join, moved)) + "\n")  # by 3 mm, upwards
    ended = command("head", "export", fitted[0], "--scan", tmp_path / "moved.obj", "--out", tmp_path / "moved.glb")
    assert "is it the scan that the head was fitted to?" in ended.refusal()
    own = read_glb(tmp_path / "own.glb")[0]["skin"]
    order = np.random.default_rng(1).permutation(len(person.vertices))
    space, face = identities.Anny(), (person.vertices[order][:, 2] > np.quantile(person.vertices[:, 2], 0.6))
    assert own.points[: len(order)] == pytest.approx(person.vertices[order], abs=0.01)
    for name in ("jawOpen", "mouthSmileLeft", "eyeBlinkLeft"):
        moves = space.shapes_on(person)[expressions.index(name)][order][face]
        found = (own.frame(expressions.weights_of({name: 1.0})) - own.points)[: len(order)][face]
        assert np.linalg.norm(found - moves, axis=1).mean() < 0.25 * np.linalg.norm(moves, axis=1).mean(), name


def test_landmarks_are_named_and_found(command, file, fitted, person, tmp_path, monkeypatch):
    found, picture = tmp_path / "found.json", tmp_path / "found.png"
    ended = command("head", "fit", "--find-landmarks", found)
    assert ended.status == 0 and "nose tip" in json.loads(found.read_text()) and picture.stat().st_size > 20_000
    picture.unlink()
    # Registration finds here the skin that it found for the fit.
    laid = SimpleNamespace(vertices=load_head(fitted[0]).skin.vertices)
    monkeypatch.setattr("softdeca.lhm.scans.intake.register", lambda *_, **__: laid)
    ended = command("head", "fit", "--skin", file, "--find-landmarks", found)
    assert ended.status == 0 and picture.is_file() and not Path("out/head.npz").exists()
    points = json.loads(found.read_text())
    template = load_template()
    for name, vertex in landmark_ids(template.skin, template.parts).items():
        # In the file's own centimetres and axes.
        there = 0.1 * person.vertices[vertex] @ STATUE.T
        assert np.linalg.norm(np.array(points[name]) - there) < 0.4, name
