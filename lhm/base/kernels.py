"""numba's `njit`, whose cache on disk goes by the source of all that a function is compiled of."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
from numba.core.registry import CPUDispatcher


def njit(**options: Any) -> Callable[[Callable], CPUDispatcher]:
    """Return `numba.njit` of these options; a kept function is compiled anew once any of its sources has changed.

    numba itself looks at the file of the function alone, not at those of functions and constants that it takes in.
    """

    def compile_when_called(function: Callable) -> CPUDispatcher:
        kernel = numba.njit(**options)(function)
        if options.get("cache"):
            kernel._cache._cache_file._source_stamp = _digest(sys.modules[function.__module__])
        return kernel

    return compile_when_called


@cache
def _digest(module: ModuleType) -> str:
    """Digest the sources of a module and of those whose functions it compiles in, and its constants."""
    digest, seen, left = sha256(), set(), [module]
    while left:
        each = left.pop()
        if each.__name__ in seen:
            continue
        seen.add(each.__name__)
        digest.update(Path(str(each.__file__)).read_bytes())
        for name, value in vars(each).items():
            if isinstance(value, CPUDispatcher):
                left.append(sys.modules[value.py_func.__module__])
            elif isinstance(value, (int, float, tuple)) and not name.startswith("__"):
                digest.update(f"{name}={value!r}".encode())
    return digest.hexdigest()
