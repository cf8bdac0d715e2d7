"""Dynamics by a recurrence of targets (SoftDECA Eq. 9), where a face is loose, and a head that turns while it moves.

In dynamic frames the skin seeks γ S + 2α T₋₁ - β T₋₂ instead of the expression S, where T₋₁ and T₋₂ are the two frames
before, by springs k/γ in place of k. With mass on the skin alone, k/γ = k + m/h² is what implicit Euler makes of k;
keeping k would trade inertia against tracking. γ + 2α - β = 1 makes the recurrence blind to a shift of everything, and
a face at rest rests where statics have it, whatever γ.

Tissue joins in as stiffness K: the poles of the whole solve z² - 2αs z + βs = 0 with s = 1 / (1 + γ K / k) in (0, 1].
Since 1 + βs - 2|α|s is linear in s and positive at 0 and 1, what is stable without tissue is stable with it.

One frequency for the whole face lets lips miss their closures. Lips and lids are moved by the ring of muscle in and
around them, and skin close to bone by bone: there is little between that could swing. So each vertex of the skin wrap
is loose by a share, 0 to 1, and p's frequency and damping are those of loose flesh.

Skin's mass goes on straight in the room. In a head turned by R(t) about a pivot, y its positions from there, the room's
acceleration times h² is, as the last two frames tell it,

    R₀ᵀ (R₀ y₀ - 2 R₋₁ y₋₁ + R₋₂ y₋₂) = (y₀ - 2 y₋₁ + y₋₂) - D,    D = R₀ᵀ (2 R₋₁ y₋₁ - R₋₂ y₋₂) - (2 y₋₁ - y₋₂),

so D/h² is the centrifugal, Coriolis and Euler acceleration in one, exact where implicit Euler is the stepper. An
oscillator on its spring, y'' + 2ζω y' + ω² (y - S) = D/h², seeks S + D/(ωh)² then; Eq. 9 gives that the weight γ.
The mass so driven is that of Eq. 9, k/ω² of the springs to the target, some thousand times the tissue's own: a nod
moves cheeks by millimetres. Gravity stays p's, in the head's own frame: turned with the head it would move a held face
by hundredths, and a neutral face that settles by 0.1 mm at 95 % of the skin, 0.6 mm at most, where it leans by 30°.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ...lhm.base.checks import array_of_kind
from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32
from ...lhm.head.flesh import LEAN_REGIONS, flesh_share
from ...lhm.head.head import FREE, LayeredHead
from .parameters import Parameters, spread_to_vertices

CLOSE, DEEP = 5.0, 15.0
"""Depth [mm] of bone below the skin up to which skin follows it, and from which on it is loose."""
RING = 20.0
"""Width [mm] along the skin over which flesh comes loose beside lips and lids: that of the muscle around a mouth."""
OSCILLATION = ("frequency", "damping")
"""The parameters of p by which flesh swings."""
ORTHOGONAL = 1e-4
"""How far RᵀR may be from the identity: float32 and rounded files pass."""


@dataclass(frozen=True, eq=False)
class Recurrence:
    """T = γ S + 2α T₋₁ - β T₋₂; coefficients [1] are numbers, or one per vertex, shape (n,).

    `driven` is γ/(ωh)², the share of the base's own motion that the target takes (see `base_lag`). InputError for a
    recurrence that is unstable, or that a shift of everything changes (γ + 2α - β is not 1).
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

    @classmethod
    def from_oscillator(
        cls, frequency: float | Floats, damping: float | Floats, time_step: float, *, loose: float | Floats = 1.0
    ) -> Recurrence:
        """Make the recurrence whose free motion is that of an oscillator of this frequency [Hz] and damping ratio.

        β = e^(-2ζωh), α = e^(-ζωh) cos(ω √(1 - ζ²) h), γ = 1 - 2α + β, with ω = 2π frequency and time_step h [s]: the
        poles are the continuous ones, without numerical damping. Numbers, or one per vertex. Where skin is `loose` in
        part only, a share in [0, 1], it swings at frequency / loose, and damping rises to critical with what is not; at
        0 there is no inertia, α = β = 0. InputError names what is out of range: frequency above 0 and below half of
        1 / time_step, damping in (0, 1), time_step above 0.
        """
        time_step = _check_step(time_step)
        f, zeta = np.asarray(frequency, dtype=np.float64), np.asarray(damping, dtype=np.float64)
        rates = f"Hz at {1.0 / time_step:g} frames per second; raise the frame rate"
        _check_within("frequency", f, 0.0, 0.5 / time_step, rates)
        _check_within("damping", zeta, 0.0, 1.0, "as a ratio to critical damping")
        share = np.asarray(loose, dtype=np.float64)
        if not np.all((share >= 0.0) & (share <= 1.0)):
            raise InputError("loose: expected shares in [0, 1]")
        moving = share > 0.0
        omega = 2.0 * np.pi * f * time_step / np.where(moving, share, 1.0)
        zeta = zeta + (1.0 - zeta) * (1.0 - share)
        decay = np.where(moving, np.exp(-zeta * omega), 0.0)
        alpha, beta = decay * np.cos(omega * np.sqrt(1.0 - zeta**2)), np.square(decay)
        return cls._from_poles(alpha, beta, np.where(moving, (1.0 - 2.0 * alpha + beta) / omega**2, 0.0))

    @classmethod
    def from_implicit_euler(cls, frequency: float | Floats, time_step: float) -> Recurrence:
        """Make what implicit Euler makes of an undamped mass on a spring of this frequency [Hz].

        The reference time stepper: γ = (ωh)²/(1 + (ωh)²) and α = β = 1 - γ, the recurrence that `march` has over
        `Target` springs k = m ω². Its damping is numerical, about ωh/2. InputError as for `from_oscillator`.
        """
        time_step = _check_step(time_step)
        f = np.asarray(frequency, dtype=np.float64)
        _check_within("frequency", f, 0.0, np.inf, "Hz")
        kept = 1.0 / (1.0 + (2.0 * np.pi * f * time_step) ** 2)
        return cls._from_poles(kept, kept, kept)

    @classmethod
    def from_head(cls, head: LayeredHead, parameters: Parameters, time_step: float) -> Recurrence:
        """Make that of a head under p at the skin wrap's vertices, each coefficient of shape (n,).

        Frames are time_step [s] apart. For the skin's own vertices, `.average(head.skin_from_wrap)`. Raises what
        `from_oscillator` raises, and SceneError for a field of another length.
        """
        frequency, damping = (
            spread_to_vertices(name, getattr(parameters, name), head.skin_wrap) for name in ("frequency", "damping")
        )
        return cls.from_oscillator(frequency, damping, time_step, loose=measure_looseness(head))

    @classmethod
    def _from_poles(cls, alpha: Floats, beta: Floats, driven: Floats) -> Recurrence:
        gamma = 1.0 - 2.0 * alpha + beta
        return cls(*((float(c) if c.ndim == 0 else c) for c in (alpha, beta, gamma, driven)))

    def target(self, target: Floats, last: Floats, before: Floats) -> Floats:
        """Return where the skin seeks to be [mm], from the static target and the two frames before, (n, 3)."""
        alpha, beta, gamma = (_column(c) for c in (self.alpha, self.beta, self.gamma))
        return gamma * target + 2.0 * alpha * last - beta * before

    def driven_by(self, lag: Floats) -> Floats:
        """Return the shift [mm] of that place by the base's motion, from `base_lag`, shape (n, 3)."""
        return _column(self.driven) * lag

    def average(self, weights: csr_matrix) -> Recurrence:
        """Average the recurrence to other vertices by `weights` (other, n), not negative, rows summing to one.

        A mean of stable ones is stable. With a head's `skin_from_wrap` it is that of its skin's vertices.
        """
        n = weights.shape[1]
        coefficients = (self.alpha, self.beta, self.driven)
        return self._from_poles(*(weights @ np.broadcast_to(np.asarray(c, dtype=np.float64), n) for c in coefficients))

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


@dataclass(frozen=True, eq=False)
class Swing:
    """The swing of a face: loose shares in [0, 1], frequency [Hz] and damping ratio, (n,); pivot (3,) [mm]."""

    loose: Floats
    frequency: Floats
    damping: Floats
    pivot: Floats

    @classmethod
    def from_shares(cls, loose: Floats, pivot: Floats, oscillation: Floats) -> Swing:
        """Take p's frequency and damping at the vertices, mapped to [-1, 1], shape (2, n)."""
        mapped = zip(OSCILLATION, oscillation, strict=True)
        frequency, damping = (np.asarray(Parameters.info(name).denormalise(values)) for name, values in mapped)
        return cls(loose, frequency, damping, pivot)

    def recurrence(self, time_step: float) -> Recurrence:
        """α, β, γ for frames time_step [s] apart; InputError for one at which the frequency cannot be followed."""
        return Recurrence.from_oscillator(self.frequency, self.damping, time_step, loose=self.loose)


def _column(coefficient: float | Floats) -> Floats:
    values = np.asarray(coefficient, dtype=np.float64)
    return values[:, None] if values.ndim else values


def _check_step(time_step: float) -> float:
    if not (np.isfinite(time_step) and time_step > 0):
        raise InputError(f"time_step: must be finite and above 0 s, got {time_step!r}")
    return float(time_step)


def _check_within(name: str, values: Floats, low: float, high: float, unit: str):
    bad = np.atleast_1d(values)[~((np.atleast_1d(values) > low) & (np.atleast_1d(values) < high))]
    if bad.size:
        raise InputError(f"{name} = {bad[0]:g} is outside ({low:g}, {high:g}) {unit}")


def measure_looseness(head: LayeredHead) -> Floats:
    """Measure the share of each skin wrap vertex that lags, shape (n,), 0 to 1: flesh far from bone.

    A head without the regions that tell where it has flesh is loose everywhere.
    """
    n = len(head.bone)
    if not all(name in head.regions for name in (*LEAN_REGIONS, "face", "neck")):
        return np.ones(n)
    flesh, bone = flesh_share(head, fade=RING), head.bone != FREE
    if not bone.any():
        return flesh
    depth = cKDTree(head.skull_wrap.vertices[bone]).query(head.skin_wrap.vertices)[0]
    t = np.clip((depth - CLOSE) / (DEEP - CLOSE), 0.0, 1.0)
    return flesh * t * t * (3.0 - 2.0 * t)


def check_rotation(name: str, base) -> Floats:
    """Return a rotation of the head in the room, shape (3, 3), as float64; InputError, by its name, for another."""
    rotation = np.asarray(array_of_kind(name, base, "fiub", "a rotation of numbers"), dtype=np.float64)
    if rotation.shape != (3, 3):
        raise InputError(f"{name}: expected a rotation of shape (3, 3), got {rotation.shape}")
    off = np.abs(rotation.T @ rotation - np.eye(3)).max() if np.isfinite(rotation).all() else np.inf
    if not off <= ORTHOGONAL:
        raise InputError(f"{name}: no rotation; R^T R is off the identity by {off:g}, at most {ORTHOGONAL:g} may be")
    if np.linalg.det(rotation) < 0.0:
        raise InputError(f"{name}: no rotation but a reflection; its determinant is -1")
    return rotation


def check_turns(name: str, base) -> Floats:
    """Return the rotations of two frames in their order, shape (2, 3, 3), from these or from one (3, 3) for both."""
    pair = array_of_kind(name, base, "fiub", "rotations of numbers")
    if pair.ndim == 3 and len(pair) != 2:
        raise InputError(f"{name}: expected one rotation (3, 3), or those of two frames (2, 3, 3), got {pair.shape}")
    return np.array([check_rotation(name, turn) for turn in (pair if pair.ndim == 3 else (pair, pair))])


def extrapolate_turns(rotations: Floats) -> Floats:
    """Extrapolate a motion's rotations (frames, 3, 3) to the two frames before its first, shape (2, 3, 3).

    It went on as from the first to the second. A head taken as at rest before would be jerked into motion.
    """
    first = check_rotation("base", rotations[0])
    back = first @ check_rotation("base", rotations[1]).T if len(rotations) > 1 else np.eye(3)
    return np.array([back @ back @ first, back @ first])


def find_pivot(head: LayeredHead) -> Floats:
    """Find the point [mm], shape (3,), that a head turns about: the middle of its neck, or else of the skin wrap."""
    x = head.skin_wrap.vertices
    neck = head.regions.get("neck")
    return x[neck].mean(axis=0) if neck is not None and neck.any() else x.mean(axis=0)


def turn_skin(head: LayeredHead, skin: Floats | Floats32, base: Floats) -> Floats:
    """Turn positions of the head's own frame [mm], shape (n, 3), into the room."""
    return turn_about(find_pivot(head), skin, base)


def turn_about(pivot: Floats, skin: Floats | Floats32, base: Floats) -> Floats:
    """Turn positions [mm], shape (n, 3), by a rotation (3, 3) about a point (3,)."""
    return pivot + (skin - pivot) @ np.asarray(base, dtype=np.float64).T


def base_lag(base: Floats, last: Floats, before: Floats, turns: Floats) -> Floats | None:
    """D above [mm], shape (n, 3): where what goes on straight in the room is off what does so in the head.

    base (3, 3): this frame's rotation; last, before (n, 3): the two frames before it, from the pivot, by which the head
    was turned by `turns` (2, 3, 3), the earlier first. None where it did not turn.
    """
    if np.array_equal(base, turns[1]) and np.array_equal(base, turns[0]):
        return None
    ahead = 2.0 * last @ turns[1].T - before @ turns[0].T
    return ahead @ base - (2.0 * last - before)
