"""Who fits the heads of a corpus' people."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from os import PathLike

from ...lhm.base.errors import InputError
from ...lhm.base.progress import OnProgress, silent
from ...lhm.head.head import LayeredHead
from .face import Person
from .folder import Corpus
from .people import People, people_from_text


@dataclass(eq=False)
class Heads:
    """Fits heads of people whom `make` makes when a head is first asked for; the last head is kept."""

    make: Callable[[], People]

    def __post_init__(self):
        self._last: tuple[bytes, LayeredHead] | None = None

    @classmethod
    def from_corpus(cls, folder: str | PathLike[str], on_progress: OnProgress = silent) -> Heads:
        """Fit the heads of a corpus' people, as its folder says how."""

        def make() -> People:
            identities, level = Corpus.open(folder).known_people
            return people_from_text(identities, level=level, on_progress=on_progress)

        return cls(make)

    @cached_property
    def people(self) -> People:
        """Who they are; InputError where nobody fits their heads."""
        try:
            return self.make()
        except InputError as error:
            raise InputError(f"a head of each person is needed, but {error}") from None

    def fit(self, person: Person) -> LayeredHead:
        """Fit the head of a person anew. Raises what `people` and fitting raise."""
        return self.people.head(person)

    def head(self, person: Person) -> LayeredHead:
        """Return the head of a person, fitted unless it was the last."""
        key = person.skin.vertices.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self.fit(person)
        return self._last[1]
