"""One person of a corpus as an HDF5 file: arrays in seven tables, written whole or not at all, with a checksum.

Arrays are stored as they are, one run of bytes each, so that a row can be read without HDF5 (`Place`). T is the
simulator's skin, S that of the linear blendshapes; T - S is kept in float16, which rounds by less
than 0.001 mm below 2 mm and 0.008 mm below 16 mm. The same content gives the same bytes: processor seconds, which
differ between runs, lie in a JSON file beside the shard. Each column says the range of its numbers, which `intact`
checks; the card of a corpus lists them.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_type_hints

import h5py
import numpy as np
from numpy.typing import NDArray

from ...lhm.base.checks import number
from ...lhm.base.errors import InputError, quote
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.files.text import read_json
from ...lhm.base.limits import PARAMETER_SETS, SHARD_BYTES, TAKE_FRAMES
from ...lhm.base.mesh import Floats
from ...reference.face.facial import PD_ENERGY
from .face import MOVED
from .mixture import KINDS, NAMES, WAVES
from .plan import LENGTH

ACCEPTED = "accepted"
FORMAT = 4
"""Of the file, and of what its arrays mean; raised when either changes, and others are refused."""
FEM_LAWS = (PD_ENERGY, "neo-Hookean")
"""Laws by which FEniCSx answers."""
LONGEST = 200
"""Characters of a status."""
WEIGHTS = 52
SPENT = 1e9
"""[s] Most of a phase of a person: thirty years."""
_REMEDY = "`softdeca corpus generate` makes it anew"

Halves = NDArray[np.float16]
Singles = NDArray[np.float32]
Numbers = NDArray[np.int64]
Texts = NDArray[np.bytes_]


@dataclass(frozen=True)
class Column:
    """A row of a table's column: its type and lengths of axes, among them VERTICES and CODE.

    large: left in the file by readers until a row is asked for. low, high: the range of its numbers. below: its numbers
    are rows of that table. choices: its texts are among these, if there are any.
    """

    dtype: np.dtype
    shape: tuple[int, ...]
    large: bool
    low: float
    high: float
    below: str
    choices: tuple[str, ...]

    def lengths(self, vertices: int, code: int | None) -> tuple[Any, ...]:
        """Return the axes of a row in a corpus of such skins and codes; None is any length."""
        known = {VERTICES: vertices, CODE: code}
        return tuple(known.get(length, length) for length in self.shape)

    def describe_range(self) -> str:
        """Return the range in words; empty where there is none."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        if self.below:
            return f"a row of {self.below}"
        return "" if self.dtype.kind in "Sb" else f"{self.low:g} to {self.high:g}"


VERTICES, CODE = -1, -2
"""Lengths of axes that a corpus has: of its skins, and of its people's codes."""
FARTHEST = 10_000.0
"""[mm] Of a vertex, and of a derivative."""
LEAST_GROWN = 10.0
"""Most of the smallest volume ratio of a frame: muscle and skin grow to three times at most."""
CODES = 10.0
"""Most of a code's number; people are drawn within 2.5."""
COUNT = 2**31
"""Most of a count."""


def column(
    dtype: Any, *shape: int, large: bool = False, low: float = 0, high: float = COUNT, below: str = "", choices=()
) -> Any:
    """Make a field of a table; see `Column`."""
    return field(metadata={"column": Column(np.dtype(dtype), shape, large, low, high, below, tuple(choices))})


def moved_column(*shape: int, farthest: float = MOVED) -> Any:
    """Make a field of displacements [mm] in float16, large."""
    return column(np.float16, *shape, 3, large=True, low=-farthest, high=farthest)


def text_column(choices: Sequence[str] = ()) -> Any:
    """Make a field of texts."""
    return column(f"S{LONGEST}", choices=choices)


def columns_of(kind: type) -> dict[str, Column]:
    """Return the columns of a table's class by name."""
    return {item.name: item.metadata["column"] for item in fields(kind)}


@dataclass(frozen=True, eq=False)
class Persons:
    """The one person: code (1, c), neutral skin (1, n, 3) [mm], and shapes (1, 52, n, 3) [mm]."""

    code: Floats = column(np.float64, CODE, low=-CODES, high=CODES)
    skin: Singles = column(np.float32, VERTICES, 3, large=True, low=-FARTHEST, high=FARTHEST)
    shapes: Halves = moved_column(WEIGHTS, VERTICES)


@dataclass(frozen=True, eq=False)
class Groups:
    """The G parameter sets: number of the plan, kind, varied (G, P), coefficients (G, P, 1 + WAVES), see `mixture`.

    settled (G, n, 3) [mm]: how far the neutral skin moved; carried (G, n, 3) [mm]: how far scaled bones carry it;
    status: accepted, or why it did not settle.
    """

    number: Numbers = column(np.int64, high=PARAMETER_SETS.most - 1)
    kind: Texts = text_column(KINDS)
    varied: NDArray[np.bool_] = column(bool, len(NAMES))
    coefficients: Singles = column(np.float32, len(NAMES), 1 + WAVES, low=-1.0, high=1.0)
    settled: Halves = moved_column(VERTICES)
    carried: Halves = moved_column(VERTICES)
    status: Texts = text_column()


@dataclass(frozen=True, eq=False)
class Statics:
    """The F static frames: group (its row), recording and frame of it, weights (F, 52), corrected = T - S (F, n, 3).

    moved (F, 2) [mm]: mean and 95 % of |T - S| in the face; of the solve: status, iterations, residual (the gradient's
    norm over that of springs each 1 mm long), smallest_volume_ratio, inverted (tets), and crossings: pairs of triangles
    of the simulated skin wrap that cross.
    """

    group: Numbers = column(np.int64, below="groups")
    recording: Texts = text_column()
    frame: Numbers = column(np.int64, high=TAKE_FRAMES.most - 1)
    weights: Singles = column(np.float32, WEIGHTS, low=0.0, high=1.0)
    corrected: Halves = moved_column(VERTICES)
    moved: Singles = column(np.float32, 2, high=2.0 * MOVED)
    status: Texts = text_column()
    iterations: Numbers = column(np.int64)
    residual: Singles = column(np.float32)
    smallest_volume_ratio: Singles = column(np.float32, low=-FARTHEST, high=LEAST_GROWN)
    inverted: Numbers = column(np.int64)
    crossings: Numbers = column(np.int64)


@dataclass(frozen=True, eq=False)
class Sequences:
    """The Q sequences of L frames: as Statics, with an axis L; and the two frames before them.

    before (Q, 2, n, 3) [mm]: the skins of the two frames before the first, less S of the first; rotations
    (Q, L, 3, 3): of the head in the room, by which its flesh was shaken (see `reference.face.dynamics`; in the two
    frames before by `extrapolate_turns` of these). A sequence is accepted as a whole.
    """

    group: Numbers = column(np.int64, below="groups")
    recording: Texts = text_column()
    frame: Numbers = column(np.int64, high=TAKE_FRAMES.most - 1)
    weights: Singles = column(np.float32, LENGTH, WEIGHTS, low=0.0, high=1.0)
    rotations: Singles = column(np.float32, LENGTH, 3, 3, low=-1.001, high=1.001)
    before: Halves = moved_column(2, VERTICES)
    corrected: Halves = moved_column(LENGTH, VERTICES)
    status: Texts = text_column()
    iterations: Numbers = column(np.int64, LENGTH)
    residual: Singles = column(np.float32, LENGTH)
    smallest_volume_ratio: Singles = column(np.float32, LENGTH, low=-FARTHEST, high=LEAST_GROWN)
    inverted: Numbers = column(np.int64, LENGTH)
    crossings: Numbers = column(np.int64, LENGTH)


@dataclass(frozen=True, eq=False)
class Responses:
    """Derivatives at the R settled neutral faces: group; exact: of the energy's own Hessian, not of a projected one.

    offset (R, n, 3) [mm]: T - S at w = 0; expressions (R, 52, n, 3) [mm]: d(T - S)/dw.
    """

    group: Numbers = column(np.int64, below="groups")
    exact: NDArray[np.bool_] = column(bool)
    offset: Halves = moved_column(VERTICES)
    expressions: Halves = moved_column(WEIGHTS, VERTICES, farthest=FARTHEST)


@dataclass(frozen=True, eq=False)
class ParameterResponses:
    """The K derivatives of T at w = 0 by one parameter each: group, name, and change (K, n, 3) [mm].

    Per unit of the parameter mapped to [-1, 1], of a field by shifting it as a whole.
    """

    group: Numbers = column(np.int64, below="groups")
    name: Texts = text_column(NAMES)
    change: Halves = moved_column(VERTICES, farthest=FARTHEST)


@dataclass(frozen=True, eq=False)
class References:
    """The M answers of FEniCSx: static (row of Statics), law ("PD" or "neo-Hookean"), corrected = T - S (M, n, 3).

    A law that has no counterpart of a face's p, such as a stiffness that varies, has no row.
    """

    static: Numbers = column(np.int64, below="statics")
    law: Texts = text_column(FEM_LAWS)
    corrected: Halves = moved_column(VERTICES)
    status: Texts = text_column()
    iterations: Numbers = column(np.int64)


@dataclass(frozen=True, eq=False)
class Shard:
    """All that a corpus holds of one person; `seconds` spent on each phase, which its file does not hold."""

    persons: Persons
    groups: Groups
    statics: Statics
    sequences: Sequences
    responses: Responses
    parameter_responses: ParameterResponses
    references: References
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def checksum(self) -> str:
        """SHA-256 over names, types, shapes and bytes of all arrays."""
        digest = hashlib.sha256()
        for table in TABLES:
            for item in fields(TABLES[table]):
                array = np.ascontiguousarray(getattr(getattr(self, table), item.name))
                digest.update(f"{table}/{item.name} {array.dtype.str} {array.shape};".encode())
                digest.update(array.tobytes())
        return digest.hexdigest()


TABLES: dict[str, type] = {name: kind for name, kind in get_type_hints(Shard).items() if name != "seconds"}


def stack_rows(kind: type, rows: Sequence[Mapping[str, Any]], vertices: int) -> Any:
    """Make a table of rows, each a value by column's name; texts become ASCII of at most LONGEST characters.

    A column that no row has is empty.
    """
    arrays = {}
    for name, column in columns_of(kind).items():
        values = [row[name] for row in rows if name in row]
        if column.dtype.kind == "S":
            values = [str(value).encode("ascii", "replace")[:LONGEST] for value in values]
        if values:
            arrays[name] = np.array(values, dtype=column.dtype)
        else:
            arrays[name] = np.zeros((0, *column.lengths(vertices, 0)), dtype=column.dtype)
    return kind(**arrays)


def write_shard(path: Path, shard: Shard, owner: str) -> None:
    """Write a shard of the corpus `owner`, and its seconds beside it. InputError if one cannot be written.

    `path` is whole or as it was.
    """
    write_whole(seconds_path(path), json.dumps(shard.seconds).encode())
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="`product` is deprecated")  # in Debian's h5py
        label = Label(owner, FORMAT, version("softdeca"))
        file.attrs.update(asdict(label) | {"checksum": label.checksum(shard)})
        for table, kind in TABLES.items():
            for item in fields(kind):
                file.create_dataset(f"{table}/{item.name}", data=getattr(getattr(shard, table), item.name))
    write_whole(path, buffer.getvalue())


@dataclass(frozen=True)
class Label:
    """The attributes of a shard but its checksum: corpus, format, version of the software."""

    owner: str
    format: int
    version: str

    def checksum(self, shard: Shard) -> str:
        """SHA-256 over this label and the shard's arrays."""
        return hashlib.sha256(json.dumps([*vars(self).values(), shard.checksum]).encode()).hexdigest()


def read_label(path: Path) -> Label:
    """Read a shard's label alone; InputError for a file that is missing or no shard."""
    with _opened(path) as file:
        return _label(file)


def seconds_path(path: Path) -> Path:
    """Return the place of a shard's processor seconds: the file of its name that ends in .json."""
    return path.with_suffix(".json")


def read_seconds(path: Path) -> dict[str, float]:
    """Read the processor seconds by phase that a shard took; empty if the file beside it is missing.

    InputError for a file that cannot be read, or that holds anything but numbers from 0 to SPENT by name.
    """
    beside = seconds_path(path)
    if not beside.exists():
        return {}
    try:
        seconds = {phase: number(phase, spent, least=0.0, most=SPENT) for phase, spent in read_json(beside).items()}
    except (InputError, AttributeError):
        raise InputError(
            f"seconds {beside}: expected JSON of seconds by phase; delete it, or make the shard anew"
        ) from None
    return seconds


def read_shard(path: Path, owner: str) -> Shard:
    """Read a shard and check it; InputError for one that is missing, truncated, damaged or of another corpus.

    Its seconds are left to `read_seconds`.
    """
    with _opened(path) as file:
        label, kept = _label(file), str(file.attrs["checksum"])
        _check_label(path, label, owner)
        tables = {
            table: kind(**{item.name: _array(file, f"{table}/{item.name}") for item in fields(kind)})
            for table, kind in TABLES.items()
        }
    shard = Shard(**tables)
    if label.checksum(shard) != kept:
        raise InputError(f"shard {path}: its content does not match its checksum; {_REMEDY}")
    return shard


def read_arrays_of(path: Path, owner: str, *names: str) -> dict[str, NDArray[Any]]:
    """Read some arrays of a shard by "table/name"; only the owner is checked. InputError as `read_shard`."""
    with _opened(path) as file:
        _check_label(path, _label(file), owner)
        return {name: _array(file, name) for name in names}


@dataclass(frozen=True)
class Place:
    """An array's place in a file, one run of bytes."""

    offset: int
    dtype: np.dtype
    shape: tuple[int, ...]

    def row(self, path: Path, number: int) -> NDArray[Any]:
        """Read one row of the array; the file is open meanwhile only. InputError if it cannot be read."""
        if not 0 <= number < self.shape[0]:
            raise InputError(f"shard {path}: row {number} of an array of {self.shape[0]}")
        shape = self.shape[1:]
        size = int(np.prod(shape)) * self.dtype.itemsize
        try:
            handle = os.open(path, os.O_RDONLY)
            try:
                content = os.pread(handle, size, self.offset + number * size)
            finally:
                os.close(handle)
        except OSError as error:
            raise InputError(f"shard {path}: cannot be read ({error.strerror})") from None
        if len(content) != size:
            raise InputError(f"shard {path}: truncated; {_REMEDY}")
        return np.frombuffer(bytearray(content), dtype=self.dtype).reshape(shape)


def places_of(path: Path, *names: str) -> dict[str, Place]:
    """Return the places of some arrays of a shard, by "table/name"; InputError as `read_shard`."""
    with _opened(path) as file:
        every = {name: _dataset(file, name) for name in names}
        return {name: Place(data.id.get_offset() or 0, data.dtype, data.shape) for name, data in every.items()}


def _array(file: h5py.File, name: str) -> NDArray[Any]:
    return np.asarray(_dataset(file, name)[()])


def _dataset(file: h5py.File, name: str) -> h5py.Dataset:
    """Return one array of a file, of a plain type, whose bytes lie in the file in one run, as `write_shard` has it."""
    data: Any = file
    for part in name.split("/"):
        # Asked before anything is opened: a link leads to other arrays, or to files elsewhere.
        if not isinstance(data, h5py.Group) or data.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
            raise ValueError(f"{name} is a link, or lies in no group")
        data = data[part]
    if not isinstance(data, h5py.Dataset) or data.dtype.kind not in "biufS":
        raise ValueError(f"{name} is no array of numbers or texts")
    if not 0 <= data.nbytes <= file.id.get_filesize() or (data.nbytes and data.id.get_offset() is None):
        raise ValueError(f"{name} of shape {data.shape} does not lie in the file")
    return data


class _opened:
    """An open HDF5 file; errors of its library within become InputError."""

    def __init__(self, path: Path):
        self.path = path

    def __enter__(self) -> h5py.File:
        if not self.path.is_file():
            raise InputError(f"shard {self.path}: missing; {_REMEDY}")
        try:
            SHARD_BYTES.check(f"shard {self.path}", self.path.stat().st_size)
            self.file = h5py.File(self.path, "r")
        except OSError as error:
            raise self._describe_damage(error) from None
        return self.file

    def __exit__(self, kind, error, trace):
        self.file.close()
        if isinstance(error, (OSError, KeyError, RuntimeError, ValueError, TypeError)) and not isinstance(
            error, InputError
        ):
            raise self._describe_damage(error) from None

    def _describe_damage(self, error: Exception) -> InputError:
        cause = str(error).splitlines()[0][:60] if str(error) else type(error).__name__
        return InputError(f"shard {self.path}: truncated or damaged ({cause}); {_REMEDY}")


def _label(file: h5py.File) -> Label:
    format = file.attrs["format"]
    if not isinstance(format, np.integer):
        raise ValueError(f"format: expected a whole number, got {quote(format)}")
    return Label(str(file.attrs["owner"]), int(format), str(file.attrs["version"]))


def _check_label(path: Path, label: Label, owner: str) -> None:
    if label.format != FORMAT:
        raise InputError(f"shard {path}: of format {label.format}, this version reads {FORMAT}; {_REMEDY}")
    if label.owner != owner:
        raise InputError(
            f"shard {path}: of another corpus ({quote(label.owner, 80)}, expected {quote(owner, 80)}): its plan or "
            "template differs"
        )
