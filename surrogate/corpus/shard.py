"""One person of a corpus as an HDF5 file: arrays in six tables, written whole or not at all, with a checksum.

Arrays are stored as they are, one run of bytes each, so that a row can be read without HDF5 (`Place`). T is the
simulator's skin, S that of the linear blendshapes; T - S is kept in float16, which rounds by less
than 0.001 mm below 2 mm and 0.008 mm below 16 mm. The same content gives the same bytes: processor seconds, which
differ between runs, lie in a JSON file beside the shard. The checksum is of all other bytes of the file.
"""

from __future__ import annotations

import io
import json
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_type_hints

import h5py
import numpy as np
from numpy.typing import NDArray

from ...lhm.base.checks import number
from ...lhm.base.errors import InputError, quote
from ...lhm.base.files.atomic import UNSEALED, is_sealed, seal, write_whole
from ...lhm.base.files.resumable import NO_LOCKS
from ...lhm.base.files.text import read_json
from ...lhm.base.limits import SHARD_BYTES
from ...lhm.base.mesh import Floats
from ...reference.face.facial import PD_ENERGY
from .mixture import NAMES, WAVES
from .plan import LENGTH

ACCEPTED = "accepted"
FORMAT = 5
"""Format version. Raise it when layout or meaning changes; others are refused."""
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

    large: left in the file by readers until a row is asked for.
    """

    dtype: np.dtype
    shape: tuple[int, ...]
    large: bool

    def lengths(self, vertices: int, code: int) -> tuple[int, ...]:
        """Return the axes of a row in a corpus of such skins and codes."""
        known = {VERTICES: vertices, CODE: code}
        return tuple(known.get(length, length) for length in self.shape)


VERTICES, CODE = -1, -2
"""Lengths of axes that a corpus has: of its skins, and of its people's codes."""
FARTHEST = 10_000.0
"""[mm] Most of a derivative."""


def column(dtype: Any, *shape: int, large: bool = False) -> Any:
    """Make a field of a table; see `Column`."""
    return field(metadata={"column": Column(np.dtype(dtype), shape, large)})


def moved_column(*shape: int) -> Any:
    """Make a field of displacements [mm] in float16, large."""
    return column(np.float16, *shape, 3, large=True)


def text_column() -> Any:
    """Make a field of texts."""
    return column(f"S{LONGEST}")


def columns_of(kind: type) -> dict[str, Column]:
    """Return the columns of a table's class by name."""
    return {item.name: item.metadata["column"] for item in fields(kind)}


@dataclass(frozen=True, eq=False)
class Persons:
    """The one person: code (1, c), neutral skin (1, n, 3) [mm], and shapes (1, 52, n, 3) [mm]."""

    code: Floats = column(np.float64, CODE)
    skin: Singles = column(np.float32, VERTICES, 3, large=True)
    shapes: Halves = moved_column(WEIGHTS, VERTICES)


@dataclass(frozen=True, eq=False)
class Groups:
    """The G parameter sets: number of the plan, kind, varied (G, P), coefficients (G, P, 1 + WAVES), see `mixture`.

    settled (G, n, 3) [mm]: how far the neutral skin moved; carried (G, n, 3) [mm]: how far scaled bones carry it;
    status: accepted, or why it did not settle.
    """

    number: Numbers = column(np.int64)
    kind: Texts = text_column()
    varied: NDArray[np.bool_] = column(bool, len(NAMES))
    coefficients: Singles = column(np.float32, len(NAMES), 1 + WAVES)
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

    group: Numbers = column(np.int64)
    recording: Texts = text_column()
    frame: Numbers = column(np.int64)
    weights: Singles = column(np.float32, WEIGHTS)
    corrected: Halves = moved_column(VERTICES)
    moved: Singles = column(np.float32, 2)
    status: Texts = text_column()
    iterations: Numbers = column(np.int64)
    residual: Singles = column(np.float32)
    smallest_volume_ratio: Singles = column(np.float32)
    inverted: Numbers = column(np.int64)
    crossings: Numbers = column(np.int64)


@dataclass(frozen=True, eq=False)
class Sequences:
    """The Q sequences of L frames: as Statics, with an axis L; and the two frames before them.

    before (Q, 2, n, 3) [mm]: the skins of the two frames before the first, less S of the first; rotations
    (Q, L, 3, 3): of the head in the room, by which its flesh was shaken (see `reference.face.dynamics`; in the two
    frames before by `extrapolate_turns` of these). A sequence is accepted as a whole.
    """

    group: Numbers = column(np.int64)
    recording: Texts = text_column()
    frame: Numbers = column(np.int64)
    weights: Singles = column(np.float32, LENGTH, WEIGHTS)
    rotations: Singles = column(np.float32, LENGTH, 3, 3)
    before: Halves = moved_column(2, VERTICES)
    corrected: Halves = moved_column(LENGTH, VERTICES)
    status: Texts = text_column()
    iterations: Numbers = column(np.int64, LENGTH)
    residual: Singles = column(np.float32, LENGTH)
    smallest_volume_ratio: Singles = column(np.float32, LENGTH)
    inverted: Numbers = column(np.int64, LENGTH)
    crossings: Numbers = column(np.int64, LENGTH)


@dataclass(frozen=True, eq=False)
class Responses:
    """Derivatives at the R settled neutral faces: group; exact: of the energy's own Hessian, not of a projected one.

    offset (R, n, 3) [mm]: T - S at w = 0; expressions (R, 52, n, 3) [mm]: d(T - S)/dw.
    """

    group: Numbers = column(np.int64)
    exact: NDArray[np.bool_] = column(bool)
    offset: Halves = moved_column(VERTICES)
    expressions: Halves = moved_column(WEIGHTS, VERTICES)


@dataclass(frozen=True, eq=False)
class References:
    """The M answers of FEniCSx: static (row of Statics), law ("PD" or "neo-Hookean"), corrected = T - S (M, n, 3).

    PD's energy is solved on quadratic tets, the neo-Hookean law on the corpus' own cells. A law that has no counterpart
    of a face's p, such as a stiffness that varies, has no row.
    """

    static: Numbers = column(np.int64)
    law: Texts = text_column()
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
    references: References
    seconds: dict[str, float] = field(default_factory=dict)


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


class UnreadableError(InputError):
    """A shard is there, but the system does not let it be read: whether it is whole is not known."""


@dataclass(frozen=True)
class Label:
    """The attributes of a shard but its checksum: corpus, person, format, version of the software."""

    owner: str
    identity: int
    format: int
    version: str


def write_shard(path: Path, shard: Shard, owner: str, identity: int) -> None:
    """Write the shard of a person of the corpus `owner`, and its seconds beside it; InputError if one cannot be.

    `path` is whole or as it was.
    """
    write_whole(seconds_path(path), json.dumps(shard.seconds).encode())
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="`product` is deprecated")  # in Debian's h5py
        label = Label(owner, identity, FORMAT, version("softdeca"))
        file.attrs.update(asdict(label) | {"checksum": UNSEALED})
        for table, kind in TABLES.items():
            for item in fields(kind):
                file.create_dataset(f"{table}/{item.name}", data=getattr(getattr(shard, table), item.name))
    write_whole(path, seal(buffer.getvalue()))


def read_label(path: Path) -> Label:
    """Read a shard's label alone; InputError for a file that is missing or no shard, UnreadableError as `_open`."""
    with _open(path) as file:
        return _read_label(path, file)


def seconds_path(path: Path) -> Path:
    """Return the place of a shard's processor seconds: the file of its name that ends in .json."""
    return path.with_suffix(".json")


def read_seconds(path: Path) -> dict[str, float]:
    """Read the processor seconds by phase that a shard took; empty if the file beside it is missing or damaged.

    It holds numbers from 0 to SPENT by name.
    """
    try:
        spent = read_json(seconds_path(path)).items()
        return {phase: number(phase, each, least=0.0, most=SPENT) for phase, each in spent}
    except (InputError, AttributeError):
        return {}


def read_shard(path: Path, owner: str, identity: int) -> Shard:
    """Read a person's shard; InputError for one that is missing, damaged, or of another version, corpus or person.

    UnreadableError for one that is locked, or that the system does not let be read. Its seconds are left to
    `read_seconds`.
    """
    with _open(path) as file:
        label = _read_label(path, file)
        if not is_sealed(_read_whole(path), str(file.attrs["checksum"])):
            raise InputError(f"shard {path}: its content does not match its checksum; {_REMEDY}")
        if label.owner != owner:
            raise InputError(
                f"shard {path}: of another corpus ({quote(label.owner, 80)}, expected {quote(owner, 80)}): its plan or "
                "template differs"
            )
        if label.identity != identity:
            raise InputError(f"shard {path}: of another person, {label.identity}, expected {identity}; {_REMEDY}")
        tables = {
            table: kind(**{item.name: file[f"{table}/{item.name}"][()] for item in fields(kind)})
            for table, kind in TABLES.items()
        }
    return Shard(**tables)


def read_arrays_of(path: Path, *names: str) -> dict[str, NDArray[Any]]:
    """Read some arrays of a shard that was checked, by "table/name"."""
    with _open(path) as file:
        return {name: np.asarray(file[name][()]) for name in names}


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
    """Return the places of some arrays of a shard that was checked, by "table/name"."""
    with _open(path) as file:
        return {name: Place(file[name].id.get_offset() or 0, file[name].dtype, file[name].shape) for name in names}


@contextmanager
def _open(path: Path) -> Iterator[h5py.File]:
    """Open an HDF5 file; errors of its library within become InputError, those of the system UnreadableError."""
    try:
        if not path.is_file():
            raise InputError(f"shard {path}: missing; {_REMEDY}")
        with _open_locked(path) as file:
            yield file
    except (OSError, KeyError, RuntimeError, ValueError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        if isinstance(error, OSError) and error.errno is not None:  # the library tells damage without a number
            in_use = "; another program has it open" if isinstance(error, BlockingIOError) else ""
            raise UnreadableError(f"shard {path}: cannot be read ({os.strerror(error.errno)}{in_use})") from None
        cause = str(error).splitlines()[0][:60] if str(error) else type(error).__name__
        raise InputError(f"shard {path}: truncated or damaged ({cause}); {_REMEDY}") from None


def _open_locked(path: Path) -> h5py.File:
    """Open a file with the library's lock, where its disk has locks."""
    try:
        return h5py.File(path, "r")
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
    return h5py.File(path, "r", locking=False)


def _read_whole(path: Path) -> bytes:
    SHARD_BYTES.check(str(path), path.stat().st_size)
    return path.read_bytes()


def _read_label(path: Path, file: h5py.File) -> Label:
    attributes = file.attrs
    if attributes["format"] != FORMAT:
        raise InputError(
            f"shard {path}: of format {quote(attributes['format'])}, this version reads {FORMAT}; {_REMEDY}"
        )
    return Label(str(attributes["owner"]), int(attributes["identity"]), FORMAT, str(attributes["version"]))
