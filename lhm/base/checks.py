"""Checks of values and arguments. Each names the value, where it is wrong, and what is allowed.

All raise InputError, of one line. They return the value in the type that the program uses, so that a loader reads

    vertices = finite("vertices", arrays["vertices"], (None, 3))
    triangles = indices_below("triangles", arrays["triangles"], len(vertices), (None, 3))

`checked` refuses arguments of other kinds than a function's annotations.
"""

from __future__ import annotations

import collections.abc
import functools
import inspect
import numbers
import os
import types
import typing
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix

from .errors import InputError, quote

if TYPE_CHECKING:
    # The folder of compiled code (`files.cache`) has to be known before `mesh` compiles, and `files` imports this.
    from .mesh import Floats, Ints

Shape = tuple[int | None, ...]
"""Lengths of an array's axes; None for any."""


def array_of_kind(name: str, values: Any, kinds: str, words: str) -> np.ndarray:
    """Return an array whose dtype is of these `kinds` (as "iu"); `words` say what was expected."""
    try:
        array = np.asarray(values)
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{name}: expected {words}, got rows of several lengths") from None
    if array.dtype.kind not in kinds:
        raise InputError(f"{name}: expected {words}, got {array.dtype}")
    return array


def shape(name: str, values: Any, expected: Shape) -> None:
    """Check the lengths of an array's axes; None stands for any length."""
    got = np.shape(values)
    if len(got) != len(expected) or any(e is not None and e != g for e, g in zip(expected, got, strict=True)):
        words = ", ".join("n" if each is None else str(each) for each in expected)
        raise InputError(f"{name}: expected shape ({words}{',' if len(expected) == 1 else ''}), got {got}")


def real(name: str, values: Any, expected: Shape | None = None, *, most: float | None = None) -> np.ndarray:
    """Return real numbers as they are stored, of a shape, none NaN or infinite, and none larger than `most` in size."""
    array = array_of_kind(name, values, "fiu", "real numbers")
    if expected is not None:
        shape(name, array, expected)
    # NaN and infinity spread to the extremes, which are found without a copy.
    low, high = (float(array.min()), float(array.max())) if array.size else (0.0, 0.0)
    if not (np.isfinite(low) and np.isfinite(high)):
        flat = np.flatnonzero(~np.isfinite(array))
        raise InputError(f"{name}: {len(flat)} values are not finite, the first at {_place(flat[0], array)}")
    if most is not None and max(-low, high) > most:
        raise InputError(f"{name}: {max(-low, high):.3g} is too large; expected at most {most:g} in size")
    return array


def finite(name: str, values: Any, expected: Shape | None = None, *, most: float | None = None) -> Floats:
    """Return real numbers as float64, checked as by `real`."""
    return np.asarray(real(name, values, expected, most=most), dtype=np.float64)


def in_range(name: str, values: Any, least: float, most: float, expected: Shape | None = None) -> Floats:
    """Return finite numbers as float64 that all lie within least..most."""
    array = finite(name, values, expected)
    if array.size and (array.min() < least or array.max() > most):
        outside = np.flatnonzero((array < least) | (array > most))
        first = array.ravel()[outside[0]]
        raise InputError(f"{name}: {first:.6g} at {_place(outside[0], array)}; expected {least:g}..{most:g}")
    return array


def integers(name: str, values: Any, least: int, most: int, expected: Shape | None = None) -> Ints:
    """Return integers as int64 that all lie within least..most."""
    array = array_of_kind(name, values, "iu", "integers")
    if expected is not None:
        shape(name, array, expected)
    if array.size and (int(array.min()) < least or int(array.max()) > most):
        outside = np.flatnonzero((array < least) | (array > most))
        first = array.ravel()[outside[0]]
        raise InputError(f"{name}: {first} at {_place(outside[0], array)}; expected {least}..{most}")
    return array.astype(np.int64, copy=False)


def indices_below(name: str, values: Any, count: int, expected: Shape | None = None) -> Ints:
    """Return integers as int64 that all lie within 0..count - 1."""
    return integers(name, values, 0, count - 1, expected)


def mask(name: str, values: Any, expected: Shape) -> np.ndarray:
    """Return an array of bool of a shape."""
    array = array_of_kind(name, values, "b", "True and False")
    shape(name, array, expected)
    return array


def text(name: str, value: Any) -> str:
    """Return a text, also one that is stored as an array of one."""
    array = np.asarray(value)
    if array.dtype.kind != "U" or array.ndim:
        raise InputError(f"{name}: expected a text, got {array.dtype} of shape {array.shape}")
    try:
        return str(array)
    except ValueError:  # numbers beyond the last character
        raise InputError(f"{name}: no text") from None


def texts(name: str, value: Any) -> tuple[str, ...]:
    """Return a list of texts as a tuple."""
    if not isinstance(value, list | tuple) or not all(isinstance(each, str) for each in value):
        raise InputError(f"{name}: expected a list of texts, got {quote(value)}")
    return tuple(value)


def sparse_rows(name: str, data: Any, indices: Any, indptr: Any, rows: int, columns: int) -> csr_matrix:
    """Return the sparse matrix (rows, columns) of such arrays, each index and pointer checked.

    scipy itself trusts them: one out of range ends the process at the first product.
    """
    values = finite(f"{name}_data", data, (None,))
    columns_of = indices_below(f"{name}_indices", indices, columns, (len(values),))
    ends = integers(f"{name}_indptr", indptr, 0, len(values), (rows + 1,))
    if ends[0] != 0 or ends[-1] != len(values) or (np.diff(ends) < 0).any():
        raise InputError(f"{name}_indptr: expected numbers that rise from 0 to {len(values)}")
    return csr_matrix((values, columns_of, ends), shape=(rows, columns))


def _place(flat: int, array: np.ndarray) -> str:
    """The index of an entry, "3" or "(3, 1)"."""
    place = tuple(int(each) for each in np.unravel_index(int(flat), array.shape))
    return str(place[0]) if len(place) == 1 else str(place)


Checked = TypeVar("Checked", bound=Callable[..., Any])


def check_arguments(border: Checked) -> Checked:
    """The function, or the class when one is made, that refuses arguments of other kinds than its annotations'.

    InputError then names function and argument, what was expected and what came. A text is no list, and an array
    is one of numbers. Shapes, ranges and NaN are the function's to check.
    """
    if isinstance(border, type):
        border.__init__ = _checking(border.__init__, border.__name__)  # type: ignore[misc]
        return border
    return _checking(border, border.__qualname__)  # type: ignore[return-value]


def _checking(function: Callable[..., Any], name: str) -> Callable[..., Any]:
    signature = inspect.signature(function)

    @functools.cache
    def kinds() -> dict[str, Any]:
        hints = typing.get_type_hints(function)  # when first called: annotations may name what is imported later
        named = (p.name for p in signature.parameters.values() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL))
        return {argument: hints[argument] for argument in named if argument in hints}

    @functools.wraps(function)
    def border(*arguments, **named):
        try:
            given = signature.bind(*arguments, **named).arguments
        except TypeError:
            return function(*arguments, **named)  # whose own words for it are better
        for argument, kind in kinds().items():
            if argument in given and not is_of_kind(given[argument], kind):
                raise InputError(f"{name}: {argument}: expected {_words(kind)}, got {_shown(given[argument])}")
        return function(*arguments, **named)

    return border


def is_of_kind(value: object, kind: Any) -> bool:
    """Whether a value is of an annotation's kind."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any or isinstance(kind, TypeVar) or getattr(kind, "_is_protocol", False):
        return True
    if kind == ArrayLike or kind is np.ndarray or origin is np.ndarray:
        return _is_array(value)
    if origin in (typing.Union, types.UnionType):
        return any(is_of_kind(value, one) for one in inner)
    if origin is typing.Literal:
        return any(type(value) is type(one) for one in inner)
    if kind is float:
        return _is_number(value)
    if kind is int:
        return isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if kind is bool:
        return isinstance(value, (bool, np.bool_))
    if origin is collections.abc.Callable:
        return callable(value)
    if origin is tuple or origin in LISTS:
        return _is_list(value, origin) and all(is_of_kind(one, inner[0]) for one in value)  # type: ignore[attr-defined]
    return isinstance(value, origin or kind)


LISTS = (list, collections.abc.Sequence, collections.abc.Collection, collections.abc.Iterable)


def _is_list(value: object, origin: Any) -> bool:
    """Lists and arrays do for tuples; a text or a dict is no list of anything."""
    if isinstance(value, (str, bytes, collections.abc.Mapping)):
        return False
    return isinstance(value, (list, tuple, np.ndarray)) or (origin is not tuple and isinstance(value, origin))


def _is_number(value: object) -> bool:
    if isinstance(value, numbers.Real):
        return not isinstance(value, bool)
    return isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"


def _is_array(value: object) -> bool:
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except (TypeError, ValueError):  # rows of several lengths, or what refuses to be an array
        return False


def _words(kind: Any) -> str:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind == ArrayLike or kind is np.ndarray or origin is np.ndarray:
        return "an array of numbers"
    if origin in (typing.Union, types.UnionType):
        return " or ".join(dict.fromkeys(_words(one) for one in inner))
    if origin is typing.Literal:
        return " or ".join(repr(one) for one in inner)
    if origin is tuple or origin in LISTS:
        return f"a list, each {_words(inner[0])}"
    simple: dict[Any, str] = {
        float: "a number",
        int: "an integer",
        bool: "True or False",
        str: "a text",
        type(None): "None",
    }
    simple |= {os.PathLike: "a path", collections.abc.Mapping: "a dict", collections.abc.Callable: "a function"}
    return simple.get(origin or kind) or _article((origin or kind).__name__)


def _shown(value: object) -> str:
    if value is None:
        return "None"
    if isinstance(value, (str, numbers.Number)):
        return f"{value!r:.40}"
    return _article(type(value).__name__)


def _article(word: str) -> str:
    return f"{'an' if word[0] in 'AEIOUaeiou' else 'a'} {word}"
