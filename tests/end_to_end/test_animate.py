"""softdeca animate: a take through the surrogate, as glTF, VTKHDF and preview, on whatever head."""

import json
import struct
from dataclasses import replace

import h5py
import numpy as np
import pytest

from softdeca.animation.animate import animate, bind_head
from softdeca.animation.play import Output
from softdeca.lhm import InputError, expressions, fit_head, identities, load_template
from softdeca.lhm.base.progress import silent
from softdeca.lhm.base.provenance import list_missing
from softdeca.lhm.head_file import save_head
from softdeca.reference import Parameters
from softdeca.reference.face.dynamics import extrapolate_turns, turn_skin
from softdeca.surrogate import Surrogate


@pytest.fixture(scope="module")
def network():
    return Surrogate.load()


@pytest.fixture
def deltas(sphere_head):
    """Of one expression: jawOpen swings a sphere's lower half down [mm]."""
    x = sphere_head.skin.vertices
    found = np.zeros((52, *x.shape))
    found[expressions.index("jawOpen")] = 9 * np.clip(-x[:, 1:2] / 100, 0, 1) * [0, -1, 0.2]
    return found


def nodding(frames=8):
    t = np.arange(frames) / 60
    weights = np.zeros((frames, 52))
    weights[:, expressions.index("jawOpen")] = np.sin(20 * t) ** 2
    head = np.stack([0.2 * np.sin(12 * t), 0.3 * np.sin(9 * t + 1), 0 * t], axis=1)
    return replace(expressions.Take(weights, 60.0, t), head=head)


def played(path, frames=8):
    with h5py.File(path) as file:
        return file["VTKHDF/Points"][()].reshape(frames, -1, 3)


def gltf(path):
    content = path.read_bytes()
    (size,) = struct.unpack("<I", content[12:16])
    return json.loads(content[20 : 20 + size])


def test_a_head_that_no_network_knows_takes_the_simulators_derivatives(network, sphere_head, deltas, tmp_path):
    served = bind_head(network, sphere_head, deltas, Parameters(soft_volume=1.2), exact=False, beyond="refuse")
    assert served.method == "linearised simulator" and served.seconds > 0
    take = nodding()
    for dynamic in (False, True):
        done = animate(Output(tmp_path / "own", dynamic=dynamic), served, take, silent)
        assert done.frames == 8 and done.frame_ms > 0 and done.files == (tmp_path / "own" / "take.vtkhdf",)
        moving = served.rig.dynamic(1 / 60) if dynamic else served.rig
        bases = expressions.rotations(take.head)
        if dynamic:
            moving.begin(take.weights[0], base=extrapolate_turns(bases))
        wanted = [
            moving.frame(w, base=base) if dynamic else moving.frame(w)
            for w, base in zip(take.weights, bases, strict=True)
        ]
        assert played(done.files[0]) == pytest.approx(np.array(wanted), abs=1e-4)
    room = animate(Output(tmp_path / "room", dynamic=True, turned=True), served, take, silent)
    for own, shown, base in zip(wanted, played(room.files[0]), bases, strict=True):
        assert shown == pytest.approx(turn_skin(sphere_head, own, base), abs=1e-3)
    with pytest.raises(InputError, match="turned: the take has no head rotation"):
        animate(Output(tmp_path, turned=True), served, replace(take, head=None), silent)


def test_a_head_of_the_networks_people_is_served_by_it_and_another_in_part(network):
    space, template = identities.Anny(), load_template(level=1)
    code, skin = space.sample(np.random.default_rng(4))
    p = Parameters(soft_volume=1.2)
    known = bind_head(network, fit_head(template, skin), space.expressions, p, exact=False, beyond="refuse")
    assert known.method == "network"
    weights = np.linspace(0.0, 0.3, 52)
    assert np.abs(known.rig.frame(weights) - network.bind(skin, code, p).frame(weights)).max() < 0.05
    x = skin.vertices
    other = skin.with_vertices(x + 4.0 * np.sin(x[:, 1:2] / 20.0) * [1.0, 0.0, 0.0])
    head = fit_head(template, other)
    assert bind_head(network, head, space.expressions, p, exact=False, beyond="refuse").method == "network + simulator"


def test_the_command_writes_what_simulate_does_and_the_rig(command, tmp_path):
    (tmp_path / "p.toml").write_text("soft_volume = 1.2\nfrequency = 3\n")
    ended = command(
        *("animate", "conversation:0.2:2", "--seed", 1, "--parameters", tmp_path / "p.toml", "--dynamic"),
        *("--format", "gltf", "--frames", "2:", "--out", tmp_path / "take", "--json"),
    )
    assert ended.status == 0 and ended.errors == []
    result = json.loads(ended.out)
    assert result["method"] == "network" and result["frames"] == 10
    assert [path.split("/")[-1] for path in result["files"]] == ["take.glb", "preview.gif"]
    assert gltf(tmp_path / "take" / "take.glb")["animations"]
    ended = command(
        *("animate", "conversation:0.1", "--level", 1, "--exact", "--preview", "none", "--targets", 12),
        *("--out", tmp_path / "baked"),
    )
    assert ended.status == 0 and "6 frames by network + simulator: bound in" in ended.out
    rig = gltf(tmp_path / "baked" / "rig.glb")
    assert len(rig["meshes"][0]["primitives"][0]["targets"]) == 12
    assert 0.0 < rig["meshes"][0]["extras"]["greatest_error_mm"] < 5.0
    assert rig["accessors"][rig["animations"][0]["samplers"][0]["output"]]["count"] == 6 * 12


def test_a_heads_file_is_served(command, tmp_path):
    save_head(tmp_path / "head.npz", fit_head(load_template(level=1), identities.Anny().mean))
    ended = command(
        *("animate", "conversation:0.1", "--head", tmp_path / "head.npz", "--preview", "none"),
        *("--out", tmp_path / "take"),
    )
    assert ended.status == 0 and "6 frames by network:" in ended.out


def test_gaps_of_lids_and_lips_are_drawn(command, tmp_path):
    # Frames in which conversation 0 blinks.
    ended = command(
        *("bench", "heads", "--cases", "closures", "--frames", "20:27", "--level", 1, "--dynamic"),
        *("--out", tmp_path, "--json"),
    )
    assert ended.status == 0
    results = json.loads(ended.out)
    assert set(list_missing(results)) <= {"clean tree", "commit"} and results["options"]["level"] == 1
    (row,) = results["rows"]
    rows = row["values"]["rows"]
    assert {line["gap"] for line in rows} == {"left lids", "right lids", "lips"} and len(rows) == 9
    lids = np.array(row["values"]["widths_mm"]["PD"])[:, 0]
    assert lids[0] - lids[-1] > 2.0, "the blink closes them"
    # The network knows level 2, whose simulated lids close .45 mm farther than those of level 1.
    off = {(line["gap"], line["by"]): line["largest"] for line in rows}
    plain = {gap: largest for (gap, method), largest in off.items() if method == "blendshapes"}
    assert all(largest < 0.6 * plain[gap] for (gap, method), largest in off.items() if method != "blendshapes")
    assert (tmp_path / row["values"]["widths"]).read_bytes().startswith(b"\x89PNG")


def test_a_frequency_that_a_rate_of_frames_cannot_show_is_refused(command, tmp_path):
    ended = command("animate", "conversation:1", "--fps", 3, "--dynamic", "--out", tmp_path)
    assert "frequency = 4 is outside" in ended.refusal()
