"""softdeca head export: other programs' readers find the frames that Python makes, and the error that it tells."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from softdeca.animation.export import EXPRESSIONS
from softdeca.animation.eyes_and_teeth import find_eyes_and_teeth, turn_eye
from softdeca.lhm import expressions
from softdeca.lhm.expressions.rig import Rig
from softdeca.lhm.head.file import save_head
from softdeca.reference import Face, Parameters
from softdeca.surrogate import METHODS

from ..rig_files import bake_usd, read_glb, read_usd

NODES = ["skin", "left_eye", "right_eye", "upper_teeth", "lower_teeth", "upper_gums", "lower_gums"]
WEIGHTS = np.random.default_rng(1).uniform(0.0, 0.6, 52).astype(np.float32)
VALIDATE = """
const [validator, file] = process.argv.slice(1);
require(validator).validateBytes(new Uint8Array(require("fs").readFileSync(file)))
  .then(report => console.log(JSON.stringify(report)));
"""


@pytest.fixture(scope="module")
def face(mean_head, anny):
    return Face(mean_head, anny.expression_deltas(np.zeros(anny.code_size)), Parameters(soft_volume=1.2, gravity=1.5))


@pytest.fixture(scope="module")
def rig(face):
    return METHODS["derivatives"].bind(face)


@pytest.fixture
def files(tmp_path, mean_head):
    """A head's file, that of its parameters, and one of all defaults."""
    save_head(tmp_path / "head.npz", mean_head)
    (tmp_path / "p.toml").write_text("soft_volume = 1.2\ngravity = 1.5\n")
    return tmp_path


def check_surfaces(surfaces, rig):
    """Assert that a sum of targets is the rig's frame, and that eyes and teeth are where its skin has them."""
    assert list(surfaces) == NODES
    assert all(list(surface.offsets) == ([] if "eye" in name else list(expressions.ARKIT))
               for name, surface in surfaces.items())  # fmt: skip
    for weights in (0.0 * WEIGHTS, WEIGHTS):
        skin = rig.frame(weights)
        assert np.abs(surfaces["skin"].frame(weights) - skin).max() < 0.01
        placed = find_eyes_and_teeth(rig.skin).place(skin.astype(np.float64))
        ends = np.cumsum([len(surfaces[name].points) for name in NODES[1:]])
        for name, points in zip(NODES[1:], np.split(placed, ends[:-1]), strict=True):
            if "eye" not in name or not weights.any():  # eyes keep their place at rest
                found = surfaces[name].frame([] if "eye" in name else weights)
                assert np.abs(found - points).max() < 0.01, name
    for name in NODES[1:3]:  # a ball about its node, which an engine may turn
        assert np.ptp(np.linalg.norm(surfaces[name].points, axis=1)) < 1.0
    assert surfaces["left_eye"].place[0] > 25.0 > -25.0 > surfaces["right_eye"].place[0]


def test_gltf_has_the_simulators_targets_and_tells_their_error(files, rig, face, command):
    out = files / "new" / "head.glb"
    ended = command("head", "export", files / "head.npz", "--parameters", files / "p.toml", "--out", out)
    assert ended.status == 0 and ended.errors == []
    surfaces, notes = read_glb(out)
    check_surfaces(surfaces, rig)
    assert notes["method"] == "derivatives"
    for name, side in {"eyeLookOutLeft": "Left", "eyeLookInRight": "Right", "eyeLookDownRight": "Right"}.items():
        ((axis, degrees),) = notes["eye_turns_degrees"][name].items()
        turn = trimesh.transformations.rotation_matrix(np.radians(degrees), np.eye(3)["xyz".index(axis)])[:3, :3]
        assert turn == pytest.approx(turn_eye(side, expressions.weights_of({name: 1.0})))
    told = f"mean {notes['mean_error_mm']:.2g} mm, at most {notes['largest_error_mm']:.2g} mm"
    assert f"error to the simulator on {EXPRESSIONS} mixed expressions: {told}" in ended.out and "wrote" in ended.out
    simulated = METHODS["PD"].bind(face)
    rng, off = np.random.default_rng(0), []
    for weights in (expressions.sample_weights(rng) for _ in range(EXPRESSIONS)):
        off.append(np.linalg.norm(surfaces["skin"].frame(weights) - simulated.frame(weights), axis=1))
    assert notes["largest_error_mm"] == pytest.approx(np.max(off), abs=0.02)
    vertex = notes["largest_error_vertex"]
    assert np.max(off, axis=0)[vertex] == pytest.approx(np.max(off), abs=0.02) and f"at vertex {vertex} (" in ended.out
    assert np.mean(off) < notes["mean_error_mm"] < 0.5 * np.max(off), "the mean is of what physics moves alone"
    scene = trimesh.load(out, process=False)
    assert set(scene.geometry) == set(NODES)
    for name, surface in surfaces.items():
        matrix, mesh = scene.graph[name]
        assert 1e3 * (scene.geometry[mesh].vertices + matrix[:3, 3]) == pytest.approx(surface.frame(
            np.zeros(len(surface.offsets))), abs=1e-3)  # fmt: skip


def test_usd_has_the_same_and_usdskel_deforms_it(files, rig, command):
    pytest.importorskip("pxr")
    options = ("--parameters", files / "p.toml", "--format", "usd", "--json")
    ended = command("head", "export", files / "head.npz", *options, "--out", files / "head.usd")
    result = json.loads(ended.out)
    assert (result["surfaces"], result["targets"], result["files"]) == (NODES, 52, [str(files / "head.usd")])
    surfaces, notes = read_usd(files / "head.usd")
    assert notes == {"generator": "softdeca"} | {
        key: value for key, value in result.items() if key not in ("surfaces", "targets", "without", "files")
    }
    check_surfaces(surfaces, rig)
    names, _, frames = bake_usd(files / "head.usd", WEIGHTS)
    assert names == list(expressions.ARKIT) and np.abs(frames[0] - rig.frame(WEIGHTS)).max() < 0.01


def test_without_parameters_it_has_blendshapes(files, face, command):
    ended = command("head", "export", files / "head.npz", "--out", files / "head.glb")
    assert ended.status == 0 and "52 morph targets, blendshapes" in ended.out and "error" not in ended.out
    surfaces, notes = read_glb(files / "head.glb")
    assert notes["method"] == "blendshapes" and "mean_error_mm" not in notes
    assert np.abs(surfaces["skin"].frame(WEIGHTS) - face.blend(WEIGHTS)).max() < 0.01


def test_with_detail_the_skin_is_the_fine_one(files, face, command):
    ended = command("head", "export", files / "head.npz", "--detail", "--out", files / "fine.glb")
    assert ended.status == 0
    surfaces, _ = read_glb(files / "fine.glb")
    assert list(surfaces) == NODES
    fine = face.head.fine_skin
    for weights in (np.zeros(52), expressions.weights_of({"jawOpen": 1.0})):
        drawn = fine.refine(face.blend(weights)).vertices
        assert np.abs(surfaces["skin"].frame(weights) - drawn).max() < 0.01


def test_the_validator_of_khronos_finds_nothing(files, command):
    node, validator = shutil.which("node"), Path(sys.prefix) / "lib" / "node_modules" / "gltf-validator"
    if node is None or shutil.which("npm") is None:
        pytest.skip("no npm")
    if not validator.is_dir():
        pytest.skip("gltf-validator is not installed; tools/set-up does")
    command("head", "export", files / "head.npz", "--out", files / "head.glb")
    options = ("--level", 1, "--preview", "none", "--format", "glb", "--out", files)
    command("animate", "conversation:0.1", *options)
    for name in ("head.glb", "take.glb"):
        report = json.loads(subprocess.check_output([node, "-e", VALIDATE, validator, files / name]))
        assert report["issues"]["messages"] == [] and report["info"]["hasMorphTargets"], name


def test_a_head_in_other_triangles_has_its_skin_alone_and_one_without_a_rig_is_refused(files, sphere_head, command):
    deltas = np.zeros((52, *sphere_head.skin.vertices.shape), np.float32)
    deltas[17] = 1.0
    own = replace(sphere_head, rig=Rig(deltas, "made up"))
    for name, head in (("own", own), ("bare", sphere_head)):
        save_head(files / f"{name}.npz", head)
    ended = command("head", "export", files / "own.npz", "--out", files / "own.glb")
    surfaces, notes = read_glb(files / "own.glb")
    assert ended.status == 0 and list(surfaces) == ["skin"] and "eye_turns_degrees" not in notes
    assert "without browDownLeft, browDownRight, " in ended.out and expressions.ARKIT[17] not in ended.out
    assert np.flatnonzero([offsets.any() for offsets in surfaces["skin"].offsets.values()]) == [17]
    said = command("head", "export", files / "bare.npz", "--out", files / "bare.glb").refusal()
    assert "its skin has not the triangles of 'anny'; fit it anew, and it keeps expressions of its own" in said
    assert not (files / "bare.glb").exists()
