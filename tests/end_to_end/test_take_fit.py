"""`take fit`: moving meshes become a take that `animate` reads; what is wrong with them is one line."""

import json

import numpy as np
import pytest
import trimesh

from softdeca.lhm.expressions import index, read_take
from softdeca.lhm.head.file import save_head

FRAMES = 4


@pytest.fixture(scope="module")
def tracked(mean_head, tmp_path_factory):
    """A head's file, and the vertices (frames, n, 3) [mm] of an opening mouth and a smile; the first is neutral."""
    folder = tmp_path_factory.mktemp("tracked")
    save_head(folder / "head.npz", mean_head)
    weights = np.zeros((FRAMES, 52))
    weights[:, index("jawOpen")] = np.linspace(0.0, 0.6, FRAMES)
    weights[:, index("mouthSmileLeft")] = np.linspace(0.0, 0.9, FRAMES)
    frames = mean_head.skin.vertices + np.tensordot(weights, mean_head.rig.deltas.astype(float), axes=1)
    return folder, weights, frames


def write_meshes(folder, frames, triangles, suffix):
    folder.mkdir()
    for number, vertices in enumerate(frames):
        trimesh.Trimesh(vertices, triangles, process=False).export(folder / f"{number}.{suffix}")


def test_meshes_become_a_take_that_animates(tracked, mean_head, command, tmp_path):
    folder, weights, frames = tracked
    write_meshes(tmp_path / "meshes", frames, mean_head.skin.triangles, "ply")
    out = tmp_path / "take.csv"
    words = ("take", "fit", tmp_path / "meshes", "--head", folder / "head.npz", "--fps", 25, "--out", out)
    ended = command(*words)
    assert ended.status == 0, ended.errors
    summary, missing, wrote = ended.out.splitlines()
    assert summary.startswith("4 frames: residual ") and "tongueOut" in missing and wrote == f"wrote {out}"
    take = read_take(out)
    assert np.abs(take.weights - weights).max() < 1e-3 and take.rate == pytest.approx(25.0, rel=1e-6)
    told = json.loads(command(*words, "--json").out)
    assert told["frames"] == FRAMES and len(told["residuals_mm"]) == FRAMES and max(told["residuals_mm"]) < 1e-3
    row = next(line for line in out.read_text().splitlines() if line.startswith("residual mm,"))
    assert np.array(row.split(",")[1:], float) == pytest.approx(told["residuals_mm"], abs=1e-6)
    animated = command("animate", out, "--head", folder / "head.npz", "--accuracy", "none", "--preview", "none",
                       "--out", tmp_path / "out")  # fmt: skip
    assert animated.status == 0, animated.errors
    assert len((tmp_path / "out" / "log.jsonl").read_text().splitlines()) == FRAMES


def test_other_triangles_in_centimetres_are_registered(tracked, mean_head, command, tmp_path):
    folder, weights, frames = tracked
    triangles = mean_head.skin.triangles
    order = np.random.default_rng(0).permutation(frames.shape[1] + len(triangles))
    whole = np.concatenate([frames, frames[:, triangles].mean(axis=2)], axis=1)[:, order]
    middle = frames.shape[1] + np.arange(len(triangles))
    split = np.vstack([np.column_stack([triangles[:, k], triangles[:, k - 2], middle]) for k in range(3)])
    np.savez(tmp_path / "take.npz", vertices=0.1 * whole + 2.0, triangles=np.argsort(order)[split])
    words = ("take", "fit", tmp_path / "take.npz", "--head", folder / "head.npz", "--out", tmp_path / "take.csv")
    ended = command(*words, "--unit", "cm")
    assert ended.status == 0, ended.errors
    assert np.abs(read_take(tmp_path / "take.csv").weights - weights).max() < 1e-3
    assert "are its units off?" in command(*words).refusal()
