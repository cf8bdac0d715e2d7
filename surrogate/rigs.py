"""What rigs share: the checks of what they are bound to and asked for, and the sum of shapes."""

from __future__ import annotations

import warnings

import numba
import numpy as np

from ..lhm.arkit import ARKIT
from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32, Surface

EXPRESSIONS = len(ARKIT)


def checked_skin(skin: Surface, template: Surface, of: str) -> None:
    """Raise InputError, naming `of`, for a skin that has not the triangles of a template."""
    if len(skin.vertices) != len(template.vertices):
        raise InputError(f"skin: {len(skin.vertices)} vertices, {of} has {len(template.vertices)}")
    if not np.array_equal(skin.triangles, template.triangles):
        raise InputError(f"skin: its triangles are not those of {of}")


def checked_code(code, size: int) -> Floats:
    """H as float64, shape (size,); InputError for other shapes, and for what is not finite."""
    code = np.asarray(code, dtype=np.float64)
    if code.shape != (size,) or not np.isfinite(code).all():
        raise InputError(f"code: expected {size} finite numbers, got shape {code.shape}")
    return code


def checked_shapes(expressions, vertices: int) -> Floats32:
    """What the 52 weights add [mm], shape (52, vertices, 3); InputError for other shapes, and what is not finite."""
    shapes = np.ascontiguousarray(expressions, dtype=np.float32)
    expected = (EXPRESSIONS, vertices, 3)
    if shapes.shape != expected or not np.isfinite(shapes).all():
        raise InputError(f"expressions: expected finite displacements of shape {expected}, got {shapes.shape}")
    return shapes


def checked_weights(weights) -> Floats32:
    """The 52 weights as float32, clipped to [0, 1] with a warning; InputError for other shapes, and for NaN."""
    weights = np.asarray(weights, dtype=np.float32)
    if weights.shape != (EXPRESSIONS,):
        raise InputError(f"weights: expected the {EXPRESSIONS} of ARKit, got shape {weights.shape}")
    if _within(weights):
        return weights
    if not np.isfinite(weights).all():
        raise InputError(f"weights: number {np.flatnonzero(~np.isfinite(weights))[0]} is not finite")
    outside = np.count_nonzero((weights < 0.0) | (weights > 1.0))
    warnings.warn(f"{outside} of {EXPRESSIONS} weights outside [0, 1] were clipped", stacklevel=3)
    return np.clip(weights, 0.0, 1.0)


@numba.njit(cache=True)
def _within(weights):
    """Whether all weights are in [0, 1], as those of nearly every frame are; False for NaN."""
    for weight in weights:
        if not 0.0 <= weight <= 1.0:
            return False
    return True


def checked_blended(blended, shape: tuple[int, ...]) -> Floats32:
    """S_t of a rig of one's own [mm] as float32; InputError for another shape, and for what is not finite."""
    blended = np.ascontiguousarray(blended, dtype=np.float32)
    if blended.shape != shape or not np.isfinite(blended).all():
        raise InputError(f"blended: expected finite positions of shape {shape}, got {blended.shape}")
    return blended


def checked_out(out: Floats32 | None, shape: tuple[int, ...]) -> Floats32:
    """The array to write to, made where it is None; InputError for one of another shape or kind."""
    if out is None:
        return np.empty(shape, dtype=np.float32)
    if out.shape != shape or out.dtype != np.float32 or not out.flags.c_contiguous:
        raise InputError(f"out: expected contiguous float32 of shape {shape}")
    return out


@numba.njit(cache=True, fastmath=True)
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
