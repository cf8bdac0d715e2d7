"""softdeca animate: a take in, files that other programs read out: within an accuracy, or by a rig."""

import json
import os
from dataclasses import replace

import h5py
import numpy as np
import pytest
from PIL import Image

from softdeca.animation.animate import Animation, animate
from softdeca.lhm import expressions, fit_head, identities, load_template
from softdeca.lhm.base.progress import silent
from softdeca.reference import Face, Parameters, SceneError, Sequence, solve
from softdeca.reference.face.dynamics import extrapolate_turns, turn_skin
from softdeca.reference.face.parameters import read_parameters
from softdeca.surrogate import Surrogate, certify
from softdeca.surrogate.methods import bind_cheaply

from ..rig_files import bake_usd, parse_glb, read_glb


@pytest.fixture(scope="module")
def network():
    return Surrogate.load()


@pytest.fixture
def deltas(sphere_head):
    """Two expressions of the sphere: jawOpen swings its lower half down, mouthLeft to a side [mm]."""
    x = sphere_head.skin.vertices
    low = np.clip(-x[:, 1:2] / 100, 0, 1)
    found = np.zeros((52, *x.shape))
    found[expressions.index("jawOpen")] = 9 * low * [0, -1, 0.2]
    found[expressions.index("mouthLeft")] = 5 * low * [1, 0, 0]
    return found


def take(frames=8):
    t = np.arange(frames) / 60
    weights = np.zeros((frames, 52))
    weights[:, expressions.index("jawOpen")] = np.sin(20 * t) ** 2
    weights[:, expressions.index("mouthLeft")] = 0.5 - 0.5 * np.cos(15 * t)
    return expressions.Take(weights, 60.0, t)


def nodding(frames=8):
    """The take on a head that nods and shakes."""
    t = np.arange(frames) / 60
    return replace(take(frames), head=np.stack([0.2 * np.sin(12 * t), 0.3 * np.sin(9 * t + 1), 0 * t], axis=1))


def run(config, head, deltas, shown, p=None, progress=silent):
    """The take by the dial, or by the simulator frame after frame; no network knows a sphere."""
    face = Face(head, deltas, Parameters() if p is None else p)
    return animate(config, face, shown, Surrogate.load(), progress)


def logged(folder):
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


@pytest.mark.parametrize(
    ("dynamic", "bones", "take"),
    [(False, "rigid", take), (False, "prescribed", take), (True, "prescribed", take), (True, "rigid", nodding)],
)
def test_a_take_is_the_dials_or_the_simulators(sphere_head, deltas, tmp_path, dynamic, bones, take):
    p = Parameters(gravity=1.5, soft_volume=1.2)

    config = Animation(tmp_path, dynamic=dynamic, bones=bones, accuracy=0.01)
    done = run(config, sphere_head, deltas, take(), p)
    assert (done.frames, done.failed, done.crossing) == (8, (), 0)
    assert [row["skin_crossings"] for row in logged(tmp_path)] == 8 * [0]
    moved = played(done.files[0]) - sphere_head.skin.vertices
    assert all(row["error"] * (1 if row["certain"] else 3) <= 0.01 for row in logged(tmp_path))
    if not dynamic and bones == "rigid":
        face = certify(Face(sphere_head, deltas, p))
        for k, weights in enumerate(take().weights):
            truth = face.frame(weights, 1e-6).skin
            assert np.linalg.norm(sphere_head.skin.vertices + moved[k] - truth, axis=1).mean() < 0.015
        return
    sequence = Sequence(Face(sphere_head, deltas, p, choices={"bones": bones}, settling={}), dynamic=dynamic)
    bases = expressions.rotations(np.zeros((8, 3)) if take().head is None else take().head)
    for k in range(8):
        targets = sphere_head.skin.vertices + np.tensordot(take().weights[k], deltas, axes=1)
        if not k:
            sequence.begin(targets, base=extrapolate_turns(bases))
        skin = sequence.skin(targets, sequence.frame(targets, base=bases[k]))
        assert moved[k] == pytest.approx(skin - sphere_head.skin.vertices, abs=0.02)


def test_a_head_that_turns_shakes_the_face_and_is_written_in_its_own_frame_or_turned(sphere_head, deltas, tmp_path):
    def shown(shaken, **choices):
        return played(run(Animation(tmp_path, dynamic=True, **choices), sphere_head, deltas, shaken).files[0])

    still, own = shown(take()), shown(nodding())
    assert np.linalg.norm(own - still, axis=2).max() > 1.0
    room = shown(nodding(), turned=True)
    for k, base in enumerate(expressions.rotations(nodding().head)):
        assert room[k] == pytest.approx(turn_skin(sphere_head, own[k], base), abs=1e-4)
    assert np.linalg.norm(room - own, axis=2).max() > 20.0


def test_a_take_moves_the_face_that_p_makes(sphere_head, deltas, tmp_path):
    """At zero weights the skin is the settled neutral face's."""
    p, still = Parameters(soft_volume=1.4), replace(take(2), weights=np.zeros((2, 52)))
    face = Face(sphere_head, deltas, p, choices={"bones": "prescribed"}, settling={})
    config = Animation(tmp_path, bones="prescribed")
    done = run(config, sphere_head, deltas, still, p)
    assert done.neutral == "CONVERGED"
    moved = played(done.files[0], 2)[1] - sphere_head.skin.vertices
    rest = solve(face.neutral_scene(), start=face.settled().positions).positions
    assert moved == pytest.approx(rest[: len(moved)] - sphere_head.skin.vertices, abs=2e-4)
    assert np.abs(moved).max() > 0.1


def test_frames_that_fail_are_listed_and_the_rest_goes_on(sphere_head, deltas, tmp_path, monkeypatch):
    frame, calls = Sequence.frame, []

    def breaks(self, targets, **given):
        calls.append(0)
        if len(calls) == 3:
            raise SceneError("made to fail")
        return frame(self, targets, **given)

    monkeypatch.setattr(Sequence, "frame", breaks)
    done = run(Animation(tmp_path, bones="prescribed"), sphere_head, deltas, take(5))
    assert done.frames == 5 and done.failed == ((2, "made to fail"),)
    blended = np.tensordot(take(5).weights[2], deltas, axes=1)
    assert played(done.files[0], 5)[2] == pytest.approx(sphere_head.skin.vertices + blended, abs=1e-4)


def test_the_command_writes_a_preview_a_log_and_a_model(command, tmp_path):
    (tmp_path / "p.toml").write_text("gravity = 2.0\nfrequency = 3\n")
    ended = command(
        *("animate", "conversation:0.2:2", "--level", 1, "--parameters", tmp_path / "p.toml"),
        *("--format", "glb", "--dynamic", "--frames", "2:", "--out", tmp_path / "take", "--json"),
    )
    assert ended.status == 0 and ended.errors == []
    result = json.loads(ended.out)
    assert result["frames"] == 10 and result["failed"] == []
    assert [os.path.basename(f) for f in result["files"]] == ["take.glb", "preview.gif", "log.jsonl"]
    log = [json.loads(line) for line in (tmp_path / "take" / "log.jsonl").read_text().splitlines()]
    assert [row["frame"] for row in log] == list(range(10))
    assert log[0]["time"] == pytest.approx(2 / 60) and all(row["reason"] == "" for row in log)
    assert all(row["method"] == "simulated" and row["error"] <= 0.05 and row["seconds"] > 0 for row in log)
    with Image.open(tmp_path / "take" / "preview.gif") as gif:
        durations = [gif.seek(k) or gif.info["duration"] for k in range(gif.n_frames)]
        assert durations == [50, 50, 50, 50], "every third of ten frames: 20 a second, each another"
        shown = np.array(gif.convert("RGB"), dtype=float)
    assert shown.shape == (460, 800, 3)
    assert shown[40:420].std() > 20 and np.abs(shown[:, :400] - shown[:, 400:]).mean() > 0.2, "two heads that differ"


def test_an_mp4_preview_has_the_takes_length(sphere_head, deltas, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    run(Animation(tmp_path, preview="mp4"), sphere_head, deltas, take(6))
    reader = ffmpeg.read_frames(str(tmp_path / "preview.mp4"))
    meta = next(reader)
    pictures = [np.frombuffer(picture, np.uint8) for picture in reader]
    assert meta["size"] == (800, 460) and meta["fps"] == 60 and len(pictures) == 6
    left = np.array([p.reshape(460, 800, 3)[:, :400] for p in pictures], dtype=float)
    assert (np.abs(np.diff(left, axis=0)).mean(axis=(1, 2, 3)) > 0.05).all(), "each frame shows another face"


def test_a_recorded_take_is_animated(command, data, tmp_path):
    file = data / "arkit_sequences" / "alex_rom_3.csv"
    ended = command(
        *("animate", file, "--level", 1, "--frames", "900:906", "--preview", "none", "--out", tmp_path / "take")
    )
    assert ended.status == 0 and "6 frames (" in ended.out and "0 failed; largest error 0.0" in ended.out
    assert not ended.errors  # the one weight that is clipped lies elsewhere
    turned = command("animate", file, "--turned", "--out", tmp_path / "turned")
    assert turned.status != 0 and "has no head rotation" in turned.errors[0] and len(turned.errors) == 1


def test_a_spoken_text_is_animated_and_lost_frames_are_told(command, data, tmp_path):
    pytest.importorskip("openfacefx")
    level, none = ("--level", 1), ("--preview", "none")
    spoken = command("animate", "speech:Bob.", *level, *none, "--frames", "20:23", "--out", tmp_path / "speech")
    assert spoken.status == 0 and "3 frames (" in spoken.out and not spoken.errors
    file = data / "arkit_sequences" / "s88_001_lost_face_rows.csv"
    lost = command("animate", file, *level, *none, "--frames", "382:386", "--out", tmp_path / "lost")
    assert lost.status == 0 and len(lost.errors) == 1 and "frames without a face left out" in lost.errors[0]


def test_a_parameter_file_gives_numbers_and_arrays(tmp_path):
    np.save(tmp_path / "skin.npy", [20.0, 30.0])
    (tmp_path / "p.toml").write_text('gravity = 2\nskin_stiffness = "skin.npy"  # local\n')
    found = read_parameters(tmp_path / "p.toml")
    assert found == Parameters(gravity=2.0, skin_stiffness=np.array([20.0, 30.0]))


def played(path, frames=8):
    with h5py.File(path) as file:
        return file["VTKHDF/Points"][()].reshape(frames, -1, 3)


def test_a_head_that_no_network_knows_takes_the_simulators_derivatives(network, sphere_head, deltas, tmp_path):
    face = Face(sphere_head, deltas, Parameters(soft_volume=1.2))
    method, rig = bind_cheaply(face, network)
    assert method == "derivatives"
    take = nodding()
    for dynamic in (False, True):
        wanted = Animation(tmp_path / "own", accuracy=None, dynamic=dynamic)
        done = animate(wanted, face, take, network, silent)
        assert done.frames == 8 and done.frame_ms > 0 and done.files[0] == tmp_path / "own" / "take.vtkhdf"
        moving = rig.dynamic(1 / 60) if dynamic else rig
        bases = expressions.rotations(take.head)
        if dynamic:
            moving.begin(take.weights[0], base=extrapolate_turns(bases))
        answers = [
            moving.frame(w, base=base) if dynamic else moving.frame(w)
            for w, base in zip(take.weights, bases, strict=True)
        ]
        assert played(done.files[0]) == pytest.approx(np.array(answers), abs=1e-4)
    in_room = Animation(tmp_path / "room", accuracy=None, dynamic=True, turned=True)
    room = animate(in_room, face, take, network, silent)
    for own, shown, base in zip(answers, played(room.files[0]), bases, strict=True):
        assert shown == pytest.approx(turn_skin(sphere_head, own, base), abs=1e-3)


@pytest.mark.parametrize("format", ["glb", "usd"])
@pytest.mark.parametrize("dynamic", [False, True])
def test_frames_that_are_sums_of_targets_are_written_by_their_names(
    network, sphere_head, deltas, tmp_path, format, dynamic
):
    if format == "usd":
        pytest.importorskip("pxr")
    face, shown = Face(sphere_head, deltas, Parameters(soft_volume=1.2)), take()
    wanted = Animation(tmp_path, format, accuracy=None, dynamic=dynamic)
    done, rig = animate(wanted, face, shown, network, silent), bind_cheaply(face, network)[1]
    path = tmp_path / f"take.{format}"
    assert done.files[0] == path
    if format == "usd":
        names, times, frames = bake_usd(path)
        assert times == pytest.approx(shown.times)
    else:
        skin, (content, array) = read_glb(path)[0]["skin"], parse_glb(path)
        names = list(skin.offsets)
        weights = array(content["animations"][0]["samplers"][0]["output"]).reshape(8, -1)
        frames = np.array([skin.frame(row) for row in weights])
    if dynamic:
        assert all(name.startswith("component") for name in names) and "greatest error" in done.notes[0]
        return
    assert names == list(expressions.ARKIT) and done.notes == (f"{path.name}: ARKit's 52 morph targets",)
    assert np.abs(frames - [rig.frame(w) for w in shown.weights]).max() < 0.01


def test_a_head_of_the_networks_people_is_served_by_it_and_another_in_part(network):
    space, template = identities.Anny(), load_template(level=1)
    code, skin = space.sample(np.random.default_rng(4))
    p = Parameters(soft_volume=1.2)
    face = Face(fit_head(template, skin), space.expression_deltas(code), p)
    method, known = bind_cheaply(face, network)
    assert method == "network"
    weights = np.linspace(0.0, 0.3, 52)
    assert np.abs(known.frame(weights) - network.bind(skin, code, p).frame(weights)).max() < 0.05
    x = skin.vertices
    other = skin.with_vertices(x + 4.0 * np.sin(x[:, 1:2] / 20.0) * [1.0, 0.0, 0.0])
    stranger = Face(fit_head(template, other), space.expression_deltas(code), p)
    assert bind_cheaply(stranger, network)[0] == "network + derivatives"


@pytest.mark.parametrize("name", ["network", "hypernetwork"])
def test_the_command_writes_what_a_rig_makes(name, command, tmp_path):
    (tmp_path / "p.toml").write_text("soft_volume = 1.2\nfrequency = 3\n")
    ended = command(
        *("animate", "conversation:0.2:2", "--accuracy", "none", "--surrogate", name),
        *("--parameters", tmp_path / "p.toml", "--dynamic"),
        *("--format", "glb", "--frames", "2:", "--out", tmp_path / "take", "--json"),
    )
    assert ended.status == 0 and ended.errors == []
    result = json.loads(ended.out)
    assert result["methods"] == {name: 10} and result["frames"] == 10
    assert [path.split("/")[-1] for path in result["files"]] == ["take.glb", "preview.gif", "log.jsonl"]
    assert parse_glb(tmp_path / "take" / "take.glb")[0]["animations"]
