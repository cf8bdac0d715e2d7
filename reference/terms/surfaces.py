"""The energies of surfaces, over triangles of a scene's vertices: strain in the plane, bending, contact."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ...lhm.base.errors import MeshError, SceneError
from ...lhm.base.mesh import Floats, Ints, as_elements
from .term import Amount, Mesh, OnTriangles, Term, as_places


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
        """See Term."""
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
        """See Term."""
        return self.triangles

    def unit_force(self, mesh: Mesh) -> float:
        """See Term; stiffness over an edge's length."""
        return float(np.sum(self.stiffness / edge_lengths(mesh, self.triangles)))


@dataclass(frozen=True, eq=False)
class Contact(OnTriangles):
    """Self-contact of surfaces: stiffness/2 per rest area times the squared depth of what is nearer than `thickness`.

    triangles (k, 3) of the scene's vertices are kept from crossing one another (SoftDECA 3.3.2); stiffness [kPa/mm];
    thickness [mm] is the gap kept, less where parts are nearer at rest. Pairs are of a vertex and a triangle, and of
    two edges, that have no common vertex. A start must not cross.
    """

    triangles: np.ndarray = field(repr=False)
    stiffness: float = 3000.0
    thickness: float = 0.0

    def __post_init__(self):
        super().__post_init__()
        self._set(
            stiffness=Amount(0.0, strict=True).check_one("Contact.stiffness", self.stiffness),
            thickness=Amount(0.0).check_one("Contact.thickness", self.thickness),
        )


@dataclass(frozen=True, eq=False)
class Gaps(Term):
    """Contact of known pairs: Σ stiffness/2 max(offset - distance, 0)², for solvers that look for none themselves.

    pairs (r, 4) of the scene's vertices: a vertex and a triangle or, where `between_edges` (r,) says so, two edges;
    the distance [mm] is that of their nearest points. stiffness [mN/mm] and offset [mm]: one number or one per pair.
    """

    may_soften: ClassVar[bool] = True

    pairs: np.ndarray = field(repr=False)
    between_edges: np.ndarray = field(repr=False)
    stiffness: float | np.ndarray
    offset: float | np.ndarray

    def __post_init__(self):
        try:
            pairs = as_elements("Gaps.pairs", self.pairs, 4, np.iinfo(np.int64).max)
        except MeshError as error:
            raise SceneError(str(error)) from None
        between = np.asarray(self.between_edges)
        if between.dtype != bool or between.shape != (len(pairs),):
            raise SceneError(f"Gaps.between_edges: expected a mask of shape ({len(pairs)},), got {between.shape}")
        self._set(pairs=pairs, between_edges=between)
        self._set_amounts({"stiffness": Amount(0.0), "offset": Amount(0.0)}, len(pairs))

    def check(self, mesh: Mesh):
        """See Term."""
        super().check(mesh)
        if self.pairs.size and self.pairs.max() >= len(mesh.vertices):
            raise SceneError(f"vertex {self.pairs.max()} is outside 0..{len(mesh.vertices) - 1}")

    def element_vertices(self, mesh: Mesh) -> Ints:
        """See Term."""
        return self.pairs


def edge_lengths(mesh: Mesh, triangles: Ints) -> Floats:
    """Return the length of each triangle's first edge at rest [mm], shape (k,)."""
    a, b = (mesh.vertices[triangles[:, k]] for k in range(2))
    return np.linalg.norm(b - a, axis=1)
