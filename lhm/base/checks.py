"""Checks of values and arguments: each names the value, what is wrong with it, and what is allowed.

All raise `error`, by default InputError, with one line. They return the value in the type that the program uses:

    vertices = finite("vertices", arrays["vertices"], (None, 3))
    triangles = indices_below("triangles", arrays["triangles"], len(vertices), (None, 3))
    solver = one_of("solver", solver, SOLVERS, error=SceneError)
    step = number("time_step", step, above=0, most=1, unit="s")
"""

from __future__ import annotations

import numbers
import sys
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .errors import InputError, SoftdecaError, quote

Floats = NDArray[np.float64]
Floats32 = NDArray[np.float32]
Ints = NDArray[np.int64]
Shape = tuple[int | None, ...]
"""Lengths of an array's axes; None for any."""
Error = type[SoftdecaError]


def one_of(name: str, value: Any, choices: Collection[Any], *, error: Error = InputError) -> Any:
    """Return a value that is one of the choices; the error lists them in their order."""
    try:
        good = value in choices
    except (TypeError, ValueError):  # what cannot be hashed, or an array
        good = False
    if not good:
        shown = repr(value) if isinstance(value, str) and len(value) < 40 and value.isprintable() else quote(value)
        raise error(f"{name} {shown}: expected one of {', '.join(map(str, choices))}")
    return value


def number(
    name: str,
    value: Any,
    *,
    above: float | None = None,
    least: float | None = None,
    most: float | None = None,
    unit: str = "",
    error: Error = InputError,
) -> float:
    """Return one finite number as float that lies above `above`, or at or above `least`, and at or below `most`."""
    good = _is_number(value) and abs(value) <= sys.float_info.max
    good = good and (above is None or value > above) and (least is None or value >= least)
    if not good or (most is not None and value > most):
        bounds = [f"{words} {bound:g}" for words, bound in (("above", above), ("at least", least)) if bound is not None]
        bounds += [f"at most {most:g}"] if most is not None else []
        raise error(
            " ".join(f"{name}: expected a number {' and '.join(bounds)} {unit}".split()) + f", got {quote(value)}"
        )
    return float(value)


def array_of_kind(name: str, values: Any, kinds: str, words: str, *, error: Error = InputError) -> np.ndarray:
    """Return an array whose dtype is of these `kinds` (as "iu"); `words` say what was expected."""
    if isinstance(values, np.ma.MaskedArray):  # numpy would take what is masked for numbers
        raise error(f"{name}: expected {words}, got a masked array; fill it, or leave out what is masked")
    try:
        array = np.asarray(values)
    except (ValueError, TypeError, OverflowError):
        raise error(f"{name}: expected {words}, got rows of several lengths") from None
    except Exception as trouble:  # of another package's array, such as a tensor that wants a gradient
        raise error(f"{name}: expected {words}, got {type(values).__name__} ({quote(trouble)})") from None
    if array.dtype.kind not in kinds:
        raise error(f"{name}: expected {words}, got {array.dtype}")
    return array


def shape(name: str, values: Any, expected: Shape, *, error: Error = InputError) -> None:
    """Check the lengths of an array's axes; None stands for any length."""
    got = np.shape(values)
    if len(got) != len(expected) or any(e is not None and e != g for e, g in zip(expected, got, strict=True)):
        words = ", ".join("n" if each is None else str(each) for each in expected)
        raise error(f"{name}: expected shape ({words}{',' if len(expected) == 1 else ''}), got {got}")


def real(
    name: str, values: Any, expected: Shape | None = None, *, most: float | None = None, error: Error = InputError
) -> np.ndarray:
    """Return real numbers as they are stored, of a shape, none NaN or infinite, none larger than `most` in size."""
    array = array_of_kind(name, values, "fiu", "real numbers", error=error)
    if expected is not None:
        shape(name, array, expected, error=error)
    # NaN and infinity spread to the extremes, which are found without a copy.
    low, high = (float(array.min()), float(array.max())) if array.size else (0.0, 0.0)
    if not (np.isfinite(low) and np.isfinite(high)):
        flat = np.flatnonzero(~np.isfinite(array))
        raise error(f"{name}: {len(flat)} values are not finite, the first at {_place(flat[0], array)}")
    if most is not None and max(-low, high) > most:
        raise error(f"{name}: {max(-low, high):.3g} is too large; expected at most {most:g} in size")
    return array


def finite(
    name: str, values: Any, expected: Shape | None = None, *, most: float | None = None, error: Error = InputError
) -> Floats:
    """Return real numbers as float64, checked as by `real`."""
    return np.asarray(real(name, values, expected, most=most, error=error), dtype=np.float64)


def in_range(
    name: str, values: Any, least: float, most: float, expected: Shape | None = None, *, error: Error = InputError
) -> Floats:
    """Return finite numbers as float64 that all lie within least..most."""
    array = finite(name, values, expected, error=error)
    _check_extremes(name, array, least, most, "{:.6g}", error)
    return array


def integers(
    name: str, values: Any, least: int, most: int, expected: Shape | None = None, *, error: Error = InputError
) -> Ints:
    """Return integers as int64 that all lie within least..most."""
    array = array_of_kind(name, values, "iu", "integers", error=error)
    if expected is not None:
        shape(name, array, expected, error=error)
    _check_extremes(name, array, least, most, "{}", error)
    return array.astype(np.int64, copy=False)


def _check_extremes(name: str, array: np.ndarray, least: float, most: float, form: str, error: Error) -> None:
    if array.size and (array.min().item() < least or array.max().item() > most):
        outside = np.flatnonzero((array < least) | (array > most))[0]
        bounds = f"{least:g}..{most:g}" if isinstance(least, float) or isinstance(most, float) else f"{least}..{most}"
        raise error(f"{name}: {form.format(array.ravel()[outside])} at {_place(outside, array)}; expected {bounds}")


def indices_below(
    name: str, values: Any, count: int, expected: Shape | None = None, *, error: Error = InputError
) -> Ints:
    """Return integers as int64 that all lie within 0..count - 1."""
    return integers(name, values, 0, count - 1, expected, error=error)


def text(name: str, value: Any) -> str:
    """Return a text, also one that is stored as an array of one."""
    array = np.asarray(value)
    if array.dtype.kind != "U" or array.ndim:
        raise InputError(f"{name}: expected a text, got {quote(value)}")
    try:
        return str(array)
    except ValueError:  # numbers beyond the last character
        raise InputError(f"{name}: no text") from None


def texts(name: str, value: Any) -> tuple[str, ...]:
    """Return a list of texts as a tuple."""
    if not isinstance(value, list | tuple) or not all(isinstance(each, str) for each in value):
        raise InputError(f"{name}: expected a list of texts, got {quote(value)}")
    return tuple(value)


UNIT = 0.01
"""Largest difference of a quaternion's length from 1: files round its numbers."""


def rotations_from_quaternions(name: str, quaternions: Any) -> Floats:
    """Return rotation matrices (n, 3, 3) of quaternions (x, y, z, w), shape (n, 4), of length 1 within UNIT."""
    q = finite(name, quaternions, (None, 4))
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(q, axis=1, keepdims=True)
    wrong = np.flatnonzero(~(np.abs(lengths - 1.0) <= UNIT))
    if len(wrong):
        raise InputError(f"{name}: quaternion {wrong[0]} has length {lengths[wrong[0], 0]:.3g}; expected 1")
    return Rotation.from_quat(q).as_matrix()


def _place(flat: int, array: np.ndarray) -> str:
    """Return the index of an entry, "3" or "(3, 1)"."""
    place = tuple(int(each) for each in np.unravel_index(int(flat), array.shape))
    return str(place[0]) if len(place) == 1 else str(place)


def _is_number(value: object) -> bool:
    if isinstance(value, numbers.Real):
        return not isinstance(value, bool)
    return isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"
