"""Arrays from a pickle, Python 2's too, without running what it names: numpy, scipy's sparse and chumpy's arrays."""

from __future__ import annotations

import codecs
import copyreg
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from ..errors import InputError


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


# The functions that make objects, arrays and numpy's scalars from a pickle; numpy 1 and 2 keep theirs elsewhere.
_REBUILD = vars(copyreg)["_reconstructor"]
_RECONSTRUCT, _SCALAR = np.zeros(1).__reduce__()[0], np.float64(0).__reduce__()[0]

_KNOWN = {
    "numpy ndarray": np.ndarray,
    "numpy dtype": np.dtype,
    "numpy.core.multiarray _reconstruct": _RECONSTRUCT,
    "numpy._core.multiarray _reconstruct": _RECONSTRUCT,
    "numpy.core.multiarray scalar": _SCALAR,
    "numpy._core.multiarray scalar": _SCALAR,
    "_codecs encode": codecs.encode,
    "copy_reg _reconstructor": _REBUILD,
    "copyreg _reconstructor": _REBUILD,
    "__builtin__ object": object,
    "builtins object": object,
}


class _Reader(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        known = _KNOWN.get(f"{module} {name}")
        if known is not None:
            return known
        if module.split(".")[0] == "chumpy":
            return _Chumpy
        if module.startswith("scipy.sparse") and name in ("csc_matrix", "csr_matrix"):
            return _Csc if name == "csc_matrix" else _Csr
        raise pickle.UnpicklingError(f"it asks for {module}.{name}, which is no array")


def read_pickled(path: str | os.PathLike[str], *names: str, of: str) -> dict[str, np.ndarray]:
    """The arrays of these names from a pickled dict; sparse ones are made dense.

    Nothing that the file names is imported or called, but numpy's own arrays. Raises InputError, one line that names
    the file, if it is missing, damaged, lacks an array or holds anything else in its place.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file")
    try:
        with open(path, "rb") as file:
            read = _Reader(file, encoding="latin1").load()
    except Exception as error:  # a damaged pickle raises whatever its bytes happen to ask for
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise InputError(f"{path}: not {of}, or damaged ({reason})") from None
    if not isinstance(read, dict):
        raise InputError(f"{path}: not {of} (a pickled {type(read).__name__}, expected a dict)")
    missing = [name for name in names if name not in read]
    if missing:
        raise InputError(f"{path}: not {of}, array {missing[0]!r} is missing")
    arrays = {}
    for name in names:
        try:
            arrays[name] = _array(read[name])
        except (KeyError, ValueError, TypeError, IndexError):
            raise InputError(f"{path}: {name!r} is no array that can be read") from None
    return arrays


def _array(value: Any) -> np.ndarray:
    if isinstance(value, (_Csc, _Csr)):
        state = value.state
        arrays = (state["data"], state["indices"], state["indptr"])
        shape = state.get("_shape", state.get("shape"))
        return (csc_matrix if isinstance(value, _Csc) else csr_matrix)(arrays, shape=shape).toarray()
    if isinstance(value, _Chumpy):
        state = value.state
        if "x" in state:
            return _array(state["x"])
        # chumpy's Select: some entries of another array, in another shape.
        return _array(state["a"]).ravel()[_array(state["idxs"]).ravel()].reshape(state["preferred_shape"])
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise TypeError("not numbers")
    return array
