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
from ...reference.face.tissue import CellKind
from .face import Derivatives, Frames, Heads, KeptFace, Person, name_person
from .folder import Corpus
from .mixture import ParameterSet
from .plan import SPLITS, Split
from .shard import ACCEPTED, TABLES, Place, columns_of, places_of, read_arrays_of

if TYPE_CHECKING:
    import torch

Row = dict[str, Any]
OF_GROUPS = ("groups/kind", "groups/varied", "groups/coefficients", "persons/code")
OF_FACES = ("persons/skin", "persons/shapes", "groups/settled", "groups/carried")
"""Small and large arrays that readers of every table have."""
READ = [table for table in TABLES if table != "persons"]
SMALL = {table: [n for n, column in columns_of(TABLES[table]).items() if not column.large] for table in READ}
LARGE = {table: [n for n, column in columns_of(TABLES[table]).items() if column.large] for table in READ}
"""Columns of each table that readers keep in memory, and those that they read row by row."""


@dataclass(frozen=True, eq=False)
class _Person:
    """A shard's small arrays, of the table by name and of groups, and the places of its large ones."""

    path: Path
    small: dict[str, NDArray]
    groups: dict[str, NDArray]
    places: dict[str, Place]

    def row(self, name: str, number: int) -> NDArray:
        """Read one row of a large array."""
        return self.places[name].row(self.path, number)


class Table:
    """The accepted rows of one table ("statics", "sequences", "responses", ...) of a split of a corpus, or of both.

    A row is a dict: identity, code (c,), varied (P,), coefficients (P, 1 + WAVES), and the fields of the table as
    `shard` says, without the first axis. With `partial`, people that are not there yet are left out. `share` of the
    people, the first of them, have rows. heads: who fits the people's heads; by default the corpus' folder says so.
    Raises InputError for a folder that is no corpus, an unknown table or split, shards that are missing, damaged or of
    another person (each is read whole once), and where no row is accepted.
    """

    def __init__(
        self,
        folder: str | PathLike[str],
        table: str,
        split: Split | None,
        *,
        partial: bool = False,
        share: float = 1.0,
        heads: Heads | None = None,
    ):
        if table not in SMALL or split not in (None, *SPLITS):
            raise InputError(f"corpus: no table {table!r} of split {split!r}; there are {', '.join(SMALL)}")
        self.folder, self.table = Path(folder), table
        self.corpus = Corpus.open(folder)
        self.heads = self.corpus.heads() if heads is None else heads
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
        self._people = {k: self._open(k) for k in chosen}
        rows = [(k, row) for k, person in self._people.items() for row in _find_accepted(person.small)]
        if not rows:
            planned = any(len(next(iter(person.small.values()))) for person in self._people.values())
            why = "was accepted; see its status" if planned else "was planned"
            raise InputError(f"corpus {folder}: nothing of {table} in the {split or 'whole'} split {why}")
        self.rows = np.array(rows)

    def _open(self, identity: int) -> _Person:
        path = self.corpus.shard_path(identity)
        self.corpus.check(identity)
        small = {name: f"{self.table}/{name}" for name in SMALL[self.table]}
        large = {name: f"{self.table}/{name}" for name in LARGE[self.table]}
        arrays = read_arrays_of(path, *OF_GROUPS, *small.values())
        places = places_of(path, *OF_FACES, *large.values())
        return _Person(
            path=path,
            small={name: arrays[key] for name, key in small.items()},
            groups={key: arrays[key] for key in OF_GROUPS},
            places={key: places[key] for key in OF_FACES} | {name: places[key] for name, key in large.items()},
        )

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def groups(self) -> NDArray[np.int64]:
        """Identity and number of the parameter set among the person's, of each row that has one, shape (rows, 2)."""
        if self.table == "groups":
            return self.rows
        return np.array([(k, self._people[k].small["group"][row]) for k, row in self.rows.tolist()])

    def __getitem__(self, index: int) -> Row:
        identity, row = self.rows[index]
        person = self._people[int(identity)]
        return self.described(index) | {name: person.row(name, int(row)) for name in LARGE[self.table]}

    def described(self, index: int) -> Row:
        """Return a row without its large fields; nothing is read for it."""
        identity, row = self.rows[index]
        person = self._people[int(identity)]
        small = {name: values[row] for name, values in person.small.items()}
        described: Row = {"identity": identity, "code": person.groups["persons/code"][0], **small}
        if self.table == "groups" or "group" in small:
            group = row if self.table == "groups" else small["group"]
            described |= {name: person.groups[f"groups/{name}"][group] for name in ("kind", "varied", "coefficients")}
        return described

    def parameters(self, index: int) -> ParameterSet:
        """Return the parameter set of a row's group."""
        row = self.described(index)
        return ParameterSet(row["kind"].decode(), row["varied"], row["coefficients"])

    def person(self, identity: int) -> Person:
        """Read a person's code, neutral skin and shapes."""
        code = np.asarray(self._people[int(identity)].groups["persons/code"][0], dtype=np.float64)
        return Person(code, self.skin(identity), self.shapes(identity))

    def carried(self, index: int) -> Floats32:
        """Read how far scaled bones carry the face of a row [mm], shape (n, 3)."""
        identity, group = self.groups[index].tolist()
        return self._people[identity].row("groups/carried", group).astype(np.float32)

    def face(self, index: int) -> KeptFace:
        """Read the face of a row; with derivatives where the table is of responses."""
        identity, group = self.groups[index].tolist()
        settled, carried = self._people[identity].row("groups/settled", group), self.carried(index)
        derivatives = self.derivatives(index) if self.table == "responses" else None
        person, parameters = self.person(identity), self.parameters(index)
        cells = self.corpus.plan.cells
        return KeptFace(identity, person, parameters, settled, carried, derivatives, self.heads, cells)

    def derivatives(self, index: int) -> Derivatives:
        """Read the face of a row to first order; of the table of responses alone."""
        row = self[index]
        return Derivatives(row["offset"], row["expressions"], bool(row["exact"]))

    def skin(self, identity: int) -> Surface:
        """Read a person's neutral skin [mm]."""
        skin = self._people[int(identity)].row("persons/skin", 0)
        return Surface(skin.astype(np.float64), self.mean.triangles)

    def shapes(self, identity: int) -> NDArray:
        """Read what each of the 52 shapes adds to a person's skin [mm], shape (52, n, 3)."""
        return self._people[int(identity)].row("persons/shapes", 0)


def _find_accepted(small: dict[str, NDArray]) -> NDArray[np.int64]:
    if "status" not in small:
        return np.arange(len(next(iter(small.values()))))
    return np.flatnonzero(small["status"] == ACCEPTED.encode())


class Faces(Table):
    """The faces of a split of a corpus, or of both: its table of responses, and the static frames of each face.

    Arguments and errors are those of `Table`.
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
        super().__init__(folder, "responses", split, partial=partial, share=share, heads=heads)
        self._open_statics = lambda: Table(folder, "statics", split, partial=partial, share=share)

    @property
    def space(self) -> str:
        """The name of the people's space."""
        return self.corpus.space

    @property
    def cells(self) -> CellKind:
        """The cells of its simulations; see `facial_scene`."""
        return self.corpus.plan.cells

    @property
    def has_frames(self) -> bool:
        """Whether static frames were planned; preset "faces" has none."""
        return self.corpus.plan.frames > 0

    @property
    def people(self) -> Ints:
        """Numbers of the people, in their order."""
        return np.unique(self.groups[:, 0])

    @property
    def codes(self) -> Floats:
        """The code of each of the people, shape (k, c)."""
        return np.array([self._people[k].groups["persons/code"][0] for k in self.people.tolist()], dtype=np.float64)

    def code(self, index: int) -> Floats:
        """Return the code (c,) of a face's person."""
        return np.asarray(self.described(index)["code"], dtype=np.float64)

    def name_people(self, numbers: Ints | None = None) -> frozenset[str]:
        """Name the people of the faces of some numbers, by default of all; see `name_person`."""
        groups = self.groups if numbers is None else self.groups[numbers]
        people = np.unique(groups[:, 0]).tolist()
        return frozenset(name_person(self._people[k].groups["persons/code"][0]) for k in people)

    def coefficients(self, index: int) -> Floats:
        """Return a face's coefficients of STATIC (P, 1 + WAVES)."""
        return self.parameters(index).static

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
