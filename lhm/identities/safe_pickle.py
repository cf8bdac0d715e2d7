"""Arrays from a pickle, Python 2's too, without running what it names: numpy, scipy's sparse and chumpy's arrays."""

from __future__ import annotations

import codecs
import copyreg
import io
import os
import pickle
import re
from typing import Any

import numpy as np

from ..base.checks import sparse_rows
from ..base.errors import InputError
from ..base.files.text import read_bytes
from ..base.limits import SPACE_VALUES


class _Stored:
    """Stands for an object of another package: keeps its state, and nothing else of it."""

    kind = ""

    def __init__(self, *arguments: Any):
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        # A state with slots is a pair of dicts.
        parts = state if isinstance(state, tuple) else (state,)
        self.state = {k: v for part in parts if isinstance(part, dict) for k, v in part.items()}


class _Chumpy(_Stored):
    kind = "chumpy"


class _Csc(_Stored):
    kind = "csc"


class _Csr(_Stored):
    kind = "csr"


class _Dtype(_Stored):
    """Stands for numpy's dtype, of whose states a hostile one can end the process."""

    def __init__(self, code: Any = "", *_: Any):
        self.code, self.order = str(code), "="

    def __setstate__(self, state: Any) -> None:
        order = state[1] if isinstance(state, tuple) and len(state) > 1 else "="
        self.order = order if order in ("<", ">", "|", "=") else "="

    def made(self) -> np.dtype:
        if not re.fullmatch(r"[fiub][1248]", self.code):
            raise TypeError("not numbers")
        return np.dtype(self.order + self.code)


class _Ndarray(_Stored):
    """Stands for an array: the state that it is made of."""

    def __setstate__(self, state: Any) -> None:
        self.made_of = state


def _reconstruct(*_: Any) -> _Ndarray:
    return _Ndarray()


def _scalar(dtype: Any, raw: Any) -> _Ndarray:
    stored = _Ndarray()
    stored.__setstate__((1, (), dtype, False, raw))
    return stored


_KNOWN = {
    "numpy ndarray": _Ndarray,
    "numpy dtype": _Dtype,
    "numpy.core.multiarray _reconstruct": _reconstruct,
    "numpy._core.multiarray _reconstruct": _reconstruct,
    "numpy.core.multiarray scalar": _scalar,
    "numpy._core.multiarray scalar": _scalar,
    "_codecs encode": codecs.encode,
    "copy_reg _reconstructor": vars(copyreg)["_reconstructor"],
    "copyreg _reconstructor": vars(copyreg)["_reconstructor"],
    "__builtin__ object": object,
    "builtins object": object,
}


# The reader in Python: the one in C makes room for as many objects as a damaged file numbers, gigabytes of it.
class _Reader(pickle._Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        known = _KNOWN.get(f"{module} {name}")
        if known is not None:
            return known
        if module.split(".")[0] == "chumpy":
            return _Chumpy
        if module.startswith("scipy.sparse") and name in ("csc_matrix", "csr_matrix"):
            return _Csc if name == "csc_matrix" else _Csr
        raise pickle.UnpicklingError(f"it asks for {module}.{name}, which is no array")


def read_pickled(path: str | os.PathLike[str], *names: str, kind: str) -> dict[str, np.ndarray]:
    """Read the arrays of these names from a pickled dict; sparse ones are made dense.

    Nothing that the file names is imported or called, but numpy's own arrays. Raises InputError, one line that names
    the file, if it is missing, damaged, lacks an array or holds anything else in its place.
    """
    content = read_bytes(path)
    try:
        read = _Reader(io.BytesIO(content), encoding="latin1").load()
    except Exception as error:  # a damaged pickle raises whatever its bytes happen to ask for
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise InputError(f"{path}: not {kind}, or damaged ({reason})") from None
    if not isinstance(read, dict):
        raise InputError(f"{path}: not {kind} (a pickled {type(read).__name__}, expected a dict)")
    missing = [name for name in names if name not in read]
    if missing:
        raise InputError(f"{path}: not {kind}, array {missing[0]!r} is missing")
    arrays = {}
    for name in names:
        try:
            arrays[name] = _array(read[name])
        except (KeyError, ValueError, TypeError, IndexError, AttributeError, RecursionError):
            raise InputError(f"{path}: {name!r} is no array that can be read") from None
    return arrays


def _array(value: Any) -> np.ndarray:
    if isinstance(value, (_Csc, _Csr)):
        shape: Any = value.state.get("_shape", value.state.get("shape"))
        rows, columns = (int(length) for length in shape)
        SPACE_VALUES.check("it holds", rows * columns)
        data, indices, indptr = (_array(value.state[name]) for name in ("data", "indices", "indptr"))
        if isinstance(value, _Csc):
            return sparse_rows("sparse", data, indices, indptr, columns, rows).toarray().T
        return sparse_rows("sparse", data, indices, indptr, rows, columns).toarray()
    if isinstance(value, _Chumpy):
        state = value.state
        if "x" in state:
            return _array(state["x"])
        # chumpy's Select: some entries of another array, in another shape.
        return _array(state["a"]).ravel()[_array(state["idxs"]).ravel()].reshape(state["preferred_shape"])
    if isinstance(value, _Ndarray):
        _, shape, dtype, by_columns, raw = value.made_of
        content = raw.encode("latin1") if isinstance(raw, str) else raw  # as Python 2 has bytes
        return np.frombuffer(content, dtype.made()).reshape(shape, order="F" if by_columns else "C")
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise TypeError("not numbers")
    return array
