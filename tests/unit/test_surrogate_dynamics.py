"""The surrogate's dynamics (Eq. 21): rest, shifts, stability, frequency, beside the simulator's own."""

import numpy as np
import pytest

from softdeca.lhm import expressions
from softdeca.reference import Face, Parameters, Sequence
from softdeca.surrogate import METHODS
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.spheres import Spheres
from softdeca.surrogate.rigs.inertia import Looseness

from ..rig_files import parse_glb, read_glb

SPACE = Spheres(1)
N = len(SPACE.mean.vertices)
P = Parameters(soft_volume=1.2, frequency=4.0, damping=0.3)


def shapes():
    return SPACE.expression_deltas(np.zeros(SPACE.code_size))


@pytest.fixture(scope="module")
def head():
    return SPACE.fit(SPACE.mean)


@pytest.fixture(scope="module")
def rig(head):
    return METHODS["derivatives"].bind(Face(head, shapes(), P))


def test_frames_follow_the_simulators(head, rig):
    weights, moving = np.zeros((16, 52)), rig.dynamic(1 / 60)
    weights[:, 7] = 0.5 * np.sin(np.arange(16) / 3) ** 2
    simulated = Sequence(Face(head, parameters=P, settling={}), dynamic=True)
    static, dynamic = [], []
    for w in weights:
        targets = SPACE.mean.vertices + np.tensordot(w, shapes(), axes=1)
        truth = simulated.skin(targets, simulated.frame(targets))
        static.append(np.abs(rig.frame(w) - truth).max())
        dynamic.append(np.abs(moving.frame(w) - truth).max())
    assert max(static) > 0.5 and max(dynamic) < 0.1 * max(static)


def test_a_turning_head_shakes_the_face_as_in_simulation(head, rig):
    simulated, moving, still = (
        Sequence(Face(head, parameters=P, settling={}), dynamic=True),
        rig.dynamic(),
        np.zeros(52),
    )
    bases = expressions.rotations(np.stack([0.2 * np.sin(np.arange(12) / 4), np.zeros(12), np.zeros(12)], axis=1))
    simulated.begin(SPACE.mean.vertices, base=bases[0])
    moving.begin(still, base=bases[0])
    largest, off = 0.0, 0.0
    for base in bases:
        truth = simulated.skin(SPACE.mean.vertices, simulated.frame(SPACE.mean.vertices, base=base))
        off = max(off, np.abs(moving.frame(still, base=base) - truth).max())
        largest = max(largest, np.abs(truth - rig.neutral).max())
    assert largest > 0.5 and off < 0.05 * largest


def test_rest_is_kept_to_the_bit(rig):
    moving, weights = rig.dynamic(), np.linspace(0.0, 0.4, 52)
    first = moving.frame(weights)
    for _ in range(100):
        assert np.array_equal(moving.frame(weights), first)
    assert np.array_equal(first, rig.frame(weights))


def test_a_free_face_swings_at_ps_frequency(rig):
    """Without a change of w, a velocity makes an oscillation of 4 Hz whose peaks fall by 0.3."""
    moving, weights = rig.dynamic(1 / 240), np.zeros(52)
    moving.begin(weights, velocity=np.full((N, 3), 100.0))
    away = np.array([(moving.frame(weights) - rig.neutral)[0, 0] for _ in range(240)])
    crossings = np.flatnonzero(np.diff(np.sign(away)))
    assert 240 / np.diff(crossings)[:2].mean() / 2 == pytest.approx(4.0 * np.sqrt(1 - 0.3**2), rel=0.06)
    ratio = np.abs(away[crossings[0] : crossings[1]]).max() / np.abs(away[: crossings[0]]).max()
    assert ratio == pytest.approx(np.exp(-np.pi * 0.3 / np.sqrt(1 - 0.3**2)), rel=0.05)


def test_looseness_of_people_is_linear_in_their_code(head):
    people = OfSpace(SPACE, SPACE.mean, SPACE.fit)
    found = Looseness.from_people(people, count=12)
    shares, pivot = found.predict(np.zeros(SPACE.code_size))
    # A sphere without regions is loose everywhere, and turns about its middle.
    assert shares == pytest.approx(np.ones(N)) and np.abs(pivot).max() < 2.0
    assert found.shares.shape == (1 + SPACE.code_size, N)


def test_a_baked_rig_as_gltf_plays_the_take(rig, tmp_path):
    weights = 0.5 * np.random.default_rng(0).random((6, 52))
    baked = rig.bake(40)
    baked.write_gltf(tmp_path / "rig.glb", expressions.Take(weights, 60.0, np.arange(6) / 60))
    about, array = parse_glb(tmp_path / "rig.glb")
    surfaces, notes = read_glb(tmp_path / "rig.glb")
    assert notes == {"greatest_error_mm": baked.largest_error}
    played = array(about["animations"][0]["samplers"][0]["output"]).reshape(6, -1)
    assert np.abs(played).max() <= 1.0 + 1e-6
    for w, mixed in zip(weights, played, strict=True):
        assert surfaces["rig"].frame(mixed) == pytest.approx(baked.frame(w), abs=1e-3)
