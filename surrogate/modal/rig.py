"""The modal network at run time, in numpy: bound to one person and p, then frames in the time of blendshapes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numba
import numpy as np

from ...lhm.base.mesh import Floats, Floats32
from .features import EFFECTS, GIVE, Features, normalised_code
from .weights import NEUTRAL, ModalWeights

EVERY = slice(None)


class Modal:
    """Weights ready to be bound."""

    def __init__(self, weights: ModalWeights):
        self.weights = weights
        self.features = Features(weights.mean)
        network = weights.network
        self._modes: list[Floats32] = [np.ascontiguousarray(network[f"modes.{k}"]) for k in range(4)]  # (k, n, 3)
        begins = np.cumsum([0, *(len(part) for part in self._modes)])
        self._rows = [slice(int(first), int(last)) for first, last in pairwise(begins)]
        """Of each part among all gains."""
        self._of_place = network["position"] @ self._wide[:, self.features.local_size :].T + network["gain_in.bias"]

    def bound(self, code: Floats, skin: Floats, at_vertices: Floats, shapes: np.ndarray) -> BoundModes:
        """Offset, responses and remainder of a person (c,) under parameters mapped to [-1, 1] at vertices (n, P).

        skin: the person's neutral one [mm], shape (n, 3); shapes: what the 52 weights add to it, shape (52, n, 3).
        """
        network, weights = self.weights.network, self.weights
        known = normalised_code(code, weights.code_mean, weights.code_scale)
        seen = self._seen(known, at_vertices)
        settling = self.features.without_palsy(at_vertices)
        rested = seen if np.array_equal(settling, at_vertices) else self._seen(known, settling)
        effects = self.features.effects(at_vertices, skin)
        hidden, summary = seen.hidden, seen.summary
        scale = np.float32(1.0 / np.sqrt(3 * len(hidden)))
        responses, remainder = (_gained(self._gains(part, hidden), self._modes[part], scale) for part in (2, 3))
        lag = seen.local[:, [GIVE]] * (1.0 + _linear(network, "lag", hidden))
        amplitudes = _response_amplitudes(network, summary)
        moved = (amplitudes @ responses.reshape(len(responses), -1)).reshape(-1, *skin.shape)
        _subtract_lag(moved, lag[:, 0], shapes.astype(np.float32, copy=False))
        return BoundModes(
            offset=self._neutral(0, rested, effects) + self._neutral(1, seen, effects),
            responses=moved,
            modes=remainder,
            remainder_of=Remainder.of(network, summary),
        )

    @property
    def _wide(self) -> Floats32:
        return self.weights.network["gain_in.weight"]

    def _gains(self, part: int, hidden: Floats32) -> Floats32:
        """By how much more than once a part's modes count at each vertex, shape (k, n)."""
        network, rows = self.weights.network, self._rows[part]
        gains: Floats32 = network["gain_out.weight"][rows] @ hidden.T
        gains += network["gain_out.bias"][rows, None]
        return gains

    def _seen(self, known: Floats, at_vertices: Floats) -> _Seen:
        network, features = self.weights.network, self.features
        local = features.local(at_vertices)
        own = network["gain_code.weight"] @ known.astype(np.float32)
        hidden = _silu(local @ self._wide[:, : local.shape[1]].T + self._of_place + own)
        hidden = _silu(_linear(network, "gain_middle", hidden) + hidden)
        unmoved = features.summary(known, features.unmoved(at_vertices))
        return _Seen(local, features.summary(known, at_vertices), unmoved, hidden)

    def _neutral(self, part: int, seen: _Seen, effects: Floats32) -> Floats32:
        """One of NEUTRAL [mm], shape (n, 3)."""
        network, name, summary, unmoved = self.weights.network, NEUTRAL[part], seen.summary, seen.unmoved
        amplitudes = network[f"{name}_linear.weight"] @ (summary - unmoved)
        amplitudes += (_bent(network, name, summary) - _bent(network, name, unmoved)) * network[f"size_{name}"]
        amplitudes *= np.float32(1.0 / np.sqrt(3 * len(seen.hidden)))
        columns = slice(part * EFFECTS, (part + 1) * EFFECTS)
        level = _linear(network, "effect_level.2", _silu(_linear(network, "effect_level.0", summary)), columns)
        gained = 1.0 + _linear(network, "effect_gain", seen.hidden, columns) + level
        first = np.einsum("ne,enc->nc", effects * gained, network["effects"][part])
        return first + _gained_sum(amplitudes, self._gains(part, seen.hidden), self._modes[part])


@dataclass(frozen=True, eq=False)
class _Seen:
    """Features of a face, its summary when unmoved, and what its gains follow from, shape (n, wide)."""

    local: Floats32
    summary: Floats32
    unmoved: Floats32
    hidden: Floats32


@dataclass(frozen=True, eq=False)
class Remainder:
    """N(w): two hidden layers, modulated once by p and h; `rest` is their answer to w = 0."""

    inner: Floats32
    inner_bias: Floats32
    middle: Floats32
    middle_bias: Floats32
    outer: Floats32
    linear: Floats32
    rest: Floats32

    @classmethod
    def of(cls, network, summary: Floats32) -> Remainder:
        """With all that depends on p and h multiplied out."""
        hidden = _silu(_linear(network, "remainder_summary.0", summary))
        gain, shift = np.split(_linear(network, "remainder_modulation", hidden), 2)
        size = np.exp(_linear(network, "remainder_gain", hidden)) * network["size_remainder"]
        made = cls(
            inner=np.ascontiguousarray((network["remainder_in.weight"] * (1.0 + gain)[:, None]).T),
            inner_bias=network["remainder_in.bias"] * (1.0 + gain) + shift,
            middle=np.ascontiguousarray(network["remainder_middle.weight"].T),
            middle_bias=network["remainder_middle.bias"],
            outer=np.ascontiguousarray((network["remainder_out.weight"] * size[:, None]).T),
            linear=np.ascontiguousarray((network["remainder_linear.weight"] * size[:, None]).T),
            rest=np.zeros(len(size), dtype=np.float32),
        )
        rest = made(np.zeros(52, dtype=np.float32))
        return replace(made, rest=rest)

    @classmethod
    def none(cls) -> Remainder:
        """That of a rig without modes."""
        inner, outer = np.zeros((52, 1), dtype=np.float32), np.zeros((52, 0), dtype=np.float32)
        one = inner[0]
        return cls(inner, one, inner[:1], one, outer[:1], outer, outer[0])

    def of_one(self, weights: Floats32, amplitudes: Floats32) -> None:
        """Write the amplitudes (k,) of one expression (52,): what a frame calls."""
        _one(
            weights, self.inner, self.inner_bias, self.middle, self.middle_bias, self.outer, self.linear, self.rest,
            amplitudes,
        )  # fmt: skip

    def __call__(self, weights: Floats32) -> Floats32:
        """Amplitudes (..., k) of weights (..., 52)."""
        hidden = _silu(_silu(weights @ self.inner + self.inner_bias) @ self.middle + self.middle_bias)
        return hidden @ self.outer + weights @ self.linear - self.rest


@dataclass(frozen=True, eq=False)
class BoundModes:
    """offset (n, 3), responses (52, n, 3) and the remainder's modes (k, n, 3), all [mm], of one person and p."""

    offset: Floats32
    responses: Floats32
    modes: Floats32
    remainder_of: Remainder

    def remainder(self, weights: Floats32) -> Floats32:
        """N(w) [mm], shape (..., n, 3), of weights (..., 52)."""
        return np.tensordot(self.remainder_of(np.asarray(weights, dtype=np.float32)), self.modes, axes=1)


def _bent(network, part: str, summary: Floats32) -> Floats32:
    hidden = _silu(_linear(network, f"{part}.2", _silu(_linear(network, f"{part}.0", summary))))
    return _linear(network, f"{part}.4", hidden)


def _response_amplitudes(network, summary: Floats32) -> Floats32:
    hidden = _silu(_linear(network, "response_summary.2", _silu(_linear(network, "response_summary.0", summary))))
    mixed = np.tensordot(_linear(network, "response_mix", hidden), network["response_tables"], axes=1)
    return network["response_table"] * np.exp(_linear(network, "response_gain", hidden)) + mixed


def _linear(network, layer: str, values, rows: slice = EVERY):
    return values @ network[f"{layer}.weight"][rows].T + network[f"{layer}.bias"][rows]


def _silu(values):
    return values / (1.0 + np.exp(-values))


@numba.njit(cache=True, fastmath=True)
def _gained(gains, modes, scale):
    """Modes times their gains, s (1 + g_kv) B_kv, shape (k, n, 3), of gains (k, n) and modes (k, n, 3)."""
    found = np.empty_like(modes)
    for k in range(len(modes)):
        for v in range(modes.shape[1]):
            gain = scale * (np.float32(1.0) + gains[k, v])
            for c in range(3):
                found[k, v, c] = gain * modes[k, v, c]
    return found


@numba.njit(cache=True, fastmath=True)
def _gained_sum(amplitudes, gains, modes):
    """Σ_k a_k (1 + g_kv) B_kv, shape (n, 3), of gains (k, n) and modes (k, n, 3)."""
    found = np.zeros(modes.shape[1:], dtype=modes.dtype)
    for k in range(len(modes)):
        for v in range(modes.shape[1]):
            gain = amplitudes[k] * (np.float32(1.0) + gains[k, v])
            for c in range(3):
                found[v, c] += gain * modes[k, v, c]
    return found


@numba.njit(cache=True, fastmath=True)
def _subtract_lag(moved, lag, shapes):
    """Take the share of each vertex (n,) in shapes (52, n, 3) from what they move, in place."""
    for j in range(len(moved)):
        for v in range(len(lag)):
            for c in range(3):
                moved[j, v, c] -= lag[v] * shapes[j, v, c]


@numba.njit(cache=True, fastmath=True)
def _one(weights, inner, inner_bias, middle, middle_bias, outer, linear, rest, amplitudes):
    """`Remainder.__call__` of one expression, whose weights of zero cost nothing."""
    first, second = inner_bias.copy(), middle_bias.copy()
    amplitudes[:] = -rest
    for i in range(len(weights)):
        if weights[i] != 0.0:
            for j in range(len(first)):
                first[j] += weights[i] * inner[i, j]
            for j in range(len(amplitudes)):
                amplitudes[j] += weights[i] * linear[i, j]
    for i in range(len(first)):
        active = first[i] / (np.float32(1.0) + np.exp(-first[i]))
        for j in range(len(second)):
            second[j] += active * middle[i, j]
    for i in range(len(second)):
        active = second[i] / (np.float32(1.0) + np.exp(-second[i]))
        for j in range(len(amplitudes)):
            amplitudes[j] += active * outer[i, j]
