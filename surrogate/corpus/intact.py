"""Shards that readers may trust: of their corpus and person, whole, and of arrays that fit together.

A shard is read once per process and file for this, some 12 ms a megabyte: later readers of the same file trust it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...lhm.base.checks import finite, in_range, indices_below, shape, whole
from ...lhm.base.errors import InputError
from .fields import WAVES
from .manifest import Manifest
from .mixture import NAMES
from .plan import LENGTH
from .shard import ACCEPTED, Shard, read_shard

REMEDY = "`softdeca corpus generate` makes it anew"
WEIGHTS = 52
FARTHEST = 1e5
"""[mm] Of a vertex, and of a number of a code or a coefficient, whatever its unit."""
Key = tuple[str, str, int, int, int, int, int]
"""Path, corpus, person, vertices; and inode, size and time of change of the file."""
_intact: set[Key] = set()
"""The files that this process has checked."""


def check_intact(path: Path, manifest: Manifest, identity: int, vertices: int) -> None:
    """Check a person's shard once per process: see `read_intact`."""
    key = _key(path, manifest.owner, identity, vertices)
    if key is None or key not in _intact:
        read_intact(path, manifest, identity, vertices)


def read_intact(path: Path, manifest: Manifest, identity: int, vertices: int) -> Shard:
    """Read a person's shard and check it: checksum, corpus, person, and shapes and indices for so many vertices.

    Raises InputError naming the file and the array.
    """
    before = _key(path, manifest.owner, identity, vertices)
    shard = read_shard(path, manifest.owner)
    try:
        _check_arrays(shard, vertices)
        check_person(shard.groups.number, manifest.counts.parameter_numbers(identity))
    except InputError as error:
        raise InputError(f"shard {path}: {error}; {REMEDY}") from None
    if before is not None:
        _intact.add(before)
    return shard


def check_person(said: np.ndarray, numbers: list[int]) -> None:
    """InputError unless a shard's groups/number are the parameter sets that the plan gives its person and no other."""
    found = whole("groups/number", said, 0, 2**62, (None,)).tolist()
    if found != numbers:
        raise InputError(f"of another person, with parameter sets {found[:3]}, expected {numbers[:3]}")


def _key(path: Path, owner: str, identity: int, vertices: int) -> Key | None:
    try:
        known = path.stat()
    except OSError:
        return None
    return str(path.resolve()), owner, identity, vertices, known.st_ino, known.st_size, known.st_mtime_ns


def _check_arrays(shard: Shard, n: int) -> None:
    code, groups = shard.persons.code, len(shard.groups.number)
    finite("persons/code", code, (1, None), most=FARTHEST)
    finite("persons/skin", shard.persons.skin, (1, n, 3), most=FARTHEST)
    if len(shard.persons.shapes) > 1:
        raise InputError(f"persons/shapes: {len(shard.persons.shapes)} of one person")
    finite("persons/shapes", shard.persons.shapes, (len(shard.persons.shapes), WEIGHTS, n, 3))
    finite("groups/coefficients", shard.groups.coefficients, (groups, len(NAMES), 1 + WAVES), most=FARTHEST)
    shape("groups/varied", shard.groups.varied, (groups, len(NAMES)))
    shape("groups/kind", shard.groups.kind, (groups,))
    _accepted_finite("groups/settled", shard.groups.settled, shard.groups.status, (groups, n, 3))
    statics, sequences = shard.statics, shard.sequences
    frames = len(statics.group)
    indices_below("statics/group", statics.group, groups, (frames,))
    in_range("statics/weights", statics.weights, 0.0, 1.0, (frames, WEIGHTS))
    shape("statics/moved", statics.moved, (frames, 2))
    _accepted_finite("statics/corrected", statics.corrected, statics.status, (frames, n, 3))
    count = len(sequences.group)
    indices_below("sequences/group", sequences.group, groups, (count,))
    in_range("sequences/weights", sequences.weights, 0.0, 1.0, (count, LENGTH, WEIGHTS))
    in_range("sequences/rotations", sequences.rotations, -1.001, 1.001, (count, LENGTH, 3, 3))
    _accepted_finite("sequences/before", sequences.before, sequences.status, (count, 2, n, 3))
    _accepted_finite("sequences/corrected", sequences.corrected, sequences.status, (count, LENGTH, n, 3))
    shape("sequences/iterations", sequences.iterations, (count, LENGTH))
    for table in (statics, sequences):
        shape("recording", table.recording, (len(table.group),))
        shape("frame", table.frame, (len(table.group),))
    responses, changes, answers = shard.responses, shard.parameter_responses, shard.references
    indices_below("responses/group", responses.group, groups, (None,))
    shape("responses/exact", responses.exact, (len(responses.group),))
    finite("responses/offset", responses.offset, (len(responses.group), n, 3))
    finite("responses/expressions", responses.expressions, (len(responses.group), WEIGHTS, n, 3))
    indices_below("parameter_responses/group", changes.group, groups, (None,))
    shape("parameter_responses/name", changes.name, (len(changes.group),))
    finite("parameter_responses/change", changes.change, (len(changes.group), n, 3))
    indices_below("references/static", answers.static, frames, (None,))
    shape("references/law", answers.law, (len(answers.static),))
    _accepted_finite("references/corrected", answers.corrected, answers.status, (len(answers.static), n, 3))


def _accepted_finite(name: str, values: np.ndarray, status: np.ndarray, expected: tuple[int, ...]) -> None:
    """Check a table's large array, whose rows are finite where they are accepted; others are not used."""
    shape(name, values, expected)
    shape(f"{name.split('/')[0]}/status", status, expected[:1])
    if status.dtype.kind != "S":
        raise InputError(f"{name.split('/')[0]}/status: expected texts, got {status.dtype}")
    finite(name, values[status == ACCEPTED.encode()])
