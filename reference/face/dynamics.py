"""Dynamics by a recurrence of targets (SoftDECA Eq. 9), its coefficients from a frequency and a damping ratio.

In dynamic frames the skin seeks γ S + 2α T₋₁ - β T₋₂ instead of the expression S, where T₋₁ and T₋₂ are the two frames
before, by springs k/γ in place of k. With mass on the skin alone, k/γ = k + m/h² is what implicit Euler makes of k;
keeping k would trade inertia against tracking. γ + 2α - β = 1 makes the recurrence blind to a shift of everything, and
a face at rest rests where statics have it, whatever γ.

Tissue joins in as stiffness K: the poles of the whole solve z² - 2αs z + βs = 0 with s = 1 / (1 + γ K / k) in (0, 1].
Since 1 + βs - 2|α|s is linear in s and positive at 0 and 1, what is stable without tissue is stable with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats


@dataclass(frozen=True, eq=False)
class Recurrence:
    """T = γ S + 2α T₋₁ - β T₋₂; coefficients [1] are numbers, or one per vertex, shape (n,).

    `driven` is γ/(ωh)², what of the base's own motion the target takes (see `base`). InputError for a recurrence that
    is unstable, or that a shift of everything changes (γ + 2α - β is not 1).
    """

    alpha: float | Floats
    beta: float | Floats
    gamma: float | Floats
    driven: float | Floats = 0.0

    def __post_init__(self):
        alpha, beta, gamma = (np.asarray(c, dtype=np.float64) for c in (self.alpha, self.beta, self.gamma))
        if not (np.all(np.abs(beta) < 1.0) and np.all(2.0 * np.abs(alpha) < 1.0 + beta)):
            raise InputError("recurrence: unstable; |beta| < 1 and 2 |alpha| < 1 + beta are needed")
        if not np.all(np.abs(gamma + 2.0 * alpha - beta - 1.0) <= 1e-12):
            raise InputError("recurrence: gamma + 2 alpha - beta is not 1, so a face at rest would drift")

    def target(self, target: Floats, last: Floats, before: Floats) -> Floats:
        """Where inertia makes the skin seek to be [mm], from the static target and the two frames before, (n, 3)."""
        alpha, beta, gamma = (_column(c) for c in (self.alpha, self.beta, self.gamma))
        return gamma * target + 2.0 * alpha * last - beta * before

    def driven_by(self, lag: Floats) -> Floats:
        """By how much [mm] the base's motion moves what the skin seeks, from `base.lag`, shape (n, 3)."""
        return _column(self.driven) * lag

    def at(self, weights: csr_matrix) -> Recurrence:
        """The recurrence at other vertices, means by `weights` (other, n) not negative, rows summing to one.

        A mean of stable ones is stable. With a head's `skin_from_wrap` it is that of its skin's vertices.
        """
        n = weights.shape[1]
        own = (self.alpha, self.beta, self.driven)
        return _recurrence(*(weights @ np.broadcast_to(np.asarray(c, dtype=np.float64), n) for c in own))

    def stiffness(self, stiffness: float | Floats) -> Floats:
        """Stiffness of the springs in dynamic frames from that of statics, k/γ; any unit, a number or shape (n,)."""
        return np.asarray(stiffness / np.asarray(self.gamma))

    def oscillation(self, time_step: float) -> tuple[Floats, Floats]:
        """Frequency [Hz] and damping ratio [1] of a free skin, as a continuous oscillator would have them.

        z² - 2αz + β = 0 has the poles e^(s h), s = ω (-ζ ± i √(1 - ζ²)).
        """
        alpha, beta = np.asarray(self.alpha, dtype=np.complex128), np.asarray(self.beta, dtype=np.complex128)
        s = np.log(alpha + np.sqrt(alpha**2 - beta)) / time_step
        return np.abs(s) / (2.0 * np.pi), -s.real / np.abs(s)


def coefficients(
    frequency: float | Floats, damping: float | Floats, time_step: float, *, loose: float | Floats = 1.0
) -> Recurrence:
    """The recurrence whose free motion is that of an oscillator of this frequency [Hz] and damping ratio.

    β = e^(-2ζωh), α = e^(-ζωh) cos(ω √(1 - ζ²) h), γ = 1 - 2α + β, with ω = 2π frequency and time_step h [s]: the poles
    are the continuous ones, without numerical damping. Numbers, or one per vertex. Where skin is `loose` in part only,
    a share in [0, 1], it swings at frequency / loose, and damping rises to critical with what is not; at 0 there is no
    inertia, α = β = 0. InputError names what is out of range: frequency above 0 and below half of 1 / time_step,
    damping in (0, 1), time_step above 0.
    """
    time_step = _step(time_step)
    f, zeta = np.asarray(frequency, dtype=np.float64), np.asarray(damping, dtype=np.float64)
    _within("frequency", f, 0.0, 0.5 / time_step, f"Hz at {1.0 / time_step:g} frames per second; raise the frame rate")
    _within("damping", zeta, 0.0, 1.0, "as a ratio to critical damping")
    share = np.asarray(loose, dtype=np.float64)
    if not np.all((share >= 0.0) & (share <= 1.0)):
        raise InputError("loose: expected shares in [0, 1]")
    moving = share > 0.0
    omega = 2.0 * np.pi * f * time_step / np.where(moving, share, 1.0)
    zeta = zeta + (1.0 - zeta) * (1.0 - share)
    decay = np.where(moving, np.exp(-zeta * omega), 0.0)
    alpha, beta = decay * np.cos(omega * np.sqrt(1.0 - zeta**2)), np.square(decay)
    return _recurrence(alpha, beta, np.where(moving, (1.0 - 2.0 * alpha + beta) / omega**2, 0.0))


def implicit_euler(frequency: float | Floats, time_step: float) -> Recurrence:
    """What implicit Euler makes of an undamped mass on a spring of this frequency [Hz]: γ = (ωh)²/(1 + (ωh)²).

    The reference time stepper: α = β = 1 - γ, the recurrence of an `Inertia` term over `Target` springs k = m ω². Its
    damping is numerical, about ωh/2. InputError as for `coefficients`.
    """
    time_step = _step(time_step)
    f = np.asarray(frequency, dtype=np.float64)
    _within("frequency", f, 0.0, np.inf, "Hz")
    squared = (2.0 * np.pi * f * time_step) ** 2
    kept = 1.0 / (1.0 + squared)
    return _recurrence(kept, kept, kept)


def _recurrence(alpha: Floats, beta: Floats, driven: Floats) -> Recurrence:
    gamma = 1.0 - 2.0 * alpha + beta
    return Recurrence(*((float(c) if c.ndim == 0 else c) for c in (alpha, beta, gamma, driven)))


def _column(coefficient: float | Floats) -> Floats:
    values = np.asarray(coefficient, dtype=np.float64)
    return values[:, None] if values.ndim else values


def _step(time_step: float) -> float:
    if not (np.isfinite(time_step) and time_step > 0):
        raise InputError(f"time_step: must be finite and above 0 s, got {time_step!r}")
    return float(time_step)


def _within(name: str, values: Floats, low: float, high: float, unit: str):
    bad = np.atleast_1d(values)[~((np.atleast_1d(values) > low) & (np.atleast_1d(values) < high))]
    if bad.size:
        raise InputError(f"{name} = {bad[0]:g} is outside ({low:g}, {high:g}) {unit}")
