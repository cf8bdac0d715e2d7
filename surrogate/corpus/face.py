"""A person, who fits the head, and the person under one parameter set: settled, to first order, and in frames."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32, Surface
from ...lhm.head.head import LayeredHead
from ...reference.face.face import Face
from ...reference.face.tissue import CellKind
from .mixture import ParameterSet

MOVED = 500.0
"""[mm] Most that a vertex moves by a shape, by p, or by physics: two heads' width."""


@dataclass(frozen=True, eq=False)
class Person:
    """Identity code (c,), neutral skin [mm], and what each of the person's shapes adds to it [mm], shape (52, n, 3)."""

    code: Floats
    skin: Surface
    shapes: Floats


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
    def code_size(self) -> int:
        """How many numbers a person's code has."""
        ...

    @property
    def digest(self) -> str:
        """A name for all that heads are made from, such as a template's digest; empty where nobody tells."""
        ...

    def person(self, rng: np.random.Generator) -> Person:
        """Draw somebody at random."""
        ...

    def head(self, person: Person) -> LayeredHead:
        """Fit the person's layered head; FitError where there is none."""
        ...


@dataclass(eq=False)
class Heads:
    """Fits heads of people whom `make` makes when a head is first asked for; the last head is kept."""

    make: Callable[[], People]

    def __post_init__(self):
        self._last: tuple[bytes, LayeredHead] | None = None

    @cached_property
    def people(self) -> People:
        """Who they are; InputError where nobody fits their heads."""
        try:
            return self.make()
        except InputError as error:
            raise InputError(f"a head of each person is needed, but {error}") from None

    def fit(self, person: Person) -> LayeredHead:
        """Fit the head of a person without_kept. Raises what `people` and fitting raise."""
        return self.people.head(person)

    def head(self, person: Person) -> LayeredHead:
        """Return the head of a person, fitted unless it was the last."""
        key = person.skin.vertices.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self.fit(person)
        return self._last[1]


def name_person(code: Floats) -> str:
    """Name a person by the identity code (c,): 16 hexadecimal digits, by which weights know whom they learned from."""
    return hashlib.sha256(np.ascontiguousarray(code, dtype="<f8").tobytes()).hexdigest()[:16]


def surface_hash(surface: Surface) -> str:
    """Name a mean skin by its triangles, and its vertices to 0.01 mm: 16 hexadecimal digits.

    Corpora and weights tell theirs from others by it.
    """
    digest = hashlib.sha256(np.ascontiguousarray(surface.triangles, dtype="<i8").tobytes())
    digest.update(np.round(surface.vertices * 100.0).astype("<i8").tobytes())
    return digest.hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Derivatives:
    """A face to first order [mm]: T - S at w = 0, `offset` (n, 3), and d(T - S)/dw there, `responses` (52, n, 3).

    exact: by the energy's own Hessian, not by a projected one.
    """

    offset: np.ndarray
    responses: np.ndarray
    exact: bool = True


@dataclass(frozen=True, eq=False)
class KeptFace:
    """Person number `identity` under `parameters`, as a corpus keeps it. It answers methods as a live `Face` does.

    displacement (n, 3) [mm]: how far p moves the neutral skin before targets hold it there; kept_carried (n, 3) [mm]:
    how far scaled bones carry it. What is None is asked for without_kept, of `live`. cells: of its simulation.
    """

    identity: int
    person: Person
    parameters: ParameterSet
    displacement: np.ndarray
    kept_carried: np.ndarray | None
    derivatives: Derivatives | None = None
    heads: Heads | None = None
    cells: CellKind = "prisms"

    @property
    def code(self) -> Floats:
        """The person's identity code (c,)."""
        return self.person.code

    @property
    def skin(self) -> Surface:
        """The person's neutral skin without p [mm]."""
        return self.person.skin

    @property
    def shapes(self) -> np.ndarray:
        """Displacements of the person's skin by each weight [mm], shape (52, n, 3)."""
        return self.person.shapes

    @property
    def coefficients(self) -> Floats:
        """The coefficients of STATIC, shape (P, 1 + WAVES); see `mixture`."""
        return self.parameters.static

    def blend(self, weights) -> Floats:
        """Blend the shapes [mm], shape (..., n, 3), without p: S of weights (..., 52)."""
        return self.skin.vertices + np.tensordot(weights, self.shapes, axes=1)

    @cached_property
    def live(self) -> Face:
        """The face on a head that is fitted without_kept; InputError where nobody fits the person's head."""
        if self.heads is None:
            raise InputError(f"face of person {self.identity}: a head is needed, but nobody fits it")
        head = self.heads.head(self.person)
        parameters = self.parameters.parameters(head, self.heads.people.mean)
        shapes, choices = np.asarray(self.shapes, dtype=np.float64), {"cells": self.cells}
        return Face(head, shapes, parameters, per="wraps", code=self.code, choices=choices)

    def without_kept(self) -> KeptFace:
        """Return the face without what a corpus keeps of its simulation, and of its head where bones are scaled."""
        heads = None if self.heads is None else replace(self.heads)
        unscaled = self.kept_carried is not None and not self.kept_carried.any()
        return replace(self, derivatives=None, kept_carried=self.kept_carried if unscaled else None, heads=heads)

    @cached_property
    def carried(self) -> Floats32:
        """Displacement of the neutral skin with scaled bones [mm], shape (n, 3)."""
        carried = self.live.carried if self.kept_carried is None else self.kept_carried
        return carried.astype(np.float32)

    @property
    def offset(self) -> np.ndarray:
        """T - S at w = 0 [mm], shape (n, 3)."""
        return self.live.offset if self.derivatives is None else self.derivatives.offset

    @property
    def responses(self) -> np.ndarray:
        """d(T - S)/dw at w = 0 [mm], shape (52, n, 3)."""
        return self.live.responses if self.derivatives is None else self.derivatives.responses

    @property
    def relaxed(self) -> Floats32:
        """Displacement of the settled face to its rest among its targets [mm], shape (n, 3)."""
        return self.offset.astype(np.float32) - self.displacement


@dataclass(frozen=True, eq=False)
class Frames:
    """Static frames of a face: weights (F, 52), and T - S (F, n, 3) [mm]."""

    weights: Floats32
    corrected: np.ndarray

    def remainder(self, offset: np.ndarray, responses: np.ndarray) -> Floats32:
        """T - S beyond the face's first order [mm], shape (F, n, 3); see `Derivatives`."""
        linear = np.tensordot(self.weights, responses.astype(np.float32), axes=1)
        return self.corrected.astype(np.float32) - offset.astype(np.float32) - linear
