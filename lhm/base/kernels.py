"""numba's `njit`, whose cache on disk goes by the source of all that a function is compiled of."""

from __future__ import annotations

import fcntl
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any, TextIO

import numba
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher


def njit(**options: Any) -> Callable[[Callable], CPUDispatcher]:
    """Return `numba.njit` of these options; a kept function is compiled anew once any of its sources has changed.

    numba itself looks at the file of the function alone, not at those of functions and constants that it takes in.
    Of several processes one compiles a kept function, and the others wait for it. Where the disk is full each does.
    """

    def compile_when_called(function: Callable) -> CPUDispatcher:
        kernel = numba.njit(**options)(function)
        if options.get("cache"):
            kernel._cache._cache_file._source_stamp = _digest(sys.modules[function.__module__])
            _compile_once(kernel)
        return kernel

    return compile_when_called


def _compile_once(kernel: CPUDispatcher) -> None:
    """Let one process at a time look for a kernel in the cache, or compile it."""
    path, compile_kernel = Path(kernel._cache.cache_path, f"{kernel._cache._impl.filename_base}.lock"), kernel.compile
    keep = kernel._cache.save_overload

    def compile_alone(signature: Any) -> Any:
        # Other threads wait here, not for the file: one that compiles a caller would need it from within.
        with global_compiler_lock, _hold(path):
            return compile_kernel(signature)

    def keep_if_there_is_room(*compiled: Any) -> None:
        with suppress(OSError):
            keep(*compiled)

    kernel.compile, kernel._cache.save_overload = compile_alone, keep_if_there_is_room


_HELD: set[Path] = set()


@contextmanager
def _hold(path: Path) -> Iterator[None]:
    """Hold a file's lock, which other processes wait for; not again where this one has it, as recursion does."""
    file = None if path in _HELD else _lock(path)
    if file is None:
        yield
        return
    with file:
        _HELD.add(path)
        try:
            yield
        finally:
            _HELD.remove(path)
            fcntl.flock(file, fcntl.LOCK_UN)  # a child that was forked meanwhile has the file, too


def _lock(path: Path) -> TextIO | None:
    """Open and lock a file; None where its folder or its file system takes no lock."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = open(path, "a")
        fcntl.flock(file, fcntl.LOCK_EX)
    except OSError:
        return None
    return file


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
