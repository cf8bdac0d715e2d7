"""A person under one parameter set: how the neutral face settles, its first order, and frames of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32, Surface
from .mixture import ParameterSet

MOVED = 500.0
"""[mm] Most that a vertex moves by a shape, by p, or by physics: two heads' width."""


@dataclass(frozen=True, eq=False)
class Person:
    """Identity code (c,), neutral skin [mm], and what each of the person's shapes adds to it [mm], shape (52, n, 3)."""

    code: Floats
    skin: Surface
    shapes: Floats


@dataclass(frozen=True, eq=False)
class Derivatives:
    """A face to first order [mm]: T - S at w = 0, `offset` (n, 3), and d(T - S)/dw there, `responses` (52, n, 3).

    exact: by the energy's own Hessian, not by a projected one.
    """

    offset: np.ndarray
    responses: np.ndarray
    exact: bool = True


@dataclass(frozen=True, eq=False)
class Face:
    """Person number `identity` under `parameters`.

    settled (n, 3) [mm]: how far p moves the neutral skin before targets hold it there. derivatives: None where a corpus
    has only the neutral face.
    """

    identity: int
    person: Person
    parameters: ParameterSet
    settled: np.ndarray
    derivatives: Derivatives | None = None

    @property
    def code(self) -> Floats:
        """The person's identity code (c,)."""
        return self.person.code

    @property
    def skin(self) -> Floats:
        """The person's neutral skin without p [mm], shape (n, 3)."""
        return self.person.skin.vertices

    @property
    def shapes(self) -> np.ndarray:
        """What each weight adds to the person's skin [mm], shape (52, n, 3)."""
        return self.person.shapes

    @property
    def coefficients(self) -> Floats:
        """The coefficients of STATIC, shape (P, 1 + WAVES); see `mixture`."""
        return self.parameters.static

    @property
    def offset(self) -> np.ndarray:
        """T - S at w = 0 [mm], shape (n, 3); InputError for a face without derivatives."""
        return self._first_order.offset

    @property
    def responses(self) -> np.ndarray:
        """d(T - S)/dw at w = 0 [mm], shape (52, n, 3); InputError for a face without derivatives."""
        return self._first_order.responses

    @property
    def relaxed(self) -> Floats32:
        """How far the settled face moves to rest among its targets [mm], shape (n, 3): the offset less `settled`."""
        return self.offset.astype(np.float32) - self.settled

    @property
    def _first_order(self) -> Derivatives:
        if self.derivatives is None:
            raise InputError(f"face of person {self.identity}: the corpus has no derivatives of it")
        return self.derivatives


@dataclass(frozen=True, eq=False)
class Frames:
    """Static frames of a face: weights (F, 52), and T - S (F, n, 3) [mm]."""

    weights: Floats32
    corrected: np.ndarray

    def remainder(self, face: Face) -> Floats32:
        """T - S beyond the face's first order [mm], shape (F, n, 3)."""
        linear = np.tensordot(self.weights, face.responses.astype(np.float32), axes=1)
        return self.corrected.astype(np.float32) - face.offset.astype(np.float32) - linear
