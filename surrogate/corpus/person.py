"""A person as a corpus simulates one: code, neutral skin, and the 52 shapes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...lhm.base.mesh import Floats, Surface
from ...lhm.head import LayeredHead
from ...lhm.identities import IdentitySpace


@dataclass(frozen=True, eq=False)
class Person:
    """Identity code (c,), neutral skin [mm], and what each shape adds to it [mm], shape (52, n, 3).

    `personal` says that the shapes are this person's own, and do not follow from the code.
    """

    code: Floats
    skin: Surface
    shapes: Floats
    personal: bool = False


class People(Protocol):
    """Whoever a corpus simulates; has to be picklable for other processes."""

    @property
    def name(self) -> str:
        """The name by which corpora and checkpoints know them."""
        ...

    @property
    def mean(self) -> Surface:
        """The mean neutral skin [mm], whose triangles all share."""
        ...

    @property
    def digest(self) -> str:
        """A name for all that heads are made from, such as a template's digest; empty where nobody tells."""
        ...

    def person(self, rng: np.random.Generator) -> Person:
        """Somebody at random."""
        ...

    def head(self, person: Person) -> LayeredHead:
        """That person's layered head; FitError where there is none."""
        ...


@dataclass(frozen=True, eq=False)
class OfSpace:
    """People of an identity space with a mean, their heads fitted by `fit`, such as partial(fit_head, template)."""

    space: IdentitySpace
    mean: Surface
    fit: object
    digest: str = ""

    @property
    def name(self) -> str:
        """The space's."""
        return self.space.name

    def person(self, rng: np.random.Generator) -> Person:
        """A sample of the space."""
        code, skin = self.space.sample(rng)
        return Person(np.asarray(code, dtype=np.float64), skin, self.space.expression_deltas(code))

    def head(self, person: Person) -> LayeredHead:
        """The head that `fit` makes of the skin."""
        return self.fit(person.skin)  # type: ignore[operator]
