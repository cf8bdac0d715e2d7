"""Weights from moving meshes: in the head's own triangles and in others, its rotation removed, and back from a file."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.lhm import Surface, expressions, identities
from softdeca.lhm.base.files.mesh_sequence import read_mesh_sequence
from softdeca.lhm.base.geometry.warp import rigid_motion
from softdeca.lhm.expressions import TrackedFace, fit_take, index, read_take, write_take
from softdeca.lhm.head.file import save_head

from ..refusals import refused


@pytest.fixture(scope="module")
def shapes(mean_head):
    return mean_head.rig.deltas.astype(np.float64)


@pytest.fixture(scope="module")
def take():
    """Twelve frames of a conversation without a tongue, whose head turns by up to half a radian."""
    made = expressions.conversation_take(np.random.default_rng(0), 360, rate=30.0).part(slice(0, None, 30))
    turns = np.linspace(0.0, 1.0, len(made.times))[:, None] * [0.5, -0.3, 0.2]
    weights = np.where(np.arange(52) == index("tongueOut"), 0.0, made.weights)  # moves no skin
    return replace(made, weights=weights, rate=30.0, times=np.arange(len(turns)) / 30.0, head=turns)


def moving(skin, shapes, take):
    """The skin of a take, turned, shape (frames, n, 3) [mm]; it wanders by centimetres besides."""
    turns = expressions.rotations(take.head)
    posed = skin.vertices + np.tensordot(take.weights, shapes, axes=1)
    return posed @ turns.transpose(0, 2, 1) + 20.0 * np.sin(take.times)[:, None, None]


def in_other_triangles(surface, frames, seed=0):
    """The same surface with a vertex more in each triangle, all in another order, and its frames."""
    triangles, n = surface.triangles, len(surface.vertices)
    middle = n + np.arange(len(triangles))
    split = np.vstack([np.column_stack([triangles[:, k], triangles[:, k - 2], middle]) for k in range(3)])
    order = np.random.default_rng(seed).permutation(n + len(triangles))
    whole = np.concatenate([frames, frames[:, triangles].mean(axis=2)], axis=1)
    return np.argsort(order)[split], whole[:, order]


def test_a_take_comes_back_from_the_heads_own_triangles(mean_head, shapes, take):
    fitted = fit_take(TrackedFace.from_skin(mean_head.skin, shapes), moving(mean_head.skin, shapes, take), rate=30.0)
    assert np.abs(fitted.take.weights - take.weights).max() < 1e-4
    assert np.abs(fitted.take.head - take.head).max() < 1e-5
    np.testing.assert_allclose(fitted.take.times, take.times)
    assert fitted.residuals.shape == take.times.shape and fitted.residuals.max() < 1e-4
    assert fitted.take.missing == ("tongueOut",)


def test_a_take_comes_back_from_other_triangles(mean_head, shapes, take):
    frames = moving(mean_head.skin, shapes, take)
    elsewhere = Rotation.from_euler("yx", [0.1, 0.05]).as_matrix()
    first = mean_head.skin.vertices @ elsewhere.T + [15.0, -10.0, 30.0]
    triangles, frames = in_other_triangles(mean_head.skin, np.concatenate([first[None], frames]))
    face = TrackedFace.from_mesh(mean_head.skin, shapes, Surface(frames[0], triangles))
    fitted = fit_take(face, frames)
    assert fitted.take.weights[0].max() < 1e-3
    assert np.abs(fitted.take.weights[1:] - take.weights).max() < 1e-3 and fitted.residuals.max() < 1e-3


STRANGE = {
    "turned": lambda x: x * [-1, 1, -1],
    "mirrored": lambda x: x * [-1, 1, 1],
    "5 % too large": lambda x: 1.05 * x,
    "another person": lambda x: x + 4.0 * np.sin(x / 40.0),
}


@pytest.mark.parametrize("name", STRANGE)
def test_a_mesh_that_is_not_this_face_is_refused(mean_head, shapes, name):
    triangles, (first,) = in_other_triangles(mean_head.skin, mean_head.skin.vertices[None])
    refused("does not lie on the head's skin", TrackedFace.from_mesh, mean_head.skin, shapes,
            Surface(STRANGE[name](first), triangles))  # fmt: skip
    refused("no triangles", TrackedFace.from_mesh, mean_head.skin, shapes, Surface(first, triangles[:0]))
    if name != "turned":  # which of its own triangles is a turn of the head
        frames = [STRANGE[name](mean_head.skin.vertices)]
        refused("is it mirrored|another person", fit_take, TrackedFace.from_skin(mean_head.skin, shapes), frames)


def test_meshes_of_other_triangles_are_registered_by_the_frame_that_is_neutral(
    mean_head, shapes, take, command, tmp_path
):
    """Vertices are in another order; with flaws a triangle repeats one, and no triangle has the last, far off."""
    save_head(tmp_path / "head.npz", mean_head)
    order = np.random.default_rng(0).permutation(len(mean_head.skin.vertices))
    triangles = np.argsort(order)[mean_head.skin.triangles]
    at = 7  # the first frames speak and smile
    frames = np.insert(moving(mean_head.skin, shapes, take), at, mean_head.skin.vertices, axis=0)[:, order]
    far = np.full((len(frames), 1, 3), 1e5)
    for name, x, t in (("order", frames, triangles), ("flaws", np.append(frames, far, 1), [*triangles, [0, 0, 1]])):
        np.savez(tmp_path / f"{name}.npz", vertices=x, triangles=t)
        words = ("--head", tmp_path / "head.npz", "--out", tmp_path / "take.csv")
        ended = command("take", "fit", tmp_path / f"{name}.npz", *words)
        assert ended.status == 0 and f"frame {at} counts as neutral: " in "".join(ended.errors)
        found = np.delete(read_take(tmp_path / "take.csv").weights, at, axis=0)
        assert np.abs(found - take.weights).max() < 1e-3


def test_hair_is_left_out_of_a_registration(mean_head, shapes, take):
    triangles, frames = in_other_triangles(mean_head.skin, moving(mean_head.skin, shapes, take))
    triangles, rest = in_other_triangles(mean_head.skin, mean_head.skin.vertices[None])
    hair = Surface(0.2 * mean_head.skin.vertices + [0.0, 250.0, 0.0], mean_head.skin.triangles)
    first = np.vstack([rest[0], hair.vertices])
    mesh = Surface(first, np.vstack([triangles, hair.triangles + len(rest[0])]))
    face = TrackedFace.from_mesh(mean_head.skin, shapes, mesh)
    assert len(face.kept) == len(rest[0]) and face.count == len(first)
    wild = np.concatenate([frames, np.tile(17.0 * hair.vertices, (len(frames), 1, 1))], axis=1)
    fitted = fit_take(face, wild)
    assert np.abs(fitted.take.weights - take.weights).max() < 1e-3


def test_noise_moves_weights_little_and_is_told(mean_head, shapes, take):
    rng = np.random.default_rng(1)
    frames = moving(mean_head.skin, shapes, take)
    fitted = fit_take(TrackedFace.from_skin(mean_head.skin, shapes), frames + rng.normal(0.0, 0.2, frames.shape))
    visible = np.linalg.norm(shapes, axis=2).max(axis=1) > 3.0
    assert np.abs(fitted.take.weights - take.weights)[:, visible].mean() < 0.02
    # The noise has 0.2 mm on each axis.
    assert fitted.residuals == pytest.approx(0.2 * np.sqrt(3.0), rel=0.1)


def test_a_residual_is_what_no_weight_reaches(mean_head, shapes):
    far = mean_head.skin.vertices + 1.5 * shapes[index("jawOpen")]
    fitted = fit_take(TrackedFace.from_skin(mean_head.skin, shapes), [far])
    assert fitted.take.weights[0, index("jawOpen")] == 1.0 and fitted.residuals[0] > 0.5
    areas = mean_head.skin.vertex_areas / mean_head.skin.vertex_areas.sum()
    posed = mean_head.skin.vertices + np.tensordot(fitted.take.weights[0], shapes, axes=1)
    rotation, translation = rigid_motion(posed, far)
    away = far - posed @ rotation.T - translation
    assert fitted.residuals[0] == pytest.approx(np.sqrt(areas @ np.sum(away**2, axis=1)), rel=0.1)


@pytest.mark.parametrize("space", ["ict", "flame"])
def test_people_of_other_spaces_are_fitted_too(data, space, take):
    file = {"ict": "ict_facekit.npz", "flame": "flame.npz"}[space]
    if not (data / file).is_file():
        pytest.skip(f"no real data {file}: $SOFTDECA_DATA, or docs/architecture.md")
    people = identities.from_text(f"{space}:{data / file}")
    code = 0.5 * np.random.default_rng(3).normal(size=people.code_size)
    skin, shapes = people.skin(code), people.expression_deltas(code)
    visible = np.linalg.norm(shapes, axis=2).max(axis=1) > 1.0
    fitted = fit_take(TrackedFace.from_skin(skin, shapes), moving(skin, shapes, take)[:4])
    assert np.abs(fitted.take.weights - take.weights[:4])[:, visible].mean() < 0.02
    assert fitted.residuals.max() < 0.01


def test_a_take_is_written_as_it_is_read(take, tmp_path):
    lacking = replace(take, missing=("tongueOut",))
    write_take(tmp_path / "take.csv", lacking, {"residual mm": take.times})
    back = read_take(tmp_path / "take.csv")
    assert np.abs(back.weights - lacking.weights).max() < 1e-8 and np.abs(back.head - take.head).max() < 1e-7
    np.testing.assert_allclose(back.times, take.times, atol=1e-8)
    assert back.missing == ("tongueOut",) and back.rate == pytest.approx(30.0, rel=1e-6)


def write_obj(file, vertices, triangles):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist()]
    file.write_text("\n".join(lines) + "\n")


SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


def test_a_folder_of_meshes_is_read_by_the_numbers_in_names(tmp_path):
    for number in (2, 10, 1):
        write_obj(tmp_path / f"frame_{number}.obj", SQUARE + number, HALVES)
    (tmp_path / "notes.txt").write_text("not a mesh")
    (tmp_path / "._frame_1.obj").write_bytes(b"\0\5\26\7")  # of macOS
    (tmp_path / "folder.obj").mkdir()
    sequence = read_mesh_sequence(tmp_path, unit="cm")
    assert sequence.names == ("frame_1.obj", "frame_2.obj", "frame_10.obj") and len(sequence) == 3
    assert [frame[0, 0] for frame in sequence] == [10.0, 20.0, 100.0]
    np.testing.assert_array_equal(sequence.triangles, HALVES)


def test_vertices_over_time_are_read(tmp_path):
    frames = SQUARE + np.arange(3)[:, None, None]
    np.savez(tmp_path / "take.npz", vertices=frames, triangles=HALVES)
    sequence = read_mesh_sequence(tmp_path / "take.npz")
    np.testing.assert_array_equal(list(sequence), frames)
    np.testing.assert_array_equal(sequence.triangles, HALVES)
    np.savez(tmp_path / "bare.npz", vertices=frames)
    assert read_mesh_sequence(tmp_path / "bare.npz").triangles is None
