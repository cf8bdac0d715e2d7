"""Frozen dataclasses of arrays in .npz files of our own, with a format and a checksum over all that they hold.

`pack` and `unpack` go by the fields' annotations. A reader trusts a file whose checksum is right.
"""

from __future__ import annotations

import hashlib
import json
import os
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from ..errors import InputError
from .npz import read_arrays, write_arrays

Arrays = Mapping[str, np.ndarray]
LEAVES = ("data", "indices", "indptr", "shape")


def save_packed(path: str | os.PathLike[str], form: str, value: Any) -> None:
    """Write a dataclass to a .npz file, whole or not at all; `form` names what it is, and its version."""
    arrays = dict(pack(value)) | {"format": np.array(form)}
    write_arrays(path, arrays | {"checksum": np.array(_checksum(arrays))})


def load_packed(path: str | os.PathLike[str], form: str, kind: Any, *, what: str, else_do: str) -> Any:
    """Read what `save_packed` wrote of a class.

    InputError, one line that names the file, if it is missing, damaged or of another version; `what` is what the file
    should be, `else_do` says how to make another.
    """
    arrays = read_arrays(path, kind=what)
    if arrays.get("format", np.array("")).tolist() != form:
        raise InputError(f"{path}: not {what} of this version ({form!r}); {else_do}")
    if arrays.pop("checksum", np.array("")).tolist() != _checksum(arrays):
        raise InputError(f"{path}: damaged, its checksum is another; {else_do}")
    return unpack(kind, arrays)


def _checksum(arrays: Arrays) -> str:
    content = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        content.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        content.update(array.tobytes())
    return content.hexdigest()


def pack(value: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the fields of a dataclass as arrays by dotted names; None holds nothing."""
    for field in fields(value):
        if field.init:
            yield from _pack(field.name, getattr(value, field.name))


def _pack(name: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
    inner: Iterable[tuple[str, Any]] = ()
    if value is None:
        return
    if is_dataclass(value):
        inner = pack(value)
    elif isinstance(value, csr_matrix):
        inner = ((leaf, np.asarray(getattr(value, leaf))) for leaf in LEAVES)
    elif isinstance(value, Mapping):
        inner = value.items()
    elif isinstance(value, tuple) and not all(isinstance(each, str) for each in value):
        inner = ((str(number), each) for number, each in enumerate(value))
    else:
        yield name, np.array(json.dumps(value)) if isinstance(value, tuple) else np.asarray(value)
    for part, each in inner:
        yield from _pack(f"{name}.{part}", each)


def unpack(kind: Any, arrays: Arrays) -> Any:
    """Make a dataclass of the arrays of `pack`; its constructor checks them. KeyError where one is missing."""
    hints = typing.get_type_hints(kind)
    names = [field.name for field in fields(kind) if field.init]
    return kind(**{name: _unpack(hints[name], name, arrays) for name in names})


def _unpack(kind: Any, name: str, arrays: Arrays) -> Any:
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    below = {key[len(name) + 1 :]: array for key, array in arrays.items() if key.startswith(f"{name}.")}
    if origin in (typing.Union, types.UnionType):
        return _unpack(inner[0], name, arrays) if below or name in arrays else None
    if is_dataclass(kind):
        return unpack(kind, below)
    if kind is csr_matrix:
        matrix = csr_matrix(tuple(below[leaf] for leaf in LEAVES[:3]), shape=tuple(below["shape"]))
        matrix.check_format(full_check=True)  # scipy trusts indices, and dies of them
        return matrix
    if origin is Mapping:
        return {key: _unpack(inner[1], key, below) for key in dict.fromkeys(key.partition(".")[0] for key in below)}
    if origin is tuple and inner[0] is str:
        return tuple(json.loads(str(arrays[name])))
    if origin is tuple:
        return tuple(_unpack(each, str(number), below) for number, each in enumerate(inner))
    return kind(arrays[name].item()) if kind in (str, int, float) else arrays[name]
