"""Eq. 9's recurrence, where a face is loose, and a head that turns while its face moves."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from softdeca.lhm import expressions
from softdeca.lhm.head.flesh import flesh_share
from softdeca.reference import Face, Parameters, Sequence, facial_scene, solve
from softdeca.reference.face.dynamics import (
    CLOSE,
    DEEP,
    RING,
    Recurrence,
    base_lag,
    extrapolate_turns,
    find_pivot,
    measure_looseness,
    turn_skin,
)

STEP = 1 / 60
from_oscillator, from_implicit_euler = Recurrence.from_oscillator, Recurrence.from_implicit_euler
RANGE = [(Parameters.info(n).low, Parameters.info(n).high) for n in ("frequency", "damping")]
CORNERS = list(itertools.product(*RANGE))


def rolled(recurrence, targets, last, before):
    """The recurrence alone, without tissue."""
    frames = [before, last]
    for target in targets:
        frames.append(recurrence.target(target, frames[-1], frames[-2]))
    return np.array(frames[2:])


def test_the_free_skin_passes_through_the_continuous_motion_at_any_frame_rate():
    """The poles are exact, so samples at 24 Hz lie on those at 240 Hz."""
    f, zeta = 4.0, 0.3
    omega, turn = 2 * np.pi * f, 2 * np.pi * f * np.sqrt(1 - zeta**2)

    def exact(t):
        return np.exp(-zeta * omega * t) * np.cos(turn * t) * np.ones((1, 3))

    for rate in (24, 60, 240):
        times = np.arange(1, rate) / rate
        found = rolled(from_oscillator(f, zeta, 1 / rate), np.zeros((len(times), 1, 3)), exact(0), exact(-1 / rate))
        assert found == pytest.approx(np.array([exact(t) for t in times]), abs=1e-12)


def test_skin_that_is_loose_in_part_swings_faster_and_nearer_to_critical_until_it_only_follows():
    """At a share s: frequency f/s, damping 1 - s (1 - ζ); at 1 what it was to the bit, at 0 the target itself."""
    share = np.array([1.0, 0.5, 0.25])
    found = from_oscillator(4.0, 0.3, STEP / 8, loose=share)  # at 480 Hz 16 Hz is well resolved
    frequency, damping = found.oscillation(STEP / 8)
    assert frequency == pytest.approx([4.0, 8.0, 16.0], rel=1e-9)
    assert damping == pytest.approx([0.3, 0.65, 0.825], rel=1e-9)
    whole, none = (
        from_oscillator(4.0, 0.3, STEP),
        from_oscillator(4.0, 0.3, STEP, loose=np.array([1.0, 0.0])),
    )
    assert none.alpha[0] == whole.alpha and none.beta[0] == whole.beta and none.gamma[0] == whole.gamma
    assert (none.alpha[1], none.beta[1], none.gamma[1]) == (0.0, 0.0, 1.0)


@pytest.mark.parametrize("rate", [24.0, 30.0, 60.0])
def test_no_share_makes_the_recurrence_unstable_and_a_target_that_moves_evenly_is_followed_behind(rate):
    """The lag is 2 (α - β) / γ frames at every corner of p's range, and none where nothing is loose."""
    share = np.linspace(0.0, 1.0, 201)
    for f, zeta in CORNERS:
        found = from_oscillator(f, zeta, 1 / rate, loose=share)  # Recurrence itself refuses what grows or drifts
        assert np.abs(found.gamma + 2 * found.alpha - found.beta - 1).max() < 1e-14
        lag = 2 * (found.alpha - found.beta) / found.gamma
        assert lag[0] == 0.0
        even = np.arange(600)[:, None, None] * np.ones((201, 3))
        ends = rolled(found, even, *np.zeros((2, 201, 3)))[-1, :, 0]
        assert 599 - ends == pytest.approx(lag, abs=1e-3)


@pytest.fixture(scope="module")
def default(anny, mean_head):
    """The mean head and its expressions."""
    return mean_head, anny.expression_deltas(np.zeros(anny.code_size))


def test_lips_lids_and_skin_close_to_bone_follow_and_cheeks_are_loose(default):
    head, _ = default
    x, share = head.skin_wrap.vertices, measure_looseness(head)
    bone = cdist(x, head.skull_wrap.vertices[head.bone != 0]).min(axis=1)
    assert np.all(share[head.regions["lips"] | head.regions["lids"] | (bone <= CLOSE)] == 0.0)
    assert share.min() >= 0.0 and share.max() == 1.0
    assert np.all(bone[share > 0.99] > 0.9 * DEEP)
    middle = x[head.regions["lips"]].mean(axis=0)
    beside = head.regions["face"] & (np.abs(np.abs(x[:, 0] - middle[0]) - 45) < 8) & (np.abs(x[:, 1] - middle[1]) < 12)
    assert beside.any() and np.median(share[beside]) > 0.7


def test_the_recurrence_of_a_head_is_one_call(default, sphere_head):
    head, _ = default
    p = Parameters(frequency=3.0, damping=0.2)
    found, share = Recurrence.from_head(head, p, STEP), measure_looseness(head)
    uniform = from_oscillator(3.0, 0.2, STEP)
    flesh, follows = share == 1.0, share == 0.0
    assert flesh.any() and np.all(found.alpha[flesh] == uniform.alpha) and np.all(found.beta[flesh] == uniform.beta)
    assert np.all(found.gamma[follows] == 1.0) and np.all(found.alpha[follows] == 0.0)
    skin = found.average(head.skin_from_wrap)
    assert skin.gamma.shape == (len(head.skin.vertices),)
    everywhere = Recurrence.from_head(sphere_head, p, STEP)  # without regions
    assert np.ptp(everywhere.gamma) == 0.0 and everywhere.gamma[0] == uniform.gamma


def test_without_bone_all_flesh_is_loose(default):
    head, _ = default
    boneless = replace(head, bone=np.zeros_like(head.bone))
    loose, whole = measure_looseness(boneless), measure_looseness(head)
    assert np.array_equal(loose, flesh_share(head, fade=RING))
    assert np.all(loose >= whole) and loose.sum() > 1.2 * whole.sum()


def test_closed_lips_of_fast_speech_stay_closed(default):
    """Within 1 mm of statics wherever those have them closed; with one frequency everywhere they miss it by far."""
    head, deltas = default
    take = expressions.speech("Bob, pop my puppy.", pace=18.0)
    frames = [head.skin.vertices + np.tensordot(w, deltas, axes=1) for w in take.weights[10:28]]
    still, lagging, uniform = (Sequence(Face(head), dynamic=d, tolerance=1e-4) for d in (False, True, True))
    uniform.recurrence = from_oscillator(4.0, 0.3, STEP)
    n = len(head.bone)
    lips = np.flatnonzero(head.regions["lips"])
    below = (head.wrap_from_skin @ deltas[expressions.index("jawOpen")])[lips, 1]
    upper, lower = lips[below > 0.5 * below.min()], lips[below <= 0.5 * below.min()]

    def moved(sequence):
        return np.array([sequence.frame(s).positions[:n] for s in frames])

    def apart(skins):
        return np.array([cdist(x[upper], x[lower]).min(axis=1).mean() for x in skins])

    skins, now, before = moved(still), moved(lagging), moved(uniform)
    closed = apart(skins) < apart(skins).min() + 1.0
    assert 3 < closed.sum() < len(frames)
    off = [np.linalg.norm(x[closed][:, lips] - skins[closed][:, lips], axis=2).max() for x in (now, before)]
    assert off[0] < 1.0 and off[1] > 4.0
    cheeks = measure_looseness(head) > 0.9
    assert np.linalg.norm(now[:, cheeks] - skins[:, cheeks], axis=2).max() > 1.0


P = Parameters(target_stiffness=30.0, soft_stiffness=1.0, skin_stiffness=5.0, volume_ratio=5.0)


def nod(times):
    """A head that nods, shakes and tilts by some twenty degrees, shape (times, 3, 3)."""
    t = np.asarray(times)
    angles = [0.3 * np.sin(9 * t), 0.25 * np.sin(6 * t + 1), 0.1 * np.cos(5 * t)]
    return Rotation.from_euler("yxz", np.stack(angles, axis=-1)).as_matrix()


def spin(rate, frames):
    """A head that turns evenly [rad/s] about y, shape (frames, 3, 3)."""
    return Rotation.from_rotvec(np.arange(frames)[:, None] * STEP * rate * np.array([0.0, 1.0, 0.0])).as_matrix()


def rolled_turning(recurrence, targets, rotations, last, before):
    """The recurrence alone, without tissue; rotations begin two frames before the targets."""
    frames = [before, last]
    for k, target in enumerate(targets):
        behind = base_lag(rotations[k + 2], frames[-1], frames[-2], rotations[k : k + 2])
        sought = recurrence.target(target, frames[-1], frames[-2])
        frames.append(sought if behind is None else sought + recurrence.driven_by(behind))
    return np.array(frames[2:])


def test_a_mass_on_a_spring_in_the_room_is_where_the_head_has_it():
    """Implicit Euler of a mass whose spring's other end the head carries: (k R S + m/h² (2 x₁ - x₂)) / (k + m/h²)."""
    rng = np.random.default_rng(0)
    f, rotations = rng.uniform(2, 8, 5), nod(np.arange(42) * STEP)
    s = 80 * rng.normal(size=(40, 5, 3))
    x = [s[0] @ rotations[0].T, s[0] @ rotations[1].T + 0.3]
    stiff = (2 * np.pi * f * STEP)[:, None] ** 2
    for target, base in zip(s, rotations[2:], strict=True):
        x.append((stiff * target @ base.T + 2 * x[-1] - x[-2]) / (stiff + 1))
    inside = np.einsum("fni,fij->fnj", x, rotations)
    found = rolled_turning(from_implicit_euler(f, STEP), s, rotations, inside[1], inside[0])
    assert found == pytest.approx(inside[2:], abs=1e-9)
    without = rolled_turning(from_implicit_euler(f, STEP), s, np.stack([np.eye(3)] * 42), inside[1], inside[0])
    assert np.abs(without - inside[2:]).max() > 5.0


def test_the_motion_nears_that_of_the_differential_equation_as_frames_come_closer():
    """x'' = -ω² (x - R S) - 2ζω (x' - R' Rᵀ x) in the room, integrated by Dormand-Prince."""
    f, zeta, rest = 4.0, 0.3, np.array([20.0, 60.0, 90.0])
    omega = 2 * np.pi * f

    def force(t, z):
        base, speed = nod(t), (nod(t + 1e-6) - nod(t - 1e-6)) / 2e-6
        dragged = speed @ base.T @ z[:3]
        return np.r_[z[3:], -(omega**2) * (z[:3] - base @ rest) - 2 * zeta * omega * (z[3:] - dragged)]

    start, off = nod(0.0) @ rest, []
    moving = (nod(1e-6) - nod(-1e-6)) / 2e-6 @ rest
    ends = nod(1.0).T @ solve_ivp(force, (0, 1), np.r_[start, moving], method="DOP853", rtol=1e-9, atol=1e-9).y[:3, -1]
    assert np.linalg.norm(ends - rest) > 1.0
    for rate in (60, 120, 240, 480):
        rotations = nod(np.arange(-1, rate + 1) / rate)
        end = rolled_turning(
            from_oscillator(f, zeta, 1 / rate), [rest[None]] * rate, rotations, rest[None], rest[None]
        )[-1, 0]
        off.append(np.linalg.norm(end - ends))
    assert np.log2(off[:-1]) - np.log2(off[1:]) == pytest.approx([1.0, 1.0, 1.0], abs=0.25)


def test_a_spun_face_rests_where_statics_have_it_with_targets_that_fly_out(sphere_head):
    """At rest D = -(1 - Qᵀ)² y of one frame's turn Q; the answer minimises the static energy for S + D/(ωh)²."""
    p, rotations = replace(P, frequency=3.0, damping=0.5), spin(4.0, 80)
    rest, middle = sphere_head.skin.vertices, find_pivot(sphere_head)
    sequence = Sequence(Face(sphere_head, parameters=p), dynamic=True, tolerance=1e-8)
    sequence.begin(rest, base=extrapolate_turns(rotations))
    for base in rotations:
        moved = sequence.frame(rest, base=base).positions
    skin = moved[: len(rest)]
    once = np.eye(3) - rotations[1].T
    aside = -(skin - middle) @ (once @ once).T / (2 * np.pi * 3.0 * STEP) ** 2
    alone = solve(facial_scene(sphere_head, p, rest + aside), start=moved, tolerance=1e-10)
    assert np.abs(moved - alone.positions).max() < 5e-4
    still = solve(facial_scene(sphere_head, p, rest), tolerance=1e-10)
    assert np.abs(moved - still.positions).max() > 1.0


def test_a_head_that_does_not_turn_has_the_frames_it_had_to_the_bit(sphere_head):
    x, leant = sphere_head.skin.vertices, nod(0.2)
    frames = [x + np.sin(0.4 * k) * np.clip(-x[:, 1:2] / 100, 0, 1) * [0.0, -5.0, 2.0] for k in range(5)]
    plain, upright, leaning = (Sequence(Face(sphere_head, parameters=P), dynamic=True) for _ in range(3))
    for s in frames:
        expected = plain.frame(s).positions
        assert np.array_equal(upright.frame(s, base=np.eye(3)).positions, expected)
        assert np.array_equal(leaning.frame(s, base=leant).positions, expected)
    kept, told = (Sequence(Face(sphere_head, parameters=P), dynamic=True) for _ in range(2))
    for k, s in enumerate(frames):
        told.frame(s, base=nod(0.1 * min(k, 2)))
        kept.frame(s, base=nod(0.1 * k) if k < 3 else None)  # left out, it stays as it was
    assert np.array_equal(kept.state.positions, told.state.positions)
    assert np.abs(told.state.positions - plain.state.positions).max() > 0.5


def test_a_motion_goes_on_into_its_first_frame(sphere_head):
    """Begun as if at rest, a head that turns already is jerked: skin is thrown back by far more than it flies out."""
    x, rotations = sphere_head.skin.vertices, spin(1.5, 9)
    assert extrapolate_turns(rotations[2:]) == pytest.approx(rotations[:2], abs=1e-12)
    assert np.array_equal(extrapolate_turns(rotations[4:5]), rotations[[4, 4]])
    thrown = []
    for begun in (extrapolate_turns(rotations), rotations[0]):
        sequence = Sequence(Face(sphere_head, parameters=P), dynamic=True)
        start = sequence.begin(x, base=begun).positions
        thrown.append(max(np.abs(sequence.frame(x, base=base).positions - start).max() for base in rotations))
    assert 0.1 < thrown[0] < 0.35 * thrown[1]


def test_a_head_turns_about_its_neck(sphere_head):
    x = sphere_head.skin_wrap.vertices
    assert find_pivot(sphere_head) == pytest.approx(x.mean(axis=0))
    low = replace(sphere_head, regions={"neck": x[:, 1] < -80})
    assert find_pivot(low) == pytest.approx(x[x[:, 1] < -80].mean(axis=0))
    leant = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    there = turn_skin(low, np.array([find_pivot(low), find_pivot(low) + [0.0, 10.0, 0.0]]), leant)
    assert there == pytest.approx(find_pivot(low) + np.array([[0.0, 0, 0], [0, 0, 10]]))
