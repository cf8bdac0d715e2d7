"""Contact of surfaces with themselves and with rigid obstacles, and of pairs that are known."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ...lhm.base.checks import finite, number
from ...lhm.base.errors import MeshError, SceneError
from ...lhm.base.mesh import Floats, Ints, Surface, as_elements
from .term import Amount, Mesh, OnTriangles, Term, as_ids

FLATTEST = 1e-6
"""Least volume of a carriers' tet over the cube of its size: a flatter one determines no motion."""


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A rigid surface [mm] of its own, from which a Contact term's is kept; parts of it may cross one another.

    Without `carriers` it stands still. These are four of the scene's vertices, Fixed or of a RigidBody, that do not lie
    in one plane; the surface, placed as they are at the scene's rest, goes along with their affine motion.
    """

    surface: Surface
    carriers: np.ndarray | None = None

    def __post_init__(self):
        if not isinstance(self.surface, Surface):
            raise SceneError(f"Obstacle.surface: expected a Surface, got {type(self.surface).__name__}")
        flat = np.flatnonzero(self.surface.areas <= 0.0)
        if flat.size:
            raise SceneError(f"Obstacle: triangle {flat[0]} has no area")
        if not len(self.surface.triangles):
            raise SceneError("Obstacle: its surface has no triangles")
        if self.carriers is not None:
            carriers = as_ids("Obstacle.carriers", self.carriers)
            if len(carriers) != 4:
                raise SceneError(f"Obstacle.carriers: expected four vertices, got {len(carriers)}")
            object.__setattr__(self, "carriers", carriers)

    def __eq__(self, other: object) -> bool:
        """Whether another obstacle has the same surface and carriers, by value."""
        return isinstance(other, Obstacle) and all(
            np.array_equal(mine, its) for mine, its in zip(self._arrays, other._arrays, strict=True)
        )

    @property
    def _arrays(self) -> tuple[np.ndarray, ...]:
        none = np.empty(0, dtype=np.int64)
        return self.surface.vertices, self.surface.triangles, none if self.carriers is None else self.carriers

    def check(self, mesh: Mesh):
        """Raise SceneError for carriers that a mesh lacks or that lie in one plane."""
        if self.carriers is None:
            return
        n = len(mesh.vertices)
        if self.carriers.min() < 0 or self.carriers.max() >= n:
            raise SceneError(f"Obstacle.carriers: expected vertices in 0..{n - 1}, got {self.carriers.tolist()}")
        sides = np.diff(mesh.vertices[self.carriers], axis=0)
        if abs(np.linalg.det(sides)) <= FLATTEST * np.abs(sides).max() ** 3:
            raise SceneError("Obstacle.carriers: they lie in one plane")

    def find_shares(self, mesh: Mesh) -> Floats:
        """Find the carriers' shares in each point, shape (points, 4): their sum is 1, their mean by them the point."""
        places = mesh.vertices[self.carriers], self.surface.vertices
        corners, points = (np.column_stack([x, np.ones(len(x))]) for x in places)
        return np.linalg.solve(corners.T, points.T).T


@dataclass(frozen=True, eq=False)
class Contact(OnTriangles):
    """Self-contact of surfaces, which push one another, without friction, where they are nearer than an offset o.

    triangles (k, 3) of the scene's vertices are kept from crossing one another (SoftDECA 3.3.2) and the `obstacles`.
    The energy per rest area at a distance d is stiffness/2 (o - d)² o/d: a spring of that stiffness [kPa/mm] at first,
    and more than any load as d falls to 0. o is 0.005 mm more than `thickness` [mm], less where parts are nearer at
    rest; those that touch there are met 0.005 mm within. Pairs are of a vertex and a triangle, and of two edges,
    that have no common vertex. A start must not cross.
    """

    triangles: np.ndarray = field(repr=False)
    stiffness: float = 3000.0
    thickness: float = 0.0
    obstacles: tuple[Obstacle, ...] = ()

    def __post_init__(self):
        super().__post_init__()
        self._set(
            stiffness=number("Contact.stiffness", self.stiffness, above=0.0, error=SceneError),
            thickness=number("Contact.thickness", self.thickness, least=0.0, error=SceneError),
            obstacles=tuple(self.obstacles),
        )
        for obstacle in self.obstacles:
            if not isinstance(obstacle, Obstacle):
                raise SceneError(f"Contact.obstacles: expected some Obstacle, got {type(obstacle).__name__}")

    def check(self, mesh: Mesh):
        super().check(mesh)
        for obstacle in self.obstacles:
            obstacle.check(mesh)


@dataclass(frozen=True, eq=False)
class Gaps(Term):
    """Contact of known pairs, for solvers that look for none themselves: Σ m stiffness/2 (offset - d)² offset/d.

    The sum is over pairs nearer than their offset. m is 1, but m = a (2 - a) for two edges the squared sine of whose
    angle is a/1000 with a < 1, since parallel ones have no one pair of nearest points.

    pairs (r, 4) of the scene's vertices: a vertex and a triangle or, where `between_edges` (r,) says so, two edges;
    the distance [mm] is that of their nearest points. stiffness [mN/mm] and offset [mm]: one number or one per pair.
    Where some corners belong to obstacles, pairs (r, m) are the vertices that a pair hangs on, and its four corners are
    at places (r, 4, 3) [mm] plus the sum of shares (r, 4, m) times their positions.
    """

    may_soften: ClassVar[bool] = True

    pairs: np.ndarray = field(repr=False)
    between_edges: np.ndarray = field(repr=False)
    stiffness: float | np.ndarray
    offset: float | np.ndarray
    shares: np.ndarray | None = field(default=None, repr=False)
    places: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        corners = 4 if self.shares is None else np.shape(self.shares)[-1]
        try:
            pairs = as_elements("Gaps.pairs", self.pairs, corners, np.iinfo(np.int64).max)
        except MeshError as error:
            raise SceneError(str(error)) from None
        between = np.asarray(self.between_edges)
        if between.dtype != bool or between.shape != (len(pairs),):
            raise SceneError(f"Gaps.between_edges: expected a mask of shape ({len(pairs)},), got {between.shape}")
        self._set(pairs=pairs, between_edges=between)
        self._set_amounts({"stiffness": Amount(0.0), "offset": Amount(0.0)}, len(pairs))
        if (self.shares is None) != (self.places is None):
            raise SceneError("Gaps: shares and places belong together")
        if self.shares is not None:
            for name, shape in (("shares", (len(pairs), 4, corners)), ("places", (len(pairs), 4, 3))):
                self._set(**{name: finite(f"Gaps.{name}", getattr(self, name), shape, error=SceneError)})

    def check(self, mesh: Mesh):
        super().check(mesh)
        if self.pairs.size and self.pairs.max() >= len(mesh.vertices):
            raise SceneError(f"vertex {self.pairs.max()} is outside 0..{len(mesh.vertices) - 1}")

    def element_vertices(self, mesh: Mesh) -> Ints:
        return self.pairs

    def find_corners(self, positions: Floats) -> Floats:
        """Find the corners [mm], shape (r, 4, 3), with the vertices of the pairs at positions (r, m, 3)."""
        return positions if self.shares is None or self.places is None else self.places + self.shares @ positions

    def spread_forces(self, forces: Floats) -> Floats:
        """Spread forces on the corners, shape (r, 4, 3), over the vertices of the pairs, (r, m, 3)."""
        return forces if self.shares is None else self.shares.transpose(0, 2, 1) @ forces

    def spread_hessians(self, hessians: Floats) -> Floats:
        """Turn Hessians by the corners, shape (r, 12, 12), into those by the vertices of the pairs, (r, 3 m, 3 m)."""
        if self.shares is None:
            return hessians
        r, _, m = self.shares.shape
        half = np.einsum("ria,rikjl->rakjl", self.shares, hessians.reshape(r, 4, 3, 4, 3))
        return np.einsum("rjb,rakjl->rakbl", self.shares, half).reshape(r, 3 * m, 3 * m)
