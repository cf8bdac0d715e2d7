"""People of spaces whom a corpus simulates, by name, as a command line has them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from ...lhm import fit_head, identities, load_template
from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Surface
from ...lhm.base.progress import OnProgress, silent
from ...lhm.head.head import LayeredHead
from ...lhm.identities import LinearSpace
from ...lhm.template.template import DEFAULT_LEVEL
from .external import External
from .face import People, Person
from .spheres import Spheres


@dataclass(frozen=True, eq=False)
class OfSpace:
    """People of an identity space with a mean, their heads fitted by `fit`, such as partial(fit_head, template)."""

    space: LinearSpace | Spheres
    mean: Surface
    fit: object
    digest: str = ""

    @property
    def name(self) -> str:
        """The space's."""
        return self.space.name

    @property
    def code_size(self) -> int:
        """The space's."""
        return self.space.code_size

    def person(self, rng: np.random.Generator) -> Person:
        """Draw a sample of the space."""
        code, skin = self.space.sample(rng)
        return Person(np.asarray(code, dtype=np.float64), skin, self.space.expression_deltas(code))

    def head(self, person: Person) -> LayeredHead:
        """Fit the head of the person's skin."""
        return self.fit(person.skin)  # type: ignore[operator]


def people_from_text(text: str, *, level: int = DEFAULT_LEVEL, on_progress: OnProgress = silent) -> People:
    """Return the people of "anny", "ict:FILE", "flame:FILE" or "folder:DIR", with heads of the template at a level.

    "external:SPACE" are those of another space in the default's triangles, with shapes of their own: see `external`.
    "spheres:N" are layered spheres of N subdivisions, 1 to 4, which cost nothing: see `Spheres`.

    InputError for another text.
    """
    kind, _, other = text.partition(":")
    if kind == "spheres":
        if other not in ("1", "2", "3", "4"):
            raise InputError(f"identities {text!r}: expected 'spheres:' and 1 to 4 subdivisions")
        spheres = Spheres(int(other))
        return OfSpace(spheres, spheres.mean, spheres.fit)
    if kind == "external":
        if not other:
            raise InputError(f"identities {text!r}: expected 'external:' and a space, as 'external:ict:FILE'")
        return External.of(identities.from_text(other), level=level, on_progress=on_progress)
    space = identities.from_text(text)
    template = load_template(space, level=level, progress=on_progress)
    return OfSpace(space, space.mean, partial(fit_head, template), template.digest)
