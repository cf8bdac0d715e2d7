"""Frames in their order: statics forget the past, dynamics keep it; a state, or a run's velocities, let one go on."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.sparse import identity
from scipy.spatial.transform import Rotation

from softdeca.lhm import LayeredHead, Surface
from softdeca.reference import Face, Parameters, Sequence, solve
from softdeca.reference.face.facial import facial_scene
from softdeca.reference.face.sequence import Velocities, is_plausible

STEP = 1 / 60
# Soft tissue under stiff springs: the skin moves nearly as Eq. 9 alone does.
STIFF, LOOSE = Parameters(target_stiffness=30.0, soft_stiffness=1.0, skin_stiffness=5.0, volume_ratio=5.0), Parameters()


def under(head, parameters, **choices):
    """A face that settles to a millionth of its first gradient, and is asked for skins alone."""
    return Face(head, parameters=parameters, per="wraps", choices=choices, settling={})


@pytest.fixture(scope="module")
def small_sphere():
    """A head of 42-vertex wraps."""
    sphere = trimesh.creation.icosphere(1)
    wraps = [Surface(radius * sphere.vertices, sphere.faces) for radius in (100.0, 92.0, 85.0)]
    ones = identity(42, format="csr")
    return LayeredHead(wraps[0], *wraps, np.where(sphere.vertices[:, 1] > 0, 1, 0), ones, ones)


def talk(head, frames):
    """A lower half that swings open and shut, with a side to side motion, [mm], (frames, n, 3)."""
    x = head.skin.vertices
    low = np.clip(-x[:, 1] / 100, 0, 1)[:, None]
    t = np.arange(frames)[:, None, None] / 10
    return x + low * (np.sin(t) ** 2 * np.array([0.0, -6.0, 1.0]) + np.sin(2 * t) * np.array([2.0, 0, 0]))


@pytest.mark.parametrize("bones", ["prescribed", "rigid"])
def test_static_frames_do_not_depend_on_their_order(sphere_head, bones):
    frames = talk(sphere_head, 6)
    onward, backward = (Sequence(under(sphere_head, LOOSE, bones=bones), tolerance=1e-9) for _ in range(2))
    there = [onward.frame(s).positions for s in frames]
    back = [backward.frame(s).positions for s in frames[::-1]][::-1]
    alone = solve(facial_scene(sphere_head, LOOSE, frames[3], bones=bones), tolerance=1e-11).positions
    assert np.abs(np.array(there) - np.array(back)).max() < 1e-6
    assert np.abs(there[3] - alone).max() < 1e-6
    assert np.abs(there[3] - there[2]).max() > 0.1


def test_a_frame_that_repeats_costs_next_to_nothing_and_a_near_one_few(sphere_head):
    frames = talk(sphere_head, 20)
    sequence = Sequence(under(sphere_head, LOOSE))
    cold = sequence.frame(frames[8]).iterations
    again = sequence.frame(frames[8])
    warm = sequence.frame(frames[9]).iterations
    assert again.converged and again.iterations <= 1
    assert 0 < warm < 0.85 * cold


def test_the_same_is_asked_of_every_frame(sphere_head):
    """The bound is 2.5e-5 of the force of skin 1 mm off its target, whatever a frame starts from."""
    sequence = Sequence(under(sphere_head, LOOSE))
    bound = 2.5e-5 * np.linalg.norm(LOOSE.target_stiffness * sphere_head.skin_wrap.vertex_areas)
    for s in talk(sphere_head, 6)[1:]:
        norms = sequence.frame(s).history.gradient_norm
        assert norms[-1] <= bound < norms[0]


def test_dynamics_at_rest_are_statics_for_any_gamma(sphere_head):
    """The dynamic frame that has come to rest minimises the static energy, and moves no more."""
    smile = talk(sphere_head, 8)[7]
    still = solve(facial_scene(sphere_head, LOOSE, smile), tolerance=1e-11).positions
    for f, zeta in itertools.product((2.0, 8.0), (0.1, 0.7)):
        p = Parameters(frequency=f, damping=zeta)
        sequence = Sequence(under(sphere_head, p), time_step=STEP, dynamic=True, tolerance=1e-9)
        sequence.begin(smile)
        for _ in range(3):
            assert np.abs(sequence.frame(smile).positions - still).max() < 1e-6
    p = Parameters(frequency=4.0, damping=0.7)
    sequence = Sequence(under(sphere_head, p), time_step=STEP, dynamic=True, tolerance=1e-9)
    sequence.begin(sphere_head.skin.vertices)
    moving = [sequence.frame(smile).positions for _ in range(60)]
    assert np.abs(moving[0] - still).max() > 1
    assert np.abs(moving[-1] - still).max() < 1e-5


@pytest.mark.parametrize(("frequency", "damping"), [(3.0, 0.1), (8.0, 0.3)])
def test_a_released_skin_swings_at_its_frequency_and_tissue_damps_it(sphere_head, frequency, damping):
    """The poles of the whole: z² - 2αs z + βs = 0 with s = 1 / (1 + γK/k), K the tissue's stiffness in that motion.

    s is measured from one static solve; the motion's own poles are fitted to what is simulated.
    """
    p = Parameters(frequency=frequency, damping=damping, target_stiffness=30.0)
    rest = sphere_head.skin.vertices
    pulled = rest + 0.05 * np.clip(-rest[:, 1:2] / 100, 0, 1) * np.array([1.0, 0, 0])
    sequence = Sequence(under(sphere_head, p, bones="rigid"), time_step=STEP, dynamic=True, tolerance=1e-9)
    sequence.begin(pulled)
    n = len(rest)
    held = sequence.state.positions[:n] - rest
    frames = np.array([sequence.frame(rest).positions[:n] - rest for _ in range(25)])
    # A motion of several tissue modes; its share along the first displacement follows the recurrence of its mean s.
    motion = np.concatenate([[1.0, 1.0], np.tensordot(frames, held, axes=2) / (held**2).sum()])
    (two_alpha_s, beta_s), *_ = np.linalg.lstsq(np.stack([motion[1:-1], -motion[:-2]], axis=1), motion[2:], rcond=None)
    recurrence = sequence.recurrence
    s = beta_s / recurrence.beta
    assert two_alpha_s / (2 * recurrence.alpha) == pytest.approx(s, abs=0.01)
    followed = (held * (pulled - rest)).sum() / ((pulled - rest) ** 2).sum()  # k / (k + K)
    assert s == pytest.approx(1 / (1 + recurrence.gamma * (1 / followed - 1)), abs=0.02)


@pytest.mark.parametrize("dynamic", [False, True])
def test_a_state_is_all_that_is_needed_to_go_on(sphere_head, dynamic):
    frames = talk(sphere_head, 8)
    whole, first, second = (Sequence(under(sphere_head, LOOSE), dynamic=dynamic) for _ in range(3))
    expected = [whole.frame(s).positions for s in frames]
    for s in frames[:4]:
        first.frame(s)
    second.state = first.state
    found = [second.frame(s).positions for s in frames[4:]]
    assert np.array_equal(found, expected[4:])


def test_dynamics_may_vary_over_the_face(sphere_head):
    """The left half is given 2 Hz and the right 8 Hz: released, the right returns first."""
    wrap = sphere_head.skin_wrap
    left = wrap.vertices[wrap.triangles].mean(axis=1)[:, 0] > 0
    p = Parameters(frequency=np.where(left, 2.0, 8.0), damping=0.7)
    sequence = Sequence(under(sphere_head, p), dynamic=True)
    pulled = sphere_head.skin.vertices * [1.0, 1.0, 1.03]
    sequence.begin(pulled)
    start = sequence.state.positions[: len(left) // 2 + 2] - wrap.vertices
    for _ in range(3):
        positions = sequence.frame(sphere_head.skin.vertices).positions[: len(wrap.vertices)]
    kept = np.linalg.norm(positions - wrap.vertices, axis=1) / np.maximum(np.linalg.norm(start, axis=1), 0.2)
    far = np.linalg.norm(start, axis=1) > 1
    assert np.median(kept[far & (wrap.vertices[:, 0] > 30)]) > 2 * np.median(kept[far & (wrap.vertices[:, 0] < -30)])


@pytest.mark.parametrize(
    ("frequency", "damping", "frames"), [(2.0, 0.1, 512), (8.0, 0.1, 512), (2.0, 0.7, 128), (8.0, 0.7, 128)]
)
def test_frames_at_the_corners_of_the_range_stay_bounded(small_sphere, frequency, damping, frames):
    """Expressions that jump every few frames, near resonance, for nine seconds: no growth from half to half.

    Of the well damped, whose swings die within ten frames, a quarter of that.
    """
    p = Parameters(frequency=frequency, damping=damping)
    sequence = Sequence(under(small_sphere, p), time_step=STEP, dynamic=True, tolerance=1e-3)
    rest, n = small_sphere.skin.vertices, len(small_sphere.bone)
    low = np.clip(-rest[:, 1:2] / 100, 0, 1)
    half_period = max(1, round(30 / frequency))
    sizes = []
    for k in range(frames):
        sign = 1 if (k // half_period) % 2 else -1
        solution = sequence.frame(rest + sign * low * [2.0, 1.0, 0.0])
        assert solution.converged, f"frame {k}: {solution.reason}"
        sizes.append(np.abs(solution.positions[:n] - rest).max())
    halves = np.max(np.reshape(sizes, (2, -1)), axis=1)
    assert 1.0 < halves[0] < 20.0 and halves[1] < 1.05 * halves[0]


@pytest.mark.parametrize("bones", ["prescribed", "rigid"])
def test_frames_of_a_settled_face_are_those_of_its_scenes(sphere_head, bones):
    """Expressions are those of the head without p, the answers those that the settled scene has alone."""
    p = Parameters(soft_volume=1.4, mandible_scale_y=1.1, gravity=2.0)
    face = under(sphere_head, p, bones=bones)
    neutral = face.settled()
    frames = talk(sphere_head, 4)
    sequence = Sequence(face, tolerance=1e-9)
    for s in frames:
        solution = sequence.frame(s)
        alone = solve(face.expression_scene(s), start=neutral.positions, tolerance=1e-10).positions
        assert np.abs(solution.positions - alone).max() < 1e-6
    n = len(sphere_head.bone)
    assert np.abs(neutral.displacement).max() > 0.5
    assert sequence.skin(s, solution) == pytest.approx(solution.positions[:n], abs=1e-9)  # skin and wrap are one here


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


def test_a_run_gives_what_a_sequence_begins_with(sphere_head):
    """The velocity of a run's frame k lets a new sequence, at rest where that frame was, move on likewise."""
    x = sphere_head.skin.vertices
    low = np.clip(-x[:, 1:2] / 100, 0, 1)
    targets = [x + np.sin(0.3 * k) ** 2 * low * [0.0, -6.0, 1.0] for k in range(8)]
    one, other = (Sequence(under(sphere_head, Parameters(), bones="prescribed"), dynamic=True) for _ in range(2))
    found = Velocities.from_sequence(one, targets)
    skins = [other.skin(s, other.frame(s)) for s in targets]
    assert len(found) == 7
    assert found.on(sphere_head, 4) == pytest.approx((skins[5] - skins[4]) / STEP, abs=1e-2)
    assert np.abs(found.on(sphere_head, 4)).max() > 20.0
    begun = Sequence(under(sphere_head, Parameters(), bones="prescribed"), dynamic=True)
    begun.begin(targets[5], velocity=found.on(sphere_head, 4))
    state = begun.state
    carried = state.positions[: len(x)] - state.before
    assert carried == pytest.approx(skins[5] - skins[4], abs=1e-4)


def test_a_wild_velocity_is_told(sphere_head):
    slow = np.zeros_like(sphere_head.skin.vertices)
    slow[7] = [0.0, 224.0, 0.0]  # 59.7 mm in 16 frames
    assert is_plausible(slow, STEP)
    assert not is_plausible(1.01 * slow, STEP)
    assert is_plausible(1.01 * slow, STEP, frames=15)
