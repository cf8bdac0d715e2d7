"""Shards that readers may trust: of their corpus' plan and of their person, with numbers that a simulation can have."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...lhm.base.checks import in_range, indices_below, integers, one_of, shape
from ...lhm.base.errors import InputError, quote
from ...lhm.base.mesh import Surface
from ...lhm.head.skin import check_shapes
from .mixture import NAMES
from .plan import LENGTH, CorpusPlan
from .shard import ACCEPTED, TABLES, Column, Groups, Sequences, Shard, columns_of
from .simulator import UNDIFFERENTIATED

UNLIKE = 0.5
"""Most of the root mean square distance of a person's skin from the mean one, over the mean skin's from its middle."""
ROUNDED = 1e-3
"""Of float32: of a rotation's scalar products, and of a parameter's place in its range."""
ROUNDING = 1e-6
"""Residual that rounding leaves, however small a plan's tolerance is."""
METRICS = 2
"""How often a static frame is solved at most, see `FaceSimulator.solve`."""
ONCE = {"responses": ("group",), "parameter_responses": ("group", "name"), "references": ("static", "law")}
"""Columns whose rows differ from one another."""


def check_person(stored: np.ndarray, numbers: list[int]) -> None:
    """InputError unless a shard's groups/number are the parameter sets that the plan gives its person and no other."""
    kept = integers("groups/number", stored, 0, 2**62, (None,)).tolist()
    if kept != numbers:
        raise InputError(f"of another person, with parameter sets {kept[:3]}, expected {numbers[:3]}")


def check_shard(
    shard: Shard,
    plan: CorpusPlan,
    identity: int,
    *,
    mean: Surface,
    code_size: int | None,
    recordings: Mapping[str, int],
) -> None:
    """Check each column's kind, shape and range, and what columns have to do with one another.

    mean: the corpus' mean skin. code_size: how many numbers a code has; None where nobody says. recordings: frames by
    name of those in the person's split. Numbers of rows that are not accepted are not used, and not checked. InputError
    names the array.
    """
    rows = {"persons": 1, "groups": plan.groups, "statics": plan.groups * plan.frames, "sequences": plan.sequences}
    for table, kind in TABLES.items():
        arrays = vars(getattr(shard, table))
        count = rows.setdefault(table, _rows(arrays))
        for name, column in columns_of(kind).items():
            lengths = column.lengths(len(mean.vertices), code_size)
            _check_kind(f"{table}/{name}", arrays[name], column, (count, *lengths))
        accepted = arrays["status"] == ACCEPTED.encode() if "status" in arrays else np.ones(count, dtype=bool)
        for name, column in columns_of(kind).items():
            used = arrays[name] if column.dtype.kind != "f" or accepted.all() else arrays[name][accepted]
            _check_range(f"{table}/{name}", used, column, rows.get(column.below, 0))
        if "recording" in arrays:
            last = LENGTH - 1 if table == "sequences" else 0
            _check_recordings(table, arrays["recording"], arrays["frame"] + last, recordings)
            _check_solves(table, arrays, accepted, plan)
        if table in ONCE and len({*zip(*(arrays[name].tolist() for name in ONCE[table]), strict=True)}) < count:
            raise InputError(f"{table}: two rows of one {' and '.join(ONCE[table])}")
    planned = {"statics": np.repeat(np.arange(plan.groups), plan.frames), "sequences": np.arange(plan.sequences)}
    for table, order in planned.items():
        if not np.array_equal(getattr(shard, table).group, order):
            raise InputError(f"{table}/group: the rows are not in the plan's order")
    check_person(shard.groups.number, plan.parameter_numbers(identity))
    _check_parameters(shard.groups)
    _check_planned(shard, plan, identity)
    check_shapes(shard.persons.shapes[0], mean)
    _check_skin(shard.persons.skin[0], mean)
    _check_rotations(shard.sequences)


def _rows(arrays: Mapping[str, np.ndarray]) -> int:
    """Return the length of a table's first column."""
    first = next(iter(arrays.values()))
    return len(first) if np.ndim(first) else 0


def _check_kind(name: str, array: np.ndarray, column: Column, expected: tuple[int | None, ...]) -> None:
    if array.dtype != column.dtype:
        raise InputError(f"{name}: expected {column.dtype}, got {array.dtype}")
    shape(name, array, expected)


def _check_range(name: str, array: np.ndarray, column: Column, below: int) -> None:
    if column.dtype.kind == "S":
        for text in set(array.tolist()):
            if not (text.isascii() and text.decode().isprintable()):
                raise InputError(f"{name}: {quote(text)} is no text of plain letters")
            if column.choices:
                one_of(name, text.decode(), column.choices)
    elif column.below:
        indices_below(name, array, below)
    elif column.dtype == np.float16:
        # Bits of halves rise with size, infinity and NaN above all: a tenth of the time of comparing halves.
        if array.size and (array.view(np.uint16) & 0x7FFF).max() > np.float16(column.high).view(np.uint16):
            in_range(name, array, column.low, column.high)
    elif column.dtype.kind in "fi":
        in_range(name, array, column.low, column.high)


def _check_recordings(table: str, names: np.ndarray, frames: np.ndarray, known: Mapping[str, int]) -> None:
    for name, frame in zip(names.tolist(), frames.tolist(), strict=True):
        count = known.get(name.decode(), 0)
        if frame >= count:
            raise InputError(
                f"{table}/frame: {frame} of recording {quote(name.decode())}, which has {count} frames in its split"
            )


def _check_solves(table: str, arrays: Mapping[str, np.ndarray], accepted: np.ndarray, plan: CorpusPlan) -> None:
    """Check that accepted frames were solved as the plan asks, and that inverted tets have no volume and no others."""
    most = plan.tolerance * (1.0 + ROUNDED) + ROUNDING
    in_range(f"{table}/residual", arrays["residual"][accepted], 0.0, most)
    if table == "statics":  # a sequence's solves have a limit of their own
        integers("statics/iterations", arrays["iterations"][accepted], 0, METRICS * plan.max_iterations)
    if ((arrays["inverted"] > 0) != (arrays["smallest_volume_ratio"] <= 0.0))[accepted].any():
        raise InputError(f"{table}/inverted: not those that smallest_volume_ratio tells")


def _check_planned(shard: Shard, plan: CorpusPlan, identity: int) -> None:
    """Check that settled groups and accepted frames alone have more, and only what the plan asks for."""
    settled = shard.groups.status == ACCEPTED.encode()
    wanted = np.array([plan.has_responses(number) for number in plan.parameter_numbers(identity)]) & settled[:, None]
    allowed = {"responses": wanted[:, 0], "parameter_responses": wanted[:, 1], "statics": settled, "sequences": settled}
    for table, groups in allowed.items():
        rows = getattr(shard, table)
        used = rows.status == ACCEPTED.encode() if hasattr(rows, "status") else slice(None)
        if not groups[rows.group[used]].all():
            raise InputError(f"{table}/group: a group that did not settle, or of which the plan asks for none")
    derived = shard.parameter_responses
    differing = np.array([NAMES.index(name.decode()) for name in derived.name], dtype=int)
    if not shard.groups.varied[derived.group, differing].all():
        raise InputError("parameter_responses/name: a parameter that has its default")
    solved = np.unique(shard.references.static)
    most = plan.references if plan.split(identity) == "test" else 0
    if len(solved) > most or not (shard.statics.status[solved] == ACCEPTED.encode()).all():
        raise InputError(f"references/static: expected at most {most} frames, each accepted, got {len(solved)}")


def _check_parameters(groups: Groups) -> None:
    """Check that each parameter stays in its range all over the face, and that something differs from the default."""
    first, waves = groups.coefficients[..., 0].astype(np.float64), groups.coefficients[..., 1:].astype(np.float64)
    extent = np.abs(first) + np.abs(waves).sum(axis=-1)
    in_range("groups/coefficients, a parameter over its range", extent, 0.0, 1.0 + ROUNDED)
    static = [name not in UNDIFFERENTIATED for name in NAMES]
    if not groups.varied[:, static].any(axis=1).all():
        raise InputError("groups/varied: no parameter differs from the default")


def _check_rotations(sequences: Sequences) -> None:
    turned = sequences.rotations[sequences.status == ACCEPTED.encode()].astype(np.float64)
    off = np.abs(turned @ turned.swapaxes(-1, -2) - np.eye(3)).max(initial=0.0)
    if off > ROUNDED or (np.linalg.det(turned) < 0.0).any():
        raise InputError("sequences/rotations: some are no rotations: they shear or mirror")


def _check_skin(skin: np.ndarray, mean: Surface) -> None:
    size = np.sqrt(np.mean(np.sum((mean.vertices - mean.vertices.mean(axis=0)) ** 2, axis=1)))
    away = np.sqrt(np.mean(np.sum((skin - mean.vertices) ** 2, axis=1)))
    if away > UNLIKE * size:
        raise InputError(
            f"persons/skin: {away:.3g} mm from the mean skin, expected at most {UNLIKE * size:.3g}; "
            "are its units, its place or its order of vertices off?"
        )
