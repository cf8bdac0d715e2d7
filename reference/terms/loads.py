"""Loads: gravity and traction, which are dead, and a pressure that follows the surface."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ...lhm.base.mesh import Floats
from .term import Amount, Mesh, OnTets, OnTriangles, as_vector


@dataclass(frozen=True, eq=False)
class Gravity(OnTets):
    """Dead load density · acceleration per rest volume; acceleration [mm/s²], shape (3,), density [kg/mm³]."""

    varying: ClassVar[tuple[str, ...]] = ("acceleration", "density")
    amounts: ClassVar[dict[str, Amount]] = {"density": Amount(0.0)}

    acceleration: np.ndarray
    density: float | np.ndarray
    tets: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        super().__post_init__()
        self._set(acceleration=as_vector("Gravity.acceleration", self.acceleration))

    def add_load(self, mesh: Mesh, forces: Floats):
        forces += self.lump(mesh, self.density)[:, None] * self.acceleration


@dataclass(frozen=True, eq=False)
class Traction(OnTriangles):
    """Dead load `vector` [kPa] per rest area on triangles (k, 3) of the scene's vertices."""

    varying: ClassVar[tuple[str, ...]] = ("vector",)

    triangles: np.ndarray = field(repr=False)
    vector: np.ndarray

    def __post_init__(self):
        super().__post_init__()
        self._set(vector=as_vector("Traction.vector", self.vector))

    def add_load(self, mesh: Mesh, forces: Floats):
        thirds = np.repeat(self.areas(mesh.vertices) / 3.0, 3)
        lumped = np.bincount(self.triangles.ravel(), thirds, minlength=len(forces))
        forces += lumped[:, None] * self.vector


@dataclass(frozen=True, eq=False)
class Pressure(OnTriangles):
    """Follower pressure `value` [kPa] against the outer side of triangles (k, 3), along their present normals.

    The outer side is the one that sees the corners counter-clockwise. One number, or one per triangle; negative sucks.
    """

    varying: ClassVar[tuple[str, ...]] = ("value",)
    amounts: ClassVar[dict[str, Amount]] = {"value": Amount(-np.inf, strict=True)}

    triangles: np.ndarray = field(repr=False)
    value: float | np.ndarray
