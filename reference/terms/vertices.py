"""Springs and constraints of vertices."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Ints, Surface
from .term import Amount, Mesh, Term, as_places, as_triangles, check_areas


@dataclass(frozen=True, eq=False)
class Target(Term):
    """Springs: stiffness/2 |x_i - positions_i|² for each vertex (SoftDECA Eq. 14).

    vertices (k,), positions (k, 3) [mm], stiffness [mN/mm] per vertex: multiply one per area by the vertex' area.
    `triangles` (t, 3) of these vertices, if any, are where the springs are spread: elements integrate over them, with
    stiffness per area and places linear between the corners. A `lumped` term is spread by quadratic elements alone,
    whose face would dimple between springs at vertices.
    """

    varying: ClassVar[tuple[str, ...]] = ("positions",)

    vertices: np.ndarray = field(repr=False)
    positions: np.ndarray = field(repr=False)
    stiffness: float | np.ndarray
    triangles: Ints = field(default_factory=lambda: np.empty((0, 3), dtype=np.int64), repr=False)
    lumped: bool = False

    def __post_init__(self):
        count = len(self._set_ids("vertices"))
        self._set(positions=as_places("Target.positions", self.positions, count))
        self._set_amounts({"stiffness": Amount(0.0)}, count)
        self._set(triangles=as_triangles("Target.triangles", self.triangles))

    def check(self, mesh: Mesh):
        """See Term; triangles have an area, and vertices of the term."""
        super().check(mesh)
        check_areas(self.triangles, mesh.vertices)
        strange = np.ones(len(mesh.vertices), dtype=bool)
        strange[self.vertices] = False
        if strange[self.triangles].any():
            raise SceneError(f"triangles: vertex {self.triangles[strange[self.triangles]].min()} is none of the term's")

    def is_spread(self, degree: int) -> bool:
        """Tell whether elements of a degree, 1 or 2, integrate it over its triangles."""
        return len(self.triangles) > 0 and not (self.lumped and degree == 1)

    def spread(self, mesh: Mesh) -> tuple[np.ndarray, Floats, Floats]:
        """Return what elements integrate: which vertices (k,) have no triangle, and values at corners.

        These are the springs' stiffness per area [mN/mm³], shape (t, 3), and places [mm], shape (t, 3, 3).
        """
        triangles, n = self.triangles, len(mesh.vertices)
        around = Surface(mesh.vertices, triangles).vertex_areas
        stiffness, places = np.zeros(n), np.zeros((n, 3))
        stiffness[self.vertices], places[self.vertices] = self.stiffness, self.positions
        density = np.divide(stiffness, around, out=np.zeros(n), where=around > 0.0)
        return around[self.vertices] == 0.0, density[triangles], places[triangles]

    def hold(self, mesh: Mesh, held: np.ndarray):
        held[self.vertices[np.broadcast_to(self.stiffness, len(self.vertices)) > 0]] = True

    def unit_force(self, mesh: Mesh) -> float:
        return float(np.sum(self.stiffness))


@dataclass(frozen=True, eq=False)
class Fixed(Term):
    """Dirichlet: holds the named components of vertices at positions `values`.

    vertices (k,); values [mm], shape (k, 3), None for where they are; components are out of 0, 1, 2.
    """

    varying: ClassVar[tuple[str, ...]] = ("values",)

    vertices: np.ndarray = field(repr=False)
    values: np.ndarray | None = field(default=None, repr=False)
    components: tuple[int, ...] = (0, 1, 2)

    def __post_init__(self):
        vertices = self._set_ids("vertices")
        components = (self.components,) if isinstance(self.components, (int, np.integer)) else self.components
        try:
            components = tuple("xyz".index(str(c)) if c in ("x", "y", "z") else c for c in components)
        except (TypeError, ValueError):
            components = ()
        if not components or any(c not in (0, 1, 2) for c in components) or len(set(components)) != len(components):
            raise SceneError(f"Fixed.components: expected some of 0, 1, 2, got {self.components!r}")
        values = as_places("Fixed.values", self.values, len(vertices))
        self._set(values=values, components=tuple(sorted(int(c) for c in components)))

    def hold(self, mesh: Mesh, held: np.ndarray):
        held[self.vertices[:, None], list(self.components)] = True


@dataclass(frozen=True, eq=False)
class RigidBody(Term):
    """Vertices that move together as an exact rigid body, free but for what pulls at them.

    vertices (k,), at least three that are not in line; rest [mm], shape (k, 3), is the body's shape and first place,
    default where the scene has them: a scaled bone is a body with another rest.
    """

    varying: ClassVar[tuple[str, ...]] = ("rest",)
    may_soften: ClassVar[bool] = True

    vertices: np.ndarray = field(repr=False)
    rest: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        vertices = self._set_ids("vertices")
        if len(vertices) < 3:
            raise SceneError(f"RigidBody.vertices: a body needs at least 3 vertices, got {len(vertices)}")
        self._set(rest=as_places("RigidBody.rest", self.rest, len(vertices)))

    def element_vertices(self, mesh: Mesh) -> Ints:
        return self.vertices[None]
