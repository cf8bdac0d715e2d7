"""The energies of surfaces, over triangles of a scene's vertices: strain in the plane, bending."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from .term import Amount, Mesh, OnTriangles, as_places


@dataclass(frozen=True, eq=False)
class SurfaceStrain(OnTriangles):
    """stiffness/2 ‖F₂ - √growth R₂‖² per rest area on triangles of the scene's vertices (SoftDECA Eq. 11).

    triangles (k, 3); stiffness [mN/mm] (= 2 mu times thickness); growth > 0 is the area ratio sought; rest [mm], shape
    (scene's vertices, 3), is the shape sought, default the scene's own; the area is that of the scene.
    """

    varying: ClassVar[tuple[str, ...]] = ("growth",)
    may_soften: ClassVar[bool] = True
    amounts: ClassVar[dict[str, Amount]] = {"stiffness": Amount(0.0), "growth": Amount(0.0, strict=True)}

    triangles: np.ndarray = field(repr=False)
    stiffness: float | np.ndarray
    growth: float | np.ndarray = 1.0
    rest: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        super().__post_init__()
        self._set(rest=as_places("SurfaceStrain.rest", self.rest, None))

    def element_vertices(self, mesh: Mesh) -> Ints:
        return self.triangles

    def unit_force(self, mesh: Mesh) -> float:
        """See Term; stiffness times an edge's length."""
        return float(np.sum(self.stiffness * edge_lengths(mesh, self.triangles)))


@dataclass(frozen=True, eq=False)
class Bending(OnTriangles):
    """stiffness/2 |L x - R L X|² per rest area at the inner vertices of triangles (SoftDECA Eq. 13, signed).

    L is the cotangent Laplacian over the rest area of a vertex, R the rotation that fits its ring of edges best, so a
    bump that turns into a dent costs energy. Vertices on the border of the triangles are left free to turn.
    triangles (k, 3); stiffness [mN mm], one number or one per triangle; rest [mm], shape (scene's vertices, 3), is the
    shape sought, default the scene's own.
    """

    may_soften: ClassVar[bool] = True
    amounts: ClassVar[dict[str, Amount]] = {"stiffness": Amount(0.0)}

    triangles: np.ndarray = field(repr=False)
    stiffness: float | np.ndarray
    rest: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        super().__post_init__()
        self._set(rest=as_places("Bending.rest", self.rest, None))

    def element_vertices(self, mesh: Mesh) -> Ints:
        return self.triangles

    def unit_force(self, mesh: Mesh) -> float:
        """See Term; stiffness over an edge's length."""
        return float(np.sum(self.stiffness / edge_lengths(mesh, self.triangles)))


def edge_lengths(mesh: Mesh, triangles: Ints) -> Floats:
    """Return the length of each triangle's first edge at rest [mm], shape (k,)."""
    a, b = (mesh.vertices[triangles[:, k]] for k in range(2))
    return np.linalg.norm(b - a, axis=1)
