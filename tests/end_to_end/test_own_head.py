"""A head of one's own from file to animation by two commands: found, repaired, fitted, animated."""

import json
from pathlib import Path

import numpy as np
import pytest

from softdeca.lhm import check_head, expressions, identities, load_template
from softdeca.lhm.base.geometry.topology import find_openings
from softdeca.lhm.head_file import load_head
from softdeca.lhm.registration import landmark_ids

STATUE = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def write_obj(path, x, triangles):
    """An OBJ of two groups, and a loose tooth."""
    half = len(triangles) // 2
    lines = [f"v {a:.7g} {b:.7g} {c:.7g}" for a, b, c in x]
    for name, part in (("front", triangles[:half]), ("back", triangles[half:])):
        lines += [f"g {name}", f"usemtl {name}", *(f"f {a} {b} {c}" for a, b, c in part + 1)]
    n = len(x)
    middle = x.mean(axis=0)
    lines += [f"v {a:.7g} {b:.7g} {c:.7g}" for a, b, c in middle + 0.01 * np.eye(4)[:, :3]]
    lines += [f"f {n + a} {n + b} {n + c}" for a, b, c in ((1, 2, 3), (1, 3, 4), (1, 4, 2), (2, 4, 3))]
    path.write_text("\n".join(lines))


@pytest.fixture(scope="module")
def person():
    return identities.Anny().sample(np.random.default_rng(4))[1]


@pytest.fixture(scope="module")
def file(person, tmp_path_factory):
    """The person in centimetres, z up, open at the neck, over vertices in another order."""
    order = np.random.default_rng(1).permutation(len(person.vertices))
    number = np.argsort(order)
    kept = person.triangles[person.vertices[person.triangles][:, :, 1].min(axis=1) > -95]
    path = tmp_path_factory.mktemp("scan") / "person.obj"
    write_obj(path, 0.1 * person.vertices[order] @ STATUE.T, number[kept])
    return path


@pytest.fixture(scope="module")
def fitted(file, tmp_path_factory):
    import subprocess
    import sys

    out = tmp_path_factory.mktemp("head") / "head.npz"
    code = "from softdeca.cli import main; main()"
    arguments = [sys.executable, "-c", code, "head", "fit", "--skin", file, "--out", out]
    return out, subprocess.run(arguments, capture_output=True, text=True)


def test_the_fit_says_what_it_found(fitted):
    out, ended = fitted
    assert ended.returncode == 0, ended.stderr
    for words in (
        "of 2 separate pieces",
        "unit: taken for cm",
        "z is up, -y the front",
        "openings: 1 (1 of them large)",
    ):
        assert words in ended.stderr
    assert any("taken for cm" in note for note in load_head(out).notes)


def test_it_keeps_its_topology_openings_and_registration(fitted, person):
    head = load_head(fitted[0])
    assert len(find_openings(head.skin.triangles)) == 1
    assert check_head(head).problems == ()
    assert head.registered.vertices.shape == person.vertices.shape
    assert head.rig.source == "transferred from anny" and head.rig.missing == ()


def test_its_transferred_shapes_are_the_persons_own(fitted, person):
    head, space = load_head(fitted[0]), identities.Anny()
    upright = person.vertices[:, None] - head.skin.vertices.mean(axis=0)
    assert upright.shape[0] == len(person.vertices)
    # The same vertices in another order: by place, since the head is upright and in millimetres again.
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(person.vertices).query(head.skin.vertices)
    assert np.quantile(distance, 0.9) < 0.1
    for name, least in (("jawOpen", 0.9), ("mouthSmileLeft", 0.8), ("browInnerUp", 0.8)):
        k = expressions.index(name)
        own, found = space.expressions[k][nearest].ravel(), head.rig.deltas[k].astype(float).ravel()
        assert own @ found / np.linalg.norm(own) / np.linalg.norm(found) > least, name


def test_it_is_shown_and_simulated_without_a_word_more(fitted, command, tmp_path):
    head = fitted[0]
    ended = command("head", "show", head, "--expression", "jawOpen", "--out", tmp_path / "shown")
    assert ended.status == 0 and (tmp_path / "shown" / "skin.png").is_file()
    ended = command("animate", "conversation:0.1:2", "--head", head, "--out", tmp_path / "take", "--json")
    assert ended.status == 0 and json.loads(ended.out)["failed"] == []
    assert (tmp_path / "take" / "preview.gif").is_file()
    ended = command("head", "show", head, "--expression", "jawOpen", "--identities", "anny", "--out", tmp_path / "x")
    assert ended.status == 1 and "not the triangles of 'anny'" in ended.errors[-1]


def test_landmarks_are_named_and_found(command, file, person, tmp_path):
    found, picture = tmp_path / "found.json", tmp_path / "found.png"
    ended = command("head", "fit", "--find-landmarks", found)
    assert ended.status == 0 and "nose tip" in json.loads(found.read_text()) and picture.stat().st_size > 20_000
    ended = command("head", "fit", "--find-landmarks", found, "--seed", 1)
    assert ended.status != 0 and "leave out --seed" in ended.errors[-1]
    picture.unlink()
    ended = command("head", "fit", "--skin", file, "--find-landmarks", found)
    assert ended.status == 0 and picture.is_file() and not Path("out/head.npz").exists()
    points = json.loads(found.read_text())
    template = load_template()
    for name, vertex in landmark_ids(template.skin, template.parts).items():
        # In the file's own centimetres and axes.
        there = 0.1 * person.vertices[vertex] @ STATUE.T
        assert np.linalg.norm(np.array(points[name]) - there) < 0.4, name
