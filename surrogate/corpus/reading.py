"""Random access to a corpus for training: small arrays in memory, large ones read row by row from the shards.

No file stays open between two rows, so nothing is shared across forks, and memory does not grow over an epoch.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32, Ints, Surface
from .face import Derivatives, Frames, KeptFace, Person
from .folder import Corpus
from .heads import Heads
from .mixture import ParameterSet
from .plan import SPLITS, Split
from .shard import ACCEPTED, TABLES, Place, columns_of, places_of, read_arrays_of

if TYPE_CHECKING:
    import torch

Row = dict[str, Any]
OF_GROUPS = ("groups/kind", "groups/varied", "groups/coefficients", "groups/number", "persons/code")
READ = [table for table in TABLES if table != "persons"]
SMALL = {table: [n for n, column in columns_of(TABLES[table]).items() if not column.large] for table in READ}
LARGE = {table: [n for n, column in columns_of(TABLES[table]).items() if column.large] for table in READ}
"""Columns of each table that readers keep in memory, and those that they read row by row."""


@dataclass(frozen=True, eq=False)
class _Person:
    """A shard's small arrays and the places of its large ones."""

    path: Path
    code: NDArray
    kinds: NDArray
    coefficients: NDArray
    varied: NDArray
    small: dict[str, NDArray]
    places: dict[str, Place]
    skin: Place
    shapes: Place
    settled: Place
    carried: Place


class Table:
    """The accepted rows of one table ("statics", "sequences", "responses", ...) of a split of a corpus, or of both.

    A row is a dict: identity, code (c,), varied (P,), coefficients (P, 1 + WAVES), and the fields of the table as
    `shard` says, without the first axis. With `partial`, people that are not there yet are left out. `share` of the
    people, the first of them, have rows. Raises InputError for a folder that is no corpus, an unknown table or split,
    shards that are missing, damaged or of another person (each is read whole once, see `intact`), and where no row is
    accepted.
    """

    def __init__(
        self,
        folder: str | PathLike[str],
        table: str,
        split: Split | None,
        *,
        partial: bool = False,
        share: float = 1.0,
    ):
        if table not in SMALL or split not in (None, *SPLITS):
            raise InputError(f"corpus: no table {table!r} of split {split!r}; there are {', '.join(SMALL)}")
        self.folder, self.table = Path(folder), table
        self.corpus = Corpus.open(folder)
        self.mean = self.corpus.mean
        people, first = self.corpus.plan.identities, self.corpus.plan.trained
        numbers = {"train": range(first), "test": range(first, people), None: range(people)}[split]
        there = [k for k in numbers if self.corpus.shard_path(k).exists()]
        if len(there) < len(numbers) and not partial:
            first = next(k for k in numbers if k not in there)
            raise InputError(
                f"corpus {folder}: {len(there)} of {len(numbers)} people of the {split or 'whole'} split are there, "
                f"{self.corpus.shard_path(first).name} is missing; `softdeca corpus generate --out {folder}` makes "
                "them, --partial takes those that are there"
            )
        chosen = there[: round(share * len(there))]
        self._people = {k: self._person(k) for k in chosen}
        rows = [(k, row) for k, person in self._people.items() for row in _find_accepted(person.small)]
        if not rows:
            raise InputError(
                f"corpus {folder}: nothing of {table} in the {split or 'whole'} split was accepted; see its status"
            )
        self.rows = np.array(rows)

    def _person(self, identity: int) -> _Person:
        path = self.corpus.shard_path(identity)
        self.corpus.check(identity)
        names = {name: f"{self.table}/{name}" for name in SMALL[self.table]}
        large = {name: f"{self.table}/{name}" for name in LARGE[self.table]}
        arrays = read_arrays_of(path, self.corpus.owner, *OF_GROUPS, *names.values())
        places = places_of(path, "persons/skin", "persons/shapes", "groups/settled", "groups/carried", *large.values())
        return _Person(
            path=path,
            code=arrays["persons/code"][0],
            kinds=arrays["groups/kind"],
            coefficients=arrays["groups/coefficients"],
            varied=arrays["groups/varied"],
            small={name: arrays[key] for name, key in names.items()},
            places={name: places[key] for name, key in large.items()},
            skin=places["persons/skin"],
            shapes=places["persons/shapes"],
            settled=places["groups/settled"],
            carried=places["groups/carried"],
        )

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def groups(self) -> NDArray[np.int64]:
        """Identity and number of the parameter set among the person's, of each row that has one, shape (rows, 2)."""
        if self.table == "groups":
            return self.rows
        return np.array([(k, self._people[k].small["group"][row]) for k, row in self.rows.tolist()])

    def __getitem__(self, index: int) -> Row:
        identity, row = self.rows[index]
        person = self._people[int(identity)]
        return self.described(index) | {name: place.row(person.path, int(row)) for name, place in person.places.items()}

    def described(self, index: int) -> Row:
        """Return a row without its large fields; nothing is read for it."""
        identity, row = self.rows[index]
        person = self._people[int(identity)]
        small = {name: values[row] for name, values in person.small.items()}
        described: Row = {"identity": identity, "code": person.code, **small}
        if self.table == "groups" or "group" in small:
            group = row if self.table == "groups" else small["group"]
            described |= {"kind": person.kinds[group], "varied": person.varied[group]}
            described["coefficients"] = person.coefficients[group]
        return described

    def parameters(self, index: int) -> ParameterSet:
        """Return the parameter set of a row's group."""
        row = self.described(index)
        return ParameterSet(row["kind"].decode(), row["varied"], row["coefficients"])

    def person(self, identity: int) -> Person:
        """Read a person's code, neutral skin and shapes."""
        code = np.asarray(self._people[int(identity)].code, dtype=np.float64)
        return Person(code, self.skin(identity), self.shapes(identity))

    def carried(self, index: int) -> Floats32:
        """Read how far scaled bones carry the face of a row [mm], shape (n, 3)."""
        identity, group = self.groups[index].tolist()
        person = self._people[identity]
        return person.carried.row(person.path, group).astype(np.float32)

    def face(self, index: int, heads: Heads | None = None) -> KeptFace:
        """Read the face of a row; with derivatives where the table is of responses."""
        identity, group = self.groups[index].tolist()
        person = self._people[identity]
        settled, carried = person.settled.row(person.path, group), self.carried(index)
        derivatives = self.derivatives(index) if self.table == "responses" else None
        return KeptFace(identity, self.person(identity), self.parameters(index), settled, carried, derivatives, heads)

    def derivatives(self, index: int) -> Derivatives:
        """Read the face of a row to first order; of the table of responses alone."""
        row = self[index]
        return Derivatives(row["offset"], row["expressions"], bool(row["exact"]))

    def skin(self, identity: int) -> Surface:
        """Read a person's neutral skin [mm]."""
        person = self._people[int(identity)]
        return Surface(person.skin.row(person.path, 0).astype(np.float64), self.mean.triangles)

    def shapes(self, identity: int) -> NDArray:
        """Read what each of the 52 shapes adds to a person's skin [mm], shape (52, n, 3)."""
        person = self._people[int(identity)]
        return person.shapes.row(person.path, 0)


def _find_accepted(small: dict[str, NDArray]) -> NDArray[np.int64]:
    if "status" not in small:
        return np.arange(len(next(iter(small.values()))))
    return np.flatnonzero(small["status"] == ACCEPTED.encode())


class Faces:
    """The faces of a split of a corpus, or of both; read as they are asked for.

    Those with derivatives. `partial`, `share` and errors: as of `Table`. heads: who fits the people's heads; by default
    the corpus' folder says so.
    """

    def __init__(
        self,
        folder: str | PathLike[str],
        split: Split | None,
        *,
        partial: bool = False,
        share: float = 1.0,
        heads: Heads | None = None,
    ):
        self.heads = Heads.from_corpus(folder) if heads is None else heads
        self._table = Table(folder, "responses", split, partial=partial, share=share)
        self._open_statics = lambda: Table(folder, "statics", split, partial=partial, share=share)
        self.groups = self._table.groups

    def __len__(self) -> int:
        return len(self.groups)

    @property
    def folder(self) -> Path:
        """The corpus' folder."""
        return self._table.folder

    @property
    def mean(self) -> Surface:
        """The mean skin of the space [mm]."""
        return self._table.mean

    @property
    def space(self) -> str:
        """The name of the people's space."""
        return self._table.corpus.space

    @property
    def has_frames(self) -> bool:
        """Whether static frames were planned; preset "faces" has none."""
        return self._table.corpus.plan.frames > 0

    def code(self, index: int) -> Floats:
        """Return the code (c,) of a face's person."""
        return np.asarray(self._table.described(index)["code"], dtype=np.float64)

    def coefficients(self, index: int) -> Floats:
        """Return a face's coefficients of STATIC (P, 1 + WAVES)."""
        return self._table.parameters(index).static

    def face(self, index: int) -> KeptFace:
        """Read one face."""
        return self._table.face(index, self.heads)

    def derivatives(self, index: int) -> Derivatives:
        """Read one face to first order."""
        return self._table.derivatives(index)

    def carried(self, index: int) -> Floats32:
        """Read how far scaled bones carry a face [mm], shape (n, 3)."""
        return self._table.carried(index)

    def skin(self, identity: int) -> Surface:
        """Read a person's neutral skin [mm]."""
        return self._table.skin(identity)

    def person(self, identity: int) -> Person:
        """Read a person's code, neutral skin and shapes."""
        return self._table.person(identity)

    @cached_property
    def _statics(self) -> Table:
        return self._open_statics()

    @cached_property
    def frames_of(self) -> list[Ints]:
        """Rows of each face's accepted static frames; InputError where the split has none."""
        rows: dict[tuple[int, int], list[int]] = {}
        for row, (identity, group) in enumerate(self._statics.groups.tolist()):
            rows.setdefault((identity, group), []).append(row)
        return [np.array(rows.get(key, []), dtype=np.int64) for key in map(tuple, self.groups.tolist())]

    def spread(self, count: int) -> list[int]:
        """List the numbers of so many faces with frames, spread over all of them."""
        numbers = np.flatnonzero([len(rows) > 0 for rows in self.frames_of])
        return sorted({int(numbers[int(k)]) for k in np.linspace(0, len(numbers) - 1, count)}) if len(numbers) else []

    def frames(self, index: int, chosen: Ints | None = None) -> Frames:
        """Read a face's accepted static frames, or those of the given numbers."""
        rows = self.frames_of[index] if chosen is None else self.frames_of[index][chosen]
        read = [self._statics[int(row)] for row in rows]
        n = len(self.mean.vertices)
        return Frames(
            np.array([row["weights"] for row in read], dtype=np.float32).reshape(-1, 52),
            np.array([row["corrected"] for row in read]).reshape(-1, n, 3),
        )


class CorpusDataset:
    """The accepted rows of a table of a corpus as tensors, for torch's loaders; see `Table` for names and errors.

    Texts are left out; T - S stays float16. Several workers may read: no file is open between two rows.
    `partial`: of a corpus that is not complete, the people that are there.
    """

    def __init__(self, folder: str | PathLike[str], split: Split, *, table: str = "statics", partial: bool = False):
        self.table = Table(folder, table, split, partial=partial)

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        import torch

        if not -len(self) <= index < len(self):
            raise IndexError(index)
        row = self.table[index]
        return {name: torch.as_tensor(np.asarray(value)) for name, value in row.items() if value.dtype.kind != "S"}
