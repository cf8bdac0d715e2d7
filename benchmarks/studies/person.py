"""The person whose head a study measures."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np

from ...lhm import expressions, fit_head, identities, load_template
from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Surface
from ...lhm.head.head import LayeredHead
from ...lhm.identities.space import LinearSpace
from ...lhm.template.template import DEFAULT_LEVEL
from ...reference import Face, Parameters
from ...reference.added import all_solvers
from ...surrogate.runtime import Surrogate
from ..harness.study import Study


def check_known(name: str, values: Sequence[str], known: Iterable[str]) -> None:
    """Refuse a value that is none of the known ones by an InputError that lists them."""
    for value in values:
        if value not in known:
            raise InputError(f"unknown {name} {value!r}; there are {', '.join(known)}")


def parse_solvers(solvers: Sequence[str]) -> tuple[str, ...]:
    """Give these solvers, or all where none is named; InputError for an unknown one."""
    check_known("solver", solvers, all_solvers())
    return tuple(solvers) or all_solvers()


@dataclass(frozen=True, eq=False)
class Person:
    """A head, the space whose triangles it has, and its code there; None where it is none of that space's people."""

    space: LinearSpace
    code: Floats | None
    head: LayeredHead
    fit_s: float | None = None
    """Processor time [s] that the head took to fit, where it was measured."""

    def face(self, parameters: Parameters, contact: Sequence[str] = ()) -> Face:
        """Give the face under p, local values one per triangle of the wraps; regions in contact by name."""
        choices = {"contact": contact} if contact else {}
        return Face(self.head, self.shapes, parameters, per="wraps", code=self.code, choices=choices)

    @property
    def shapes(self) -> Floats:
        """Shapes that the 52 weights add to the skin [mm], shape (52, n, 3)."""
        return self.space.shapes_on(self.head.skin) if self.code is not None else self.space.transfer_to(self.head.skin)

    def change(self, skin: Surface, level: int) -> Person:
        """Fit a head of a level to another skin of the same triangles."""
        return Person(self.space, None, fit_head(load_template(self.space, level=level), skin))

    def shape(self, text: str) -> Floats:
        """Give the skin [mm], shape (n, 3), of an expression as jawOpen*0.5+cheekPuff, by blendshapes."""
        return self.blend(expressions.parse_weights(text))

    def blend(self, weights: Floats) -> Floats:
        """Give the skins [mm], shape (..., n, 3), of weights (..., 52)."""
        return self.head.skin.vertices + np.tensordot(weights, self.shapes, axes=1)


def find_network(weights: str, whose: str) -> Surrogate | None:
    """Load the weights of a file, or for an empty text those that are shipped for a space, if there are any."""
    if weights:
        return Surrogate.load(Path(weights))
    shipped = Surrogate.load()
    return shipped if shipped.space == identities.from_text(whose).name else None


WHOSE = "'anny' (the default head), ict:FILE or flame:FILE"
"""Help of an option that says whose heads."""


@dataclass(frozen=True)
class OfPerson(Study):
    """A study of one head, by default the default space's of seed 0; a subclass may make options of whose it is."""

    needs: ClassVar[tuple[str, ...]] = ("people", "heads")

    identities: str = "anny"
    seed: int = 0
    level: int = DEFAULT_LEVEL

    def person(self, level: int | None = None, seed: int | None = None) -> Person:
        """Give the head of the study's seed and level, or of others; made once per process."""
        return person(self.identities, self.seed if seed is None else seed, level or self.level)

    def check(self, texts: Sequence[str] = ()) -> None:
        """Refuse a space or expressions that cannot be read."""
        identities.from_text(self.identities)
        for text in texts:
            expressions.parse_weights(text)


@lru_cache(maxsize=3)
def person(whose: str = "anny", seed: int | None = 0, level: int = DEFAULT_LEVEL) -> Person:
    """Fit the head of a seed in a space ('anny', ict:FILE, flame:FILE, folder:DIR); None is its mean."""
    space = identities.from_text(whose)
    code = np.zeros(space.code_size)
    skin = space.skin(code)
    if seed is not None:
        code, skin = space.sample(np.random.default_rng(seed))
    template, begin = load_template(space, level=level), time.process_time()
    head = fit_head(template, skin)
    return Person(space, code, head, time.process_time() - begin)
