"""`head personalise`: scans of a person's expressions, of the head's topology and of another, make its rig theirs."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from softdeca.lhm import expressions, fit_head, load_template
from softdeca.lhm.head.file import load_head, save_head
from softdeca.lhm.template.fit import add_own_expressions

SMILE, OPEN = expressions.index("mouthSmileLeft"), expressions.index("jawOpen")
STATUE = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def write(path, vertices, triangles):
    trimesh.Trimesh(vertices, triangles, process=False).export(path)


@pytest.fixture(scope="module")
def person(tmp_path_factory):
    """A head's file, and the person's own smile and open jaw: larger than the template's, the smile also bulging."""
    folder = tmp_path_factory.mktemp("person")
    template = load_template(level=1)
    head = fit_head(template, template.skin)
    save_head(folder / "head.npz", head)
    own = head.rig.deltas.astype(float)
    most = np.linalg.norm(own[SMILE], axis=1)
    bulge = 3.0 * (most / most.max())[:, None] * head.skin.vertex_normals
    return folder, head, {SMILE: 1.2 * own[SMILE] + bulge, OPEN: 0.8 * own[OPEN]}


@pytest.fixture(scope="module")
def own(person):
    """The folder with a scan of the smile in metres, z up, and one of the jaw, of other triangles and open below."""
    folder, head, shapes = person
    x = head.skin.vertices
    smile = x + shapes[SMILE]
    write(folder / "smile.ply", 1e-3 * smile @ STATUE.T + [0.3, 0, 1], head.skin.triangles)
    opened = x + shapes[OPEN]
    order = np.random.default_rng(1).permutation(len(x))
    kept = head.skin.triangles[opened[head.skin.triangles][:, :, 1].min(axis=1) > -95]
    write(folder / "open.obj", 0.1 * opened[order], np.argsort(order)[kept])
    (folder / "weights.json").write_text(json.dumps({"smile.ply": {"mouthSmileLeft": 1}, "open.obj": {"jawOpen": 1}}))
    return folder


def test_the_rig_becomes_the_persons(person, own, command):
    """20 s of processor: the registration of a scan of other triangles."""
    _, head, shapes = person
    out = own / "own.npz"
    ended = command("head", "personalise", own / "head.npz", own / "weights.json", "--out", out, "--json")
    assert ended.status == 0, ended.errors
    told = json.loads(ended.out)
    assert "own triangles" in told["notes"][0] and "laid upon it" in told["notes"][1]
    assert told["rms_mm"][-1] < 0.5 * told["rms_mm"][0]
    rig = load_head(out).rig
    assert "personalised from 2 scans, 2 of 52 shapes" in rig.source
    for k, name, share in ((SMILE, "smile.ply", 0.35), (OPEN, "open.obj", 0.6)):
        weight = next(iter(told["weights"][name].values()))
        before = np.linalg.norm(head.rig.deltas[k] - shapes[k], axis=1)
        after = np.linalg.norm(weight * rig.deltas[k] - shapes[k], axis=1)
        moved = np.linalg.norm(shapes[k], axis=1) > 2.0
        assert after[moved].mean() < share * before[moved].mean(), (name, after[moved].mean(), before[moved].mean())
    puff = expressions.index("cheekPuff")
    np.testing.assert_allclose(rig.deltas[puff], head.rig.deltas[puff], atol=1e-5)


def test_what_is_wrong_with_the_guesses_is_one_line(own, command):
    (own / "a.json").write_text('{"smile.ply": {"smirk": 1}}')
    out = own / "not.npz"
    ended = command("head", "personalise", own / "head.npz", own / "a.json", "--out", out)
    assert "smile.ply: " in ended.refusal() and "smirk" in ended.refusal() and not out.exists()


def test_a_head_with_morph_targets_of_its_own_keeps_those_that_no_scan_shows(person, own, command):
    folder, head, shapes = person
    puff = expressions.index("cheekPuff")
    told = {"mouthSmileLeft": 0.7 * shapes[SMILE], "cheekPuff": 1.3 * head.rig.deltas[puff].astype(float)}
    rigged = replace(head, rig=add_own_expressions(head.rig, told))
    save_head(folder / "rigged.npz", rigged)
    (folder / "smile.json").write_text(json.dumps({"smile.ply": {"mouthSmileLeft": 1}}))
    out = folder / "rigged_own.npz"
    ended = command("head", "personalise", folder / "rigged.npz", folder / "smile.json", "--out", out, "--json")
    assert ended.status == 0, ended.errors
    rig = load_head(out).rig
    assert "2 of its own" in rig.source and "personalised from 1 scans, 1 of 52 shapes" in rig.source
    np.testing.assert_allclose(rig.deltas[puff], told["cheekPuff"], atol=1e-5)
    weight = json.loads(ended.out)["weights"]["smile.ply"]["mouthSmileLeft"]
    moved = np.linalg.norm(shapes[SMILE], axis=1) > 2.0
    before, after = (
        np.linalg.norm(found - shapes[SMILE], axis=1)[moved].mean()
        for found in (told["mouthSmileLeft"], weight * rig.deltas[SMILE])
    )
    assert after < 0.5 * before, (after, before)
