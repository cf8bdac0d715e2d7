"""Checks of values from files and arguments. Each names the value, where it is wrong, and what is allowed.

All raise InputError, of one line. They return the value in the type that the program uses, so that a loader reads

    vertices = finite("vertices", arrays["vertices"], (None, 3))
    triangles = indices_below("triangles", arrays["triangles"], len(vertices), (None, 3))
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_matrix

from .bounds import FILE_BYTES, JSON_BYTES, JSON_DEPTH, JSON_DIGITS, Bound, plain, shown
from .errors import InputError

if TYPE_CHECKING:
    # The folder of compiled code (`files.cache`) has to be known before `mesh` compiles, and `files` imports this.
    from .mesh import Floats, Ints

Shape = tuple[int | None, ...]
"""Lengths of an array's axes; None for any."""


def of_kind(name: str, values: Any, kinds: str, words: str) -> np.ndarray:
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
    array = of_kind(name, values, "fiu", "real numbers")
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


def whole(name: str, values: Any, least: int, most: int, expected: Shape | None = None) -> Ints:
    """Return integers as int64 that all lie within least..most."""
    array = of_kind(name, values, "iu", "integers")
    if expected is not None:
        shape(name, array, expected)
    if array.size and (int(array.min()) < least or int(array.max()) > most):
        outside = np.flatnonzero((array < least) | (array > most))
        first = array.ravel()[outside[0]]
        raise InputError(f"{name}: {first} at {_place(outside[0], array)}; expected {least}..{most}")
    return array.astype(np.int64, copy=False)


def indices_below(name: str, values: Any, count: int, expected: Shape | None = None) -> Ints:
    """Return integers as int64 that all lie within 0..count - 1."""
    return whole(name, values, 0, count - 1, expected)


def mask(name: str, values: Any, expected: Shape) -> np.ndarray:
    """Return an array of bool of a shape."""
    array = of_kind(name, values, "b", "True and False")
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
        raise InputError(f"{name}: expected a list of texts, got {shown(value)}")
    return tuple(value)


def sparse_rows(name: str, data: Any, indices: Any, indptr: Any, rows: int, columns: int) -> csr_matrix:
    """Return the sparse matrix (rows, columns) of such arrays, each index and pointer checked.

    scipy itself trusts them: one out of range ends the process at the first product.
    """
    values = finite(f"{name}_data", data, (None,))
    columns_of = indices_below(f"{name}_indices", indices, columns, (len(values),))
    ends = whole(f"{name}_indptr", indptr, 0, len(values), (rows + 1,))
    if ends[0] != 0 or ends[-1] != len(values) or (np.diff(ends) < 0).any():
        raise InputError(f"{name}_indptr: expected numbers that rise from 0 to {len(values)}")
    return csr_matrix((values, columns_of, ends), shape=(rows, columns))


def is_plain_file(path: Path) -> bool:
    """Whether there is a file of that name, no folder or device; False for what can be no name."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # too long, or with a NUL
        return False


def read_bytes(path: str | os.PathLike[str], bound: Bound = FILE_BYTES) -> bytes:
    """Return a file's content; InputError if it is missing, no plain file, unreadable, or larger than the bound."""
    path = Path(path)
    try:
        if not path.is_file():
            raise InputError(f"{path}: no such file" if not path.exists() else f"{path}: not a plain file")
        with path.open("rb") as file:
            bound.check(str(path), path.stat().st_size)
            content = file.read(bound.most + 1)  # it may have grown
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    bound.check(str(path), len(content))
    return content


def read_json(path: str | os.PathLike[str], of: str = "a JSON file", *, allow_nan: bool = False) -> Any:
    """Return what a JSON file says; `of` is what the file should be. InputError, one line, names the file."""
    try:
        return parse_json(read_bytes(path, JSON_BYTES), allow_nan=allow_nan)
    except InputError as error:
        said = str(error)
        raise InputError(said if said.startswith(str(path)) else f"{path}: not {of} ({said})") from None


def parse_json(content: bytes | str, *, allow_nan: bool = False) -> Any:
    """Return what a JSON text (UTF-8) says; InputError for bad JSON, deep nesting, huge integers, or NaN.

    NaN and Infinity, which JSON has not, are let pass for readers that name their place: `allow_nan`.
    """
    try:
        said = content.decode("utf-8-sig") if isinstance(content, bytes) else content.removeprefix("\ufeff")
        JSON_BYTES.check("JSON", len(said))
        JSON_DEPTH.check("JSON", _depth(said))
        return json.loads(said, parse_int=_integer, parse_constant=_constant(allow_nan), parse_float=_float(allow_nan))
    except UnicodeDecodeError as error:
        raise InputError(f"not UTF-8 text, at byte {error.start}") from None
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON: {plain(' '.join(str(error).split()))[:80]}") from None


_STRING = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)


def _depth(said: str) -> int:
    """How deep brackets are nested, those inside strings left out."""
    opened = said.count("[") + said.count("{")
    if opened <= JSON_DEPTH.most:
        return opened
    code = np.frombuffer(_STRING.sub("", said).encode("utf-8", "replace"), np.uint8)
    step = np.isin(code, (ord("["), ord("{"))).astype(np.int32) - np.isin(code, (ord("]"), ord("}")))
    return int(np.cumsum(step).max(initial=0))


def _integer(digits: str) -> int:
    JSON_DIGITS.check("JSON", len(digits.lstrip("-")))
    return int(digits)


def _float(allow_nan: bool) -> Any:
    def number(digits: str) -> float:
        value = float(digits)
        if not allow_nan and not np.isfinite(value):
            raise InputError(f"{shown(digits)} is no finite number")
        return value

    return number


def _constant(allow_nan: bool) -> Any:
    def number(word: str) -> float:
        if not allow_nan:
            raise InputError(f"{word} is no finite number")
        return float(word)

    return number


def _place(flat: int, array: np.ndarray) -> str:
    """The index of an entry, "3" or "(3, 1)"."""
    place = tuple(int(each) for each in np.unravel_index(int(flat), array.shape))
    return str(place[0]) if len(place) == 1 else str(place)
