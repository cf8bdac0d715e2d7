"""The recurrence of Eq. 9: static limit, shifts, frequency and decrement, stability, and implicit Euler beside it."""

import itertools

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from softdeca.lhm import InputError
from softdeca.reference import Parameters, Scene, terms
from softdeca.reference.face.dynamics import Recurrence

STEP = 1 / 60
RANGE = [(Parameters.info(n).low, Parameters.info(n).high) for n in ("frequency", "damping")]
CORNERS = list(itertools.product(*RANGE))


def rolled(recurrence, targets, last, before):
    """The recurrence alone, without tissue."""
    frames = [before, last]
    for target in targets:
        frames.append(recurrence.target(target, frames[-1], frames[-2]))
    return np.array(frames[2:])


@pytest.mark.parametrize(
    ("frequency", "damping", "alpha", "beta", "gamma"),
    # Poles of the continuous oscillator at 60 Hz, worked out apart, to four digits.
    [(3, 0.1, 0.9221, 0.9391, 0.0949), (5, 0.2, 0.7846, 0.8110, 0.2418), (8, 0.4, 0.5146, 0.5116, 0.4824)],
)
def test_coefficients_are_those_of_the_poles(frequency, damping, alpha, beta, gamma):
    found = Recurrence.from_oscillator(frequency, damping, STEP)
    assert [found.alpha, found.beta, found.gamma] == pytest.approx([alpha, beta, gamma], abs=5.1e-5)
    f, zeta = found.oscillation(STEP)
    assert (f, zeta) == (pytest.approx(frequency, rel=1e-12), pytest.approx(damping, rel=1e-12))


@pytest.mark.parametrize(("frequency", "damping"), [*CORNERS, (4.0, 0.3)])
def test_release_shows_frequency_and_logarithmic_decrement(frequency, damping):
    """A skin let go swings as e^(-ζωt) cos(ω_d t): its crossings of zero and its peaks are measured off the motion."""
    fine = STEP / 64  # so that crossings and peaks are found well between samples
    n = int(4 / (frequency * fine))
    x = rolled(
        Recurrence.from_oscillator(frequency, damping, fine), np.zeros((n, 1, 3)), np.ones((1, 3)), np.ones((1, 3))
    )[:, 0, 0]
    k = np.flatnonzero(x[:-1] * x[1:] < 0)
    crossings = k + x[k] / (x[k] - x[k + 1])
    damped = 1 / (2 * fine * np.diff(crossings).mean())
    assert damped == pytest.approx(frequency * np.sqrt(1 - damping**2), rel=1e-3)
    peaks = np.flatnonzero((x[1:-1] - x[:-2]) * (x[2:] - x[1:-1]) < 0) + 1
    decrement = 2 * np.log(np.abs(x[peaks[0]] / x[peaks[1]]))  # half a period apart
    assert decrement == pytest.approx(2 * np.pi * damping / np.sqrt(1 - damping**2), rel=2e-2)


def test_the_free_skin_passes_through_the_continuous_motion_at_any_frame_rate():
    """The poles are exact, so samples at 24 Hz lie on those at 240 Hz."""
    f, zeta = 4.0, 0.3
    omega, turn = 2 * np.pi * f, 2 * np.pi * f * np.sqrt(1 - zeta**2)

    def exact(t):
        return np.exp(-zeta * omega * t) * np.cos(turn * t) * np.ones((1, 3))

    for rate in (24, 60, 240):
        times = np.arange(1, rate) / rate
        found = rolled(
            Recurrence.from_oscillator(f, zeta, 1 / rate), np.zeros((len(times), 1, 3)), exact(0), exact(-1 / rate)
        )
        assert found == pytest.approx(np.array([exact(t) for t in times]), abs=1e-12)


def test_a_shift_of_everything_shifts_the_motion():
    rng = np.random.default_rng(0)
    targets, last, before = rng.normal(size=(40, 5, 3)), rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    shift = np.array([120.0, -40.0, 7.0])
    recurrence = Recurrence.from_oscillator(rng.uniform(2, 8, 5), rng.uniform(0.1, 0.7, 5), STEP)
    moved = rolled(recurrence, targets + shift, last + shift, before + shift)
    assert moved - shift == pytest.approx(rolled(recurrence, targets, last, before), abs=1e-11)


def test_at_rest_the_target_is_the_expression_exactly():
    x = np.random.default_rng(1).normal(scale=100, size=(50, 3))
    for f, zeta in CORNERS:
        assert Recurrence.from_oscillator(f, zeta, STEP).target(x, x, x) == pytest.approx(x, abs=1e-12)


def test_no_range_of_p_grows_over_2048_frames_of_the_worst_input():
    """Inputs within ±1 stay below γ Σ |h_k|, h_k = r^k sin((k+1)θ) / sin θ of poles r e^(±iθ); signs attain it."""
    f, zeta = (grid.ravel() for grid in np.meshgrid(*(np.linspace(*limits, 9) for limits in RANGE)))
    r, angle = np.exp(-zeta * 2 * np.pi * f * STEP), 2 * np.pi * f * np.sqrt(1 - zeta**2) * STEP
    k = np.arange(2048)[:, None]
    response = r**k * np.sin((k + 1) * angle) / np.sin(angle)
    worst = np.repeat(np.sign(response[::-1])[:, :, None], 3, axis=2)
    recurrence = Recurrence.from_oscillator(f, zeta, STEP)
    motion = np.abs(rolled(recurrence, worst, np.zeros((len(f), 3)), np.zeros((len(f), 3))))
    bound = recurrence.gamma * np.abs(response).sum(axis=0)
    assert bound.max() < 7
    assert motion.max(axis=0) == pytest.approx(np.repeat(bound[:, None], 3, axis=1), rel=1e-9)


@pytest.mark.parametrize(
    ("frequency", "gamma", "damping", "slower"),
    # γ = (ωh)²/(1 + (ωh)²) at 60 Hz, and the damping and frequency of its poles, worked out apart.
    [(2, 0.042, 0.103, 0.99), (4, 0.149, 0.200, 0.97), (8, 0.412, 0.356, 0.89)],
)
def test_implicit_euler_damps_and_slows(frequency, gamma, damping, slower):
    euler = Recurrence.from_implicit_euler(frequency, STEP)
    found, ratio = euler.oscillation(STEP)
    assert euler.gamma == pytest.approx(gamma, abs=6e-4)
    assert ratio == pytest.approx(damping, abs=6e-4)
    # The poles are √(1-γ) e^(±i atan(ωh)): the damped frequency is that angle over the step.
    turned = found * np.sqrt(1 - ratio**2)
    assert turned == pytest.approx(np.arctan(2 * np.pi * frequency * STEP) / (2 * np.pi * STEP), rel=1e-12)
    assert found / frequency == pytest.approx(slower, abs=3e-2)


def test_implicit_euler_is_what_an_inertia_term_over_springs_does():
    """Each step of Inertia + Target has the closed form (k S + m/h² (2 x₁ - x₂)) / (k + m/h²) at every vertex."""
    corners = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]])
    density, f = 1.04e-6, 5.0
    mass = density * 1000 / 6 / 4
    k = mass * (2 * np.pi * f) ** 2
    pulled = corners + [3.0, 0, 0]
    euler = Recurrence.from_implicit_euler(f, STEP)
    last, before = corners, corners - [0.1, 0.2, 0]
    for _ in range(30):
        inertia = terms.Inertia(density, STEP, positions=last, velocities=(last - before) / STEP)
        scene = Scene(corners, [[0, 1, 2, 3]], [inertia, terms.Target(range(4), pulled, k)])
        spring, place = scene.inertia()
        step = (k * pulled + spring[:, None] * place) / (k + spring)[:, None]
        assert euler.target(pulled, last, before) == pytest.approx(step, abs=1e-10)
        assert euler.stiffness(k) == pytest.approx(k + spring[0], rel=1e-12)
        last, before = step, last


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 0.3, STEP), r"frequency = 0 is outside \(0, 30\) Hz at 60 frames"),
        ((np.array([4.0, 31.0]), 0.3, STEP), r"frequency = 31 is outside \(0, 30\)"),
        ((4.0, 1.0, STEP), r"damping = 1 is outside \(0, 1\)"),
        ((4.0, np.nan, STEP), "damping = nan"),
        ((4.0, 0.3, 0.0), "time_step: must be finite and above 0 s"),
    ],
)
def test_coefficients_out_of_range_are_named(arguments, message):
    with pytest.raises(InputError, match=message):
        Recurrence.from_oscillator(*arguments)


def test_a_recurrence_that_grows_or_drifts_is_refused():
    with pytest.raises(InputError, match="unstable"):
        Recurrence(0.9, 1.0, 0.2)
    with pytest.raises(InputError, match="would drift"):
        Recurrence(0.5, 0.5, 0.6)


def test_skin_that_is_loose_in_part_swings_faster_and_nearer_to_critical_until_it_only_follows():
    """At a share s: frequency f/s, damping 1 - s (1 - ζ); at 1 what it was to the bit, at 0 the target itself."""
    share = np.array([1.0, 0.5, 0.25])
    found = Recurrence.from_oscillator(4.0, 0.3, STEP / 8, loose=share)  # at 480 Hz 16 Hz is well resolved
    frequency, damping = found.oscillation(STEP / 8)
    assert frequency == pytest.approx([4.0, 8.0, 16.0], rel=1e-9)
    assert damping == pytest.approx([0.3, 0.65, 0.825], rel=1e-9)
    whole, none = (
        Recurrence.from_oscillator(4.0, 0.3, STEP),
        Recurrence.from_oscillator(4.0, 0.3, STEP, loose=np.array([1.0, 0.0])),
    )
    assert none.alpha[0] == whole.alpha and none.beta[0] == whole.beta and none.gamma[0] == whole.gamma
    assert (none.alpha[1], none.beta[1], none.gamma[1]) == (0.0, 0.0, 1.0)


@pytest.mark.parametrize("rate", [24.0, 30.0, 60.0])
def test_no_share_makes_the_recurrence_unstable_and_a_target_that_moves_evenly_is_followed_behind(rate):
    """By 2 (α - β) / γ frames at every corner of p's range; not at all where nothing is loose."""
    share = np.linspace(0.0, 1.0, 201)
    for f, zeta in CORNERS:
        found = Recurrence.from_oscillator(
            f, zeta, 1 / rate, loose=share
        )  # Recurrence itself refuses what grows or drifts
        assert np.abs(found.gamma + 2 * found.alpha - found.beta - 1).max() < 1e-14
        lag = 2 * (found.alpha - found.beta) / found.gamma
        assert lag[0] == 0.0
        even = np.arange(600)[:, None, None] * np.ones((201, 3))
        ends = rolled(found, even, *np.zeros((2, 201, 3)))[-1, :, 0]
        assert 599 - ends == pytest.approx(lag, abs=1e-3)


def test_a_recurrence_at_other_vertices_is_the_mean():
    found = Recurrence.from_oscillator(np.array([2.0, 8.0]), 0.3, STEP)
    between = found.at(csr_matrix([[1.0, 0.0], [0.25, 0.75], [0.0, 1.0]]))
    assert between.alpha == pytest.approx(np.array([[1.0, 0.0], [0.25, 0.75], [0.0, 1.0]]) @ found.alpha, abs=1e-15)
    assert between.gamma[[0, 2]] == pytest.approx(found.gamma, abs=1e-15)
    assert Recurrence.from_oscillator(4.0, 0.3, STEP).at(csr_matrix(np.eye(3))).beta.shape == (3,)


@pytest.mark.parametrize("loose", [-0.1, 1.1, np.nan])
def test_a_share_out_of_range_is_refused(loose):
    with pytest.raises(InputError, match="loose: expected shares"):
        Recurrence.from_oscillator(4.0, 0.3, STEP, loose=np.array([0.5, loose]))
