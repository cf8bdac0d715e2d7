"""A rig with inertia (SoftDECA Eq. 21): what is loose goes on from its two frames before, towards the static answer.

    f_t = γ F(w_t) + 2α f_{t-1} - β f_{t-2},    γ = 1 - 2α + β

F is any rig's static frame. α and β of a vertex are those of an oscillator of p's frequency and damping there, as far
as flesh is loose (`reference.face.dynamics`). Its poles lie inside the unit circle whatever p, so no motion of w makes
it grow; γ makes it blind to a shift of everything, and lets a face at rest rest where statics have it.

What tissue adds to the springs' stiffness is left out: told by the rig's responses it lowered the error of dynamic
frames by 2 % where flesh is loose, and raised it where a turning head shakes all of a face at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...lhm.base.checks import number, real
from ...lhm.base.errors import FitError, InputError
from ...lhm.base.kernels import njit
from ...lhm.base.mesh import Floats, Floats32
from ...lhm.base.progress import OnProgress, silent
from ...reference.face.dynamics import (
    Recurrence,
    base_lag,
    check_rotation,
    check_turns,
    find_pivot,
    measure_looseness,
)
from ..corpus.people import People
from .rig import Rig

PEOPLE, SEED = 96, 41
"""How many people looseness is learned from, and the seed that draws them."""
RIDGE = 8.0
"""Ridge of each coefficient of a code, in people: a code's numbers are of size one."""
FASTEST = 1e5
"""[mm/s] Largest velocity of a vertex: no head moves so fast."""
TINY = 1e-9
"""Keeps logarithms of poles finite."""
NOTHING = 0.02
"""A share below which a vertex does not swing: at p's lowest frequency it would be at rest within one frame."""


class Swings(Protocol):
    """The swing of a bound face: coefficients of Eq. 21, and what its head turns about."""

    @property
    def pivot(self) -> Floats:
        """Return what it turns about, shape (3,) [mm]."""
        ...

    def recurrence(self, time_step: float) -> Recurrence:
        """Return α, β, γ at the vertices for frames time_step [s] apart; InputError where that cannot be."""
        ...


@dataclass(frozen=True, eq=False)
class LearnedSwing:
    """Coefficients β and γ (n,) that a network has learned for frames `learned_at` [s] apart."""

    beta: Floats
    gamma: Floats
    pivot: Floats
    learned_at: float

    def recurrence(self, time_step: float) -> Recurrence:
        """α = (1 - γ + β)/2, so that rest stays rest; a turning head drives it as an oscillator of the same poles."""
        if not np.isclose(time_step, self.learned_at, rtol=1e-3):
            raise InputError(
                f"time_step: this network has learned frames {self.learned_at:.4g} s apart, not {time_step:.4g} s"
            )
        beta, gamma = self.beta.astype(np.float64), self.gamma.astype(np.float64)
        alpha = 0.5 * (1.0 - gamma + beta)
        root = np.sqrt((alpha**2 - beta).astype(np.complex128))
        squared = np.abs(np.log(alpha + root + TINY) * np.log(alpha - root + TINY))
        return Recurrence(alpha, beta, 1.0 - 2.0 * alpha + beta, gamma / np.maximum(squared, TINY))


@dataclass(frozen=True, eq=False)
class Looseness:
    """Looseness of the flesh of a space's people, and the points that their heads turn about: linear in the code.

    Both follow from a fitted head's depths of bone, which a bind in milliseconds has not. shares (1 + c, n): of each
    vertex that swings; pivots (1 + c, 3) [mm]: of the mean, then by number of the code.
    """

    shares: Floats
    pivots: Floats

    @classmethod
    def from_people(cls, people: People, *, count: int = PEOPLE, on_progress: OnProgress = silent) -> Looseness:
        """Learn by ridge regression over random people whose heads are fitted, a second or so each."""
        rng = np.random.default_rng(SEED)
        codes, shares, pivots = [], [], []
        for drawn in range(count):
            person = people.person(rng)
            on_progress(f"where faces are loose: head {drawn + 1} of {count}", (drawn + 1) / count)
            try:
                head = people.head(person)
            except FitError:
                continue
            codes.append(np.append(1.0, person.code))
            shares.append(head.skin_from_wrap @ measure_looseness(head))
            pivots.append(find_pivot(head))
        rows = np.array(codes)
        penalty = RIDGE * np.eye(rows.shape[1])
        penalty[0, 0] = 0.0
        inverse: Floats = np.linalg.solve(rows.T @ rows + penalty, rows.T)
        return cls(inverse @ np.array(shares), inverse @ np.array(pivots))

    def predict(self, code: Floats) -> tuple[Floats, Floats]:
        """Predict the shares (n,), in [0, 1], and the pivot (3,) [mm] of a person."""
        row = np.append(1.0, code)
        shares = row @ self.shares
        return np.where(shares > NOTHING, np.clip(shares, 0.0, 1.0), 0.0), row @ self.pivots


class DynamicRig:
    """Frames of a static rig in their order, time_step [s] apart: the first begins at rest in its own expression.

    The head may turn in the room (`base`), which shakes what is loose; answers are in the head's own frame.
    """

    def __init__(self, rig: Rig, swing: Swings, time_step: float):
        self.time_step, self.recurrence = float(time_step), swing.recurrence(time_step)
        alpha, beta = np.asarray(self.recurrence.alpha), np.asarray(self.recurrence.beta)
        self._rig = rig
        self._loose = np.flatnonzero(beta > 0.0)
        self._coefficients = np.stack([2.0 * alpha, beta], axis=1)[self._loose].astype(np.float32)
        self._driven = np.asarray(self.recurrence.driven, dtype=np.float64)[self._loose, None]
        self._pivot = swing.pivot
        self._last = np.zeros((len(self._loose), 3), dtype=np.float32)
        self._before, self._pushed = np.zeros_like(self._last), np.zeros_like(self._last)
        self._turns = np.stack([np.eye(3), np.eye(3)])
        self._begun = self._turning = False

    def begin(self, weights, blended=None, *, velocity: Floats | None = None, base: Floats | None = None) -> Floats32:
        """Put the face at rest in an expression, but moving at `velocity` [mm/s], (n, 3); returns the static skin.

        `base`: how the head was turned in the two frames before the first, the earlier first, (2, 3, 3), or one (3, 3)
        for both; not turned if None. InputError for other shapes, velocities beyond FASTEST, and what the rig raises.
        """
        turned = check_turns("base", np.eye(3) if base is None else base)
        skin = self._rig.frame(weights, blended)
        given = 0.0 * skin if velocity is None else real("velocity", velocity, skin.shape, most=FASTEST)
        moving = np.asarray(given, dtype=np.float32)
        self._last[:] = skin[self._loose]
        self._before[:] = self._last - np.float32(self.time_step) * moving[self._loose]
        self._turns, self._begun, self._turning = turned, True, True
        return skin

    def frame(self, weights, blended=None, *, base: Floats | None = None, out: Floats32 | None = None) -> Floats32:
        """The next skin [mm], shape (n, 3), for 52 ARKit weights; written to `out`, if given.

        `base`: the head's rotation in the room, shape (3, 3), or None as in the last frame (at first, not turned).
        Raises what the static rig raises, and InputError for a base that is no rotation; then the state stays.
        """
        turned = None if base is None else check_rotation("base", base)
        skin = self._rig.frame(weights, blended, out=out)
        if not self._begun:
            self._last[:] = self._before[:] = skin[self._loose]
            self._turns = self._turns if turned is None else np.stack([turned, turned])
            self._begun = True
        if self._turning or turned is not None:
            self._push(self._turns[1] if turned is None else turned)
        _swing(skin, self._loose, self._coefficients, self._last, self._before, self._pushed)
        return skin

    def _push(self, now: Floats) -> None:
        """Compute the motion that the head's turning adds to this frame [mm], and keep its turns for the next."""
        middle = self._pivot
        behind = base_lag(now, self._last - middle, self._before - middle, self._turns)
        self._pushed[:] = 0.0 if behind is None else self._driven * behind
        self._turning = behind is not None
        self._turns = np.stack([self._turns[1], now])


def dynamic_rig(rig: Rig, swing: Swings | None, time_step: float) -> DynamicRig:
    """A rig's frames with inertia; InputError for one of which nothing is known, and for no time step."""
    number("time_step", time_step, above=0.0, unit="s")
    if swing is None:
        raise InputError(
            "dynamic: the weights do not tell where faces are loose; bind(exact=True) takes it of the head"
        )
    return DynamicRig(rig, swing, time_step)


@njit(cache=True, fastmath=True)
def _swing(skin, loose, coefficients, last, before, pushed):
    """Eq. 21 at the loose vertices of a static skin, in place; as differences, so that rest is kept to the bit."""
    for k in range(len(loose)):
        a, b, v = coefficients[k, 0], coefficients[k, 1], loose[k]
        for c in range(3):
            still, now = skin[v, c], last[k, c]
            moved = still + (a * (now - still) - b * (before[k, c] - still)) + pushed[k, c]
            before[k, c], last[k, c] = now, moved
            skin[v, c] = moved
