"""Shards that readers may trust: of their corpus and person, whole, and of arrays that fit together.

A shard is read once per process and file for this, some 12 ms a megabyte: later readers of the same file trust it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...lhm.base.checks import array_of_kind, in_range, indices_below, integers, real, shape
from ...lhm.base.errors import InputError
from .plan import CorpusPlan
from .shard import ACCEPTED, TABLES, VERTICES, Shard, columns_of, read_shard

REMEDY = "`softdeca corpus generate` makes it anew"
Key = tuple[str, str, int, int, int, int, int]
"""Path, corpus, person, vertices; and inode, size and time of change of the file."""
_intact: set[Key] = set()
"""The files that this process has checked."""


def check_intact(path: Path, owner: str, plan: CorpusPlan, identity: int, vertices: int) -> None:
    """Check a person's shard once per process: see `read_intact`."""
    key = _key(path, owner, identity, vertices)
    if key is None or key not in _intact:
        read_intact(path, owner, plan, identity, vertices)


def read_intact(path: Path, owner: str, plan: CorpusPlan, identity: int, vertices: int) -> Shard:
    """Read a person's shard and check it: checksum, corpus, person, and shapes and indices for so many vertices.

    Raises InputError naming the file and the array.
    """
    before = _key(path, owner, identity, vertices)
    shard = read_shard(path, owner)
    try:
        _check_arrays(shard, vertices)
        check_person(shard.groups.number, plan.parameter_numbers(identity))
    except InputError as error:
        raise InputError(f"shard {path}: {error}; {REMEDY}") from None
    if before is not None:
        _intact.add(before)
    return shard


def check_person(stored: np.ndarray, numbers: list[int]) -> None:
    """InputError unless a shard's groups/number are the parameter sets that the plan gives its person and no other."""
    kept = integers("groups/number", stored, 0, 2**62, (None,)).tolist()
    if kept != numbers:
        raise InputError(f"of another person, with parameter sets {kept[:3]}, expected {numbers[:3]}")


def _key(path: Path, owner: str, identity: int, vertices: int) -> Key | None:
    try:
        state = path.stat()
    except OSError:
        return None
    return str(path.resolve()), owner, identity, vertices, state.st_ino, state.st_size, state.st_mtime_ns


def _check_arrays(shard: Shard, vertices: int) -> None:
    """Check each column's shape, range and indices; numbers of rows that are not accepted are not used."""
    for table, kind in TABLES.items():
        arrays = vars(getattr(shard, table))
        rows = 1 if table == "persons" else _rows(arrays)
        for name, column in columns_of(kind).items():
            axes = (vertices if length == VERTICES else length for length in column.shape)
            shape(f"{table}/{name}", arrays[name], (rows, *axes))
            if column.dtype.kind == "S":
                array_of_kind(f"{table}/{name}", arrays[name], "S", "texts")
        accepted = arrays["status"] == ACCEPTED.encode() if "status" in arrays else slice(None)
        for name, column in columns_of(kind).items():
            if column.below:
                indices_below(f"{table}/{name}", arrays[name], _rows(vars(getattr(shard, column.below))))
            elif np.isfinite(column.high):
                in_range(f"{table}/{name}", arrays[name], column.low, column.high)
            elif column.dtype.kind == "f":
                real(f"{table}/{name}", arrays[name][accepted])


def _rows(arrays: Mapping[str, np.ndarray]) -> int:
    """Return the length of a table's first column."""
    first = next(iter(arrays.values()))
    return len(first) if np.ndim(first) else 0
