"""Rigs: anything that makes a skin of 52 weights; the checks, the sum of shapes and the bound face that they share."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from ...lhm.base.checks import array_of_kind, in_range
from ...lhm.base.errors import InputError
from ...lhm.base.geometry.likeness import check_moved
from ...lhm.base.geometry.warp import rigid_motion
from ...lhm.base.kernels import njit
from ...lhm.base.mesh import Floats, Floats32, Surface
from ...lhm.identities.arkit import ARKIT
from ...lhm.template.fit import is_upright

WEIGHTS = len(ARKIT)
FARTHEST_CODE = 4.0
"""Largest number of a code, which is standard normal: every space draws and fits up to 2.5."""


Needs = Literal["nothing", "head", "simulator"]
"""Need of a method to bind a face, or for a frame, beside its skin, shapes and p."""


class Rig(Protocol):
    """One person and p: skins [mm] of 52 weights."""

    def frame(self, weights, blended=None, *, out: Floats32 | None = None) -> Floats32:
        """Return the skin [mm], shape (n, 3), for 52 ARKit weights; written to `out`, if given.

        blended: the linear blendshapes' answer S_t [mm] of a rig of one's own, shape (n, 3).
        """
        ...


class CorrectedRig:
    """Blendshapes S and what a function of w adds to them; T - S [mm], shape (n, 3), of weights (52,)."""

    def __init__(self, skin: Surface, shapes, correct):
        self._rest, self._skin = skin, skin.vertices.astype(np.float32)
        self._shapes = np.ascontiguousarray(shapes, dtype=np.float32).reshape(WEIGHTS, -1)
        self.correct = correct

    def frame(self, weights, blended=None, *, out: Floats32 | None = None) -> Floats32:
        """Return the skin; see `Rig.frame`."""
        weights, surface = check_weights(weights), check_out(out, self._skin.shape)
        if blended is None:
            surface[:] = self._skin
            add_combination(weights, self._shapes, surface.reshape(-1))
        else:
            surface[:] = check_blended(blended, self._rest)
        surface += self.correct(weights)
        return surface


def check_skin(skin: Surface, template: Surface, reference: str) -> None:
    """Raise InputError for a skin [mm] that has not the triangles, size, direction and shape of a template."""
    if len(skin.vertices) != len(template.vertices):
        raise InputError(f"skin: {len(skin.vertices)} vertices, {reference} has {len(template.vertices)}")
    if not np.array_equal(skin.triangles, template.triangles):
        raise InputError(f"skin: its triangles are not those of {reference}")
    if not is_upright(template, skin):
        raise InputError(
            f"skin: not of the size of {reference} [mm], or turned from it, which looks along +z with +y up"
        )
    rotation, _ = rigid_motion(skin.vertices, template.vertices)
    turned, middle = (skin.vertices - skin.vertices.mean(axis=0)) @ rotation.T, template.vertices.mean(axis=0)
    scaled = turned * (np.linalg.norm(template.vertices - middle) / np.linalg.norm(turned))
    check_moved("skin", template, scaled + middle, reference=reference)


def check_code(code, size: int) -> Floats:
    """Return h as float64, shape (size,); InputError for other shapes, and for numbers beyond FARTHEST_CODE."""
    return in_range("code", code, -FARTHEST_CODE, FARTHEST_CODE, (size,))


def check_weights(weights) -> Floats32:
    """Return the 52 weights as float32, clipped to [0, 1] with a warning; InputError for other shapes, and for NaN."""
    numbers = array_of_kind("weights", weights, "fiub", f"the {WEIGHTS} of ARKit as numbers")
    weights = np.array(numbers, dtype=np.float32)  # a copy, since `out` may lie over them
    if weights.shape != (WEIGHTS,):
        raise InputError(f"weights: expected the {WEIGHTS} of ARKit, got shape {weights.shape}")
    if _within(weights):
        return weights
    if not np.isfinite(weights).all():
        raise InputError(f"weights: number {np.flatnonzero(~np.isfinite(weights))[0]} is not finite")
    return clip_weights(weights, stacklevel=4)


def clip_weights(weights: Floats32, *, stacklevel: int) -> Floats32:
    """Return weights clipped to [0, 1], with a warning that counts those outside; `stacklevel` is that of `warn`."""
    inside = np.clip(weights, 0.0, 1.0)
    if outside := np.count_nonzero(inside != weights):
        warnings.warn(f"{outside} of {weights.size} weights outside [0, 1] were clipped", stacklevel=stacklevel)
    return inside


@njit(cache=True)
def _within(weights):
    """Whether all weights are in [0, 1], as those of nearly every frame are; False for NaN."""
    for weight in weights:
        if not 0.0 <= weight <= 1.0:
            return False
    return True


def check_blended(blended, skin: Surface) -> Floats32:
    """Return S_t of a rig of one's own [mm] as float32; InputError for another shape and as of `check_moved`."""
    expected = skin.vertices.shape
    given = array_of_kind("blended", blended, "fiub", f"positions of shape {expected}")
    if given.shape != expected:
        raise InputError(f"blended: expected positions of shape {expected}, got {given.shape}")
    with np.errstate(over="ignore"):  # which is not finite then
        positions = np.ascontiguousarray(given, dtype=np.float32)
    check_moved("blended", skin, positions)
    return positions


def check_out(out: Floats32 | None, shape: tuple[int, ...]) -> Floats32:
    """Return the array to write to, a new one for None; InputError for another shape or kind, or one to read only."""
    if out is None:
        return np.empty(shape, dtype=np.float32)
    is_right = type(out) is np.ndarray and out.shape == shape and out.dtype == np.float32
    if not is_right or not (out.flags.c_contiguous and out.flags.writeable):
        raise InputError(f"out: expected a contiguous, writeable array of float32 of shape {shape}")
    return out


@njit(cache=True, fastmath=True)
def add_combination(amplitudes, shapes, surface):
    """Add Σ_k a_k B_k to a surface (m,) in place; shapes (k, m), two at a time, zeros left out."""
    pending = -1
    for k in range(len(amplitudes)):
        if amplitudes[k] == 0.0:
            continue
        if pending < 0:
            pending = k
            continue
        a, b, one, other = amplitudes[pending], amplitudes[k], shapes[pending], shapes[k]
        for i in range(len(surface)):
            surface[i] += a * one[i] + b * other[i]
        pending = -1
    if pending >= 0:
        a, one = amplitudes[pending], shapes[pending]
        for i in range(len(surface)):
            surface[i] += a * one[i]


def silu(x):
    """Return x sigmoid(x)."""
    if isinstance(x, np.ndarray):
        return x / (1.0 + np.exp(-x))
    from torch.nn.functional import silu as torch_silu  # whose slope is finite far below zero

    return torch_silu(x)


@dataclass(frozen=True, eq=False)
class Remainder:
    """Amplitudes N(w) of modes: two hidden layers over w, bound to one p and h; `rest` is their answer to w = 0.

    Arrays of numpy; in training torch's, of a batch (b, ...) with biases (b, 1, ...).
    """

    inner: Any
    inner_bias: Any
    middle: Any
    middle_bias: Any
    outer: Any
    linear: Any
    rest: Any

    @classmethod
    def from_layers(cls, *, inner, inner_bias, middle, middle_bias, outer, linear) -> Remainder:
        """Take layers whose answer to w = 0 is yet to be computed."""
        if isinstance(inner, np.ndarray):
            inner, middle, outer, linear = map(np.ascontiguousarray, (inner, middle, outer, linear))
        rest = silu(silu(inner_bias) @ middle + middle_bias) @ outer
        return cls(inner, inner_bias, middle, middle_bias, outer, linear, rest)

    @classmethod
    def empty(cls) -> Remainder:
        """Return that of a rig without modes."""
        inner, outer = np.zeros((WEIGHTS, 1), dtype=np.float32), np.zeros((WEIGHTS, 0), dtype=np.float32)
        return cls(inner, inner[0], inner[:1], inner[0], outer[:1], outer, outer[0])

    def __call__(self, weights):
        """Return amplitudes (..., k) of weights (..., 52)."""
        hidden = silu(silu(weights @ self.inner + self.inner_bias) @ self.middle + self.middle_bias)
        return hidden @ self.outer + weights @ self.linear - self.rest

    def write(self, weights: Floats32, amplitudes: Floats32) -> None:
        """Write the amplitudes (k,) of one expression (52,): what a frame calls."""
        _write_remainder(
            weights, self.inner, self.inner_bias, self.middle, self.middle_bias, self.outer, self.linear, self.rest,
            amplitudes,
        )  # fmt: skip


@njit(cache=True, fastmath=True, error_model="numpy")
def _write_remainder(weights, inner, inner_bias, middle, middle_bias, outer, linear, rest, amplitudes):
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


@dataclass(frozen=True, eq=False)
class FaceModes:
    """T - S of one person and p [mm]: offset (n, 3), responses (52, n, 3), and modes (k, n, 3) of the remainder."""

    offset: Floats32
    responses: Floats32
    modes: Floats32
    remainder_of: Remainder

    @classmethod
    def linear(cls, offset: Floats32, responses: Floats32) -> FaceModes:
        """Return a face without a remainder."""
        return cls(offset, responses, np.zeros((0, *offset.shape), dtype=np.float32), Remainder.empty())

    def remainder(self, weights: Floats32) -> Floats32:
        """Return N(w) [mm], shape (..., n, 3), of weights (..., 52)."""
        return np.tensordot(self.remainder_of(np.asarray(weights, dtype=np.float32)), self.modes, axes=1)
