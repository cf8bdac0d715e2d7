"""Velocities of a run: differences of frames, carried in each vertex' frame and by size, told where they are wild."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.lhm import InputError, Surface
from softdeca.reference import Parameters, Sequence
from softdeca.reference.face.sequence import Velocities, is_plausible, vertex_frames

STEP = 1 / 60


def moved(head, rotation, scale):
    """The head turned and scaled."""
    wraps = {
        name: Surface(scale * getattr(head, name).vertices @ rotation.T, getattr(head, name).triangles)
        for name in ("skin", "skin_wrap", "muscle_wrap", "skull_wrap")
    }
    return replace(head, **wraps)


def test_a_head_turned_and_scaled_moves_in_its_own_directions_and_size(sphere_head):
    rng = np.random.default_rng(0)
    skins = sphere_head.skin.vertices + rng.normal(size=(4, *sphere_head.skin.vertices.shape))
    found = Velocities.from_skins(sphere_head, skins, STEP)
    assert len(found) == 3
    rotation = Rotation.from_euler("xyz", [20, 130, -40], degrees=True).as_matrix()
    for k in range(3):
        there = (skins[k + 1] - skins[k]) / STEP
        assert found.on(sphere_head, k) == pytest.approx(there, abs=1e-3)  # stored with 24 bits
        assert found.on(moved(sphere_head, rotation, 0.8), k) == pytest.approx(0.8 * there @ rotation.T, abs=1e-3)


def test_vertex_frames_are_rotations_with_the_normal_last(sphere_head):
    skin = sphere_head.skin
    lonely = Surface(np.vstack([skin.vertices, [0.0, 0, 0]]), skin.triangles)
    frames = vertex_frames(lonely)
    assert np.einsum("nij,nik->njk", frames, frames) == pytest.approx(np.broadcast_to(np.eye(3), frames.shape))
    assert np.linalg.det(frames) == pytest.approx(np.ones(len(frames)))
    assert frames[:-1, :, 2] == pytest.approx(skin.vertex_normals)
    assert np.array_equal(frames[-1], np.eye(3))


def test_a_run_gives_what_a_sequence_begins_with(sphere_head):
    """The velocity of a run's frame k lets a new sequence, at rest where that frame was, move on likewise."""
    x = sphere_head.skin.vertices
    low = np.clip(-x[:, 1:2] / 100, 0, 1)
    targets = [x + np.sin(0.3 * k) ** 2 * low * [0.0, -6.0, 1.0] for k in range(8)]
    one, other = (Sequence(sphere_head, Parameters(), dynamic=True, bones="prescribed") for _ in range(2))
    found = Velocities.from_sequence(one, targets)
    skins = [other.skin(s, other.frame(s)) for s in targets]
    assert len(found) == 7
    assert found.on(sphere_head, 4) == pytest.approx((skins[5] - skins[4]) / STEP, abs=1e-2)
    assert np.abs(found.on(sphere_head, 4)).max() > 20.0
    begun = Sequence(sphere_head, Parameters(), dynamic=True, bones="prescribed")
    begun.begin(targets[5], velocity=found.on(sphere_head, 4))
    state = begun.state
    carried = state.positions[: len(x)] - state.before
    assert carried == pytest.approx(skins[5] - skins[4], abs=1e-4)


def test_frames_without_an_answer_have_no_velocity(sphere_head):
    x = sphere_head.skin.vertices
    found = Velocities.from_skins(sphere_head, [x, x + 1, None, x + 9, x + 11], 1.0)
    assert len(found) == 2
    assert found.on(sphere_head, 1) == pytest.approx(np.full(x.shape, 2.0), abs=1e-4)


def test_a_wild_velocity_is_told(sphere_head):
    slow = np.zeros_like(sphere_head.skin.vertices)
    slow[7] = [0.0, 224.0, 0.0]  # 59.7 mm in 16 frames
    assert is_plausible(slow, STEP)
    assert not is_plausible(1.01 * slow, STEP)
    assert is_plausible(1.01 * slow, STEP, frames=15)


def test_what_velocities_cannot_do_is_said(sphere_head, spheres):
    x = sphere_head.skin.vertices
    found = Velocities.from_skins(sphere_head, [x, x], STEP)
    with pytest.raises(InputError, match="velocity 1: there are 1"):
        found.on(sphere_head, 1)
    with pytest.raises(InputError, match="velocities: of a skin of 162 vertices, not 42"):
        found.on(spheres(1), 0)
    with pytest.raises(InputError, match="two frames in a row"):
        Velocities.from_skins(sphere_head, [x, None, x], STEP)
    with pytest.raises(InputError, match="expected a dynamic sequence"):
        Velocities.from_sequence(Sequence(sphere_head, Parameters()), [x, x])
