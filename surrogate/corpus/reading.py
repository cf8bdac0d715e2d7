"""Random access to a corpus for training: small arrays in memory, large ones read row by row from the shards.

No file stays open between two rows, so nothing is shared across forks, and memory does not grow over an epoch.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Surface
from ..surface_hash import surface_hash
from .folder import shard_path
from .intact import check_intact
from .manifest import read_manifest
from .plan import SPLITS, Split
from .shard import ACCEPTED, Place, places_of, read_arrays_of
from .template import read_template

Row = dict[str, Any]
OF_GROUPS = ("groups/kind", "groups/varied", "groups/coefficients", "groups/number", "persons/code")
SMALL: dict[str, tuple[str, ...]] = {
    "groups": ("status",),
    "statics": ("group", "weights", "status", "recording", "frame", "moved"),
    "sequences": ("group", "weights", "status", "recording", "frame", "rotations"),
    "responses": ("group", "exact"),
    "parameter_responses": ("group", "name"),
    "references": ("static", "law", "status"),
}
LARGE: dict[str, tuple[str, ...]] = {
    "groups": ("settled",),
    "statics": ("corrected",),
    "sequences": ("before", "corrected"),
    "responses": ("offset", "expressions"),
    "parameter_responses": ("change",),
    "references": ("corrected",),
}


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
        self._manifest = read_manifest(folder)
        self.template = read_template(folder)
        if not self._manifest.said["template"].startswith(surface_hash(self.template.mean)):
            raise InputError(f"corpus {folder}: template.npz is not of the mesh that corpus.json names")
        self.people = self._manifest.people
        people, first = self._manifest.counts.identities, self._manifest.counts.trained
        numbers = {"train": range(first), "test": range(first, people), None: range(people)}[split]
        there = [k for k in numbers if not partial or shard_path(self.folder, k).exists()]
        chosen = there[: round(share * len(there))]
        self._people = {k: self._person(k) for k in chosen}
        rows = [(k, row) for k, person in self._people.items() for row in _accepted(person.small)]
        if not rows:
            raise InputError(
                f"corpus {folder}: nothing of {table} in the {split or 'whole'} split was accepted; see its status"
            )
        self.rows = np.array(rows)

    def _person(self, identity: int) -> _Person:
        path = shard_path(self.folder, identity)
        check_intact(path, self._manifest, identity, len(self.template.mean.vertices))
        names = {name: f"{self.table}/{name}" for name in SMALL[self.table]}
        large = {name: f"{self.table}/{name}" for name in LARGE[self.table]}
        found = read_arrays_of(path, self._manifest.owner, *OF_GROUPS, *names.values())
        places = places_of(path, "persons/skin", "persons/shapes", "groups/settled", *large.values())
        if self.template.shapes is None and not places["persons/shapes"].shape[0]:
            raise InputError(f"shard {path}: no shapes, and none in template.npz, which is damaged")
        return _Person(
            path=path,
            code=found["persons/code"][0],
            kinds=found["groups/kind"],
            coefficients=found["groups/coefficients"],
            varied=found["groups/varied"],
            small={name: found[key] for name, key in names.items()},
            places={name: places[key] for name, key in large.items()},
            skin=places["persons/skin"],
            shapes=places["persons/shapes"],
            settled=places["groups/settled"],
        )

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def groups(self) -> NDArray[np.int64]:
        """Identity and number of the parameter set among the person's, of each row that has one, shape (rows, 2)."""
        return np.array([(k, self._people[k].small["group"][row]) for k, row in self.rows.tolist()])

    def __getitem__(self, index: int) -> Row:
        identity, row = self.rows[index]
        person = self._people[int(identity)]
        return self.described(index) | {name: place.row(person.path, int(row)) for name, place in person.places.items()}

    def described(self, index: int) -> Row:
        """A row without its large fields: nothing is read for it."""
        identity, row = self.rows[index]
        person = self._people[int(identity)]
        small = {name: values[row] for name, values in person.small.items()}
        found: Row = {"identity": identity, "code": person.code, **small}
        if self.table == "groups" or "group" in small:
            group = row if self.table == "groups" else small["group"]
            found |= {"kind": person.kinds[group], "varied": person.varied[group]}
            found["coefficients"] = person.coefficients[group]
        return found

    def small(self, index: int, name: str) -> Any:
        """One of a row's small fields, which are in memory."""
        identity, row = self.rows[index]
        return self._people[int(identity)].small[name][row]

    def settled(self, identity: int, group: int) -> NDArray:
        """By how much p moved a person's neutral skin [mm], shape (n, 3)."""
        person = self._people[int(identity)]
        return person.settled.row(person.path, int(group))

    def skin(self, identity: int) -> Surface:
        """A person's neutral skin [mm]."""
        person = self._people[int(identity)]
        return Surface(person.skin.row(person.path, 0).astype(np.float64), self.template.mean.triangles)

    def shapes(self, identity: int) -> NDArray:
        """What each of the 52 shapes adds to a person's skin [mm], shape (52, n, 3)."""
        if self.template.shapes is not None:
            return self.template.shapes
        person = self._people[int(identity)]
        return person.shapes.row(person.path, 0)


def _accepted(small: dict[str, NDArray]) -> NDArray[np.int64]:
    if "status" not in small:
        return np.arange(len(next(iter(small.values()))))
    return np.flatnonzero(small["status"] == ACCEPTED.encode())
