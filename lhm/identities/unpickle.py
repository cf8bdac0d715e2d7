"""Arrays from a pickle, Python 2's too, without running what it names: numpy's, scipy's sparse ones and chumpy's."""

from __future__ import annotations

import io
import os
import pickle
from typing import Any

import numpy as np
import scipy.sparse

from ..base.errors import InputError, one_line
from ..base.files.text import read_bytes


def _frombuffer(content: Any, dtype: np.dtype, shape: tuple[int, ...], order: Any) -> np.ndarray:
    """Make an array as numpy's own function of this name does, by which protocol 5 has arrays."""
    return np.frombuffer(content, dtype).reshape(shape, order=order)


ARRAYS: dict[str, Any] = {"ndarray": np.ndarray, "dtype": np.dtype, "_frombuffer": _frombuffer}
ARRAYS |= {"_reconstruct": np.zeros(0).__reduce__()[0], "scalar": np.float64().__reduce__()[0]}
"""Whatever the module is named: numpy 2 has other names than numpy 1."""
SPARSE = {f"{form}_{kind}" for form in ("csc", "csr", "coo") for kind in ("matrix", "array")}
MAKERS = {("_codecs", "encode")}
MAKERS |= {(module, "_reconstructor") for module in ("copy_reg", "copyreg")}
MAKERS |= {(module, "object") for module in ("__builtin__", "builtins")} | {("collections", "OrderedDict")}
"""How Python 2 has bytes and objects."""


class _Chumpy:
    """Stands for an object of chumpy: keeps its state, and nothing else of it."""

    def __init__(self, *_: Any):
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        # A state with slots is a pair of dicts.
        parts = state if isinstance(state, tuple) else (state,)
        self.state = {name: each for part in parts if part for name, each in part.items()}


class _Reader(pickle.Unpickler):
    """Unpickles arrays alone."""

    def find_class(self, module: str, name: str) -> Any:
        """Give the stand-in or the maker of an array; UnpicklingError for any other class."""
        if module.split(".")[0] == "chumpy":
            return _Chumpy
        if module.startswith("scipy.sparse") and name in SPARSE:
            return getattr(scipy.sparse, name)
        if module.split(".")[0] == "numpy" and name in ARRAYS:
            return ARRAYS[name]
        if (module, name) in MAKERS:
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"it asks for {module}.{name}, which is no array")


def read_pickled(path: str | os.PathLike[str], *names: str, kind: str) -> dict[str, np.ndarray]:
    """Read the arrays of these names from a pickled dict; sparse ones are made dense.

    Raises InputError, one line that names the file, if it is missing, damaged, lacks an array, holds anything else in
    its place, or asks for anything but arrays.
    """
    content = read_bytes(path)
    try:
        read = _Reader(io.BytesIO(content), encoding="latin1").load()
        return {name: _array(read[name]) for name in names}
    except Exception as error:  # a damaged pickle raises whatever its bytes happen to ask for
        reason = f"array {error} is missing" if isinstance(error, KeyError) else one_line(str(error))[:100]
        raise InputError(f"{path}: not {kind}, or damaged ({reason or type(error).__name__})") from None


def _array(value: Any) -> np.ndarray:
    if isinstance(value, _Chumpy):
        if "x" in value.state:
            return _array(value.state["x"])
        # chumpy's Select: some entries of another array, in another shape.
        chosen, shape = _array(value.state["idxs"]).ravel(), value.state["preferred_shape"]
        return _array(value.state["a"]).ravel()[chosen].reshape(shape)
    if scipy.sparse.issparse(value):
        if value.format == "coo":
            value = scipy.sparse.coo_matrix((value.data, (value.row, value.col)), value.shape).tocsr()
        value.check_format(full_check=True)  # scipy trusts indices, and dies of them
        return value.toarray()
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise TypeError(f"an array of {array.dtype}, expected numbers")
    return array
