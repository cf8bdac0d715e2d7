"""Surface and TetMesh: frozen arrays, checked when made. Millimetres."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .checks import Floats as Floats
from .checks import Floats32 as Floats32
from .checks import Ints as Ints
from .checks import finite, indices_below
from .errors import MeshError
from .kernels import njit


def as_points(name: str, values) -> Floats:
    """Return a read-only float64 copy of shape (n, 3); MeshError for others, and for values that are not finite."""
    points = np.array(finite(name, values, (None, 3), error=MeshError))
    points.flags.writeable = False
    return points


def as_elements(name: str, values, corners: int, n_vertices: int) -> Ints:
    """Return a read-only int64 copy, shape (m, corners), of indices in [0, n_vertices); MeshError for others."""
    if isinstance(values, np.ndarray) and not values.size:
        values = values.astype(np.int64)  # an empty array may be of any kind
    elements = np.array(indices_below(name, values, n_vertices, (None, corners), error=MeshError))
    elements.flags.writeable = False
    return elements


FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""The face opposite each corner of a tet of positive volume, counter-clockwise from outside."""
FLAT = 1e-15
"""A tet of less than this share of the cube around it is flat."""


@njit(cache=True)
def tet_volumes(vertices: Floats, tets: Ints) -> Floats:
    """Return signed volumes [mm³], shape (m,)."""
    volumes = np.empty(len(tets))
    for i in range(len(tets)):
        a, b, c, d = tets[i]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        wx, wy, wz = vertices[d, 0] - vertices[a, 0], vertices[d, 1] - vertices[a, 1], vertices[d, 2] - vertices[a, 2]
        volumes[i] = ((uy * vz - uz * vy) * wx + (uz * vx - ux * vz) * wy + (ux * vy - uy * vx) * wz) / 6.0
    return volumes


@njit(cache=True)
def repeated_tet(tets: Ints) -> tuple[int, int]:
    """Return the first tet of the same corners as one before it, and that one; (-1, -1) if all differ."""
    size = 1
    while size < 2 * len(tets):
        size *= 2
    slots = np.full(size, -1)
    corners = np.empty_like(tets)
    for i in range(len(tets)):
        a, b, c, d = tets[i]
        a, b, c, d = min(a, b), max(a, b), min(c, d), max(c, d)
        a, c, b, d = min(a, c), max(a, c), min(b, d), max(b, d)
        b, c = min(b, c), max(b, c)
        corners[i, 0], corners[i, 1], corners[i, 2], corners[i, 3] = a, b, c, d
        mixed = np.uint64(a * 73856093) ^ np.uint64(b * 19349663) ^ np.uint64(c * 83492791) ^ np.uint64(d * 39916801)
        mixed = (mixed ^ (mixed >> np.uint64(31))) * np.uint64(0x9E3779B97F4A7C15)
        slot = np.int64((mixed >> np.uint64(32)) & np.uint64(size - 1))
        while slots[slot] >= 0:
            o = slots[slot]
            if corners[o, 0] == a and corners[o, 1] == b and corners[o, 2] == c and corners[o, 3] == d:
                return i, o
            slot = (slot + 1) & (size - 1)
        slots[slot] = i
    return -1, -1


def unit(vectors: Floats) -> Floats:
    """The directions of vectors (..., 3); those of no length stay so."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-30)


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh: vertices [mm], shape (n, 3), and triangles, shape (m, 3).

    Raises MeshError for values that are not finite, indices out of range and triangles that repeat a vertex.
    """

    vertices: Floats
    triangles: Ints

    def __post_init__(self):
        object.__setattr__(self, "vertices", as_points("vertices", self.vertices))
        object.__setattr__(self, "triangles", as_elements("triangles", self.triangles, 3, len(self.vertices)))
        i, j, k = self.triangles.T
        bad = np.flatnonzero((i == j) | (j == k) | (k == i))
        if bad.size:
            raise MeshError(f"triangles: {bad.size} repeat a vertex, the first is number {bad[0]}")

    def with_vertices(self, vertices) -> Surface:
        """Return the same triangles over other vertices [mm], shape (n, 3)."""
        if np.shape(vertices) != self.vertices.shape:
            raise MeshError(f"vertices: expected shape {self.vertices.shape}, got {np.shape(vertices)}")
        return Surface(vertices, self.triangles)

    @property
    def face_normals(self) -> Floats:
        """Normals scaled by twice the area [mm²], shape (m, 3)."""
        a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    @property
    def areas(self) -> Floats:
        """Triangle areas [mm²], shape (m,)."""
        return 0.5 * np.linalg.norm(self.face_normals, axis=1)

    @property
    def vertex_areas(self) -> Floats:
        """A third of the incident areas [mm²], shape (n,)."""
        thirds = np.repeat(self.areas / 3.0, 3)
        return np.bincount(self.triangles.ravel(), thirds, len(self.vertices)).astype(np.float64, copy=False)

    @property
    def vertex_normals(self) -> Floats:
        """Area-weighted unit normals, shape (n, 3); zero where no triangle is."""
        normals = np.zeros_like(self.vertices)
        np.add.at(normals, self.triangles.ravel(), np.repeat(self.face_normals, 3, axis=0))
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)


@dataclass(frozen=True, eq=False)
class TetMesh:
    """A tetrahedral mesh: vertices [mm], shape (n, 3), and positively oriented tets, shape (m, 4).

    Raises MeshError for values that are not finite, indices out of range, and tets that are inverted, flat or there
    twice (by index).
    """

    vertices: Floats
    tets: Ints
    volumes: Floats = field(init=False, repr=False)

    def __post_init__(self):
        object.__setattr__(self, "vertices", as_points("vertices", self.vertices))
        object.__setattr__(self, "tets", as_elements("tets", self.tets, 4, len(self.vertices)))
        volumes = tet_volumes(self.vertices, self.tets)
        whole = np.ptp(self.vertices) if len(self.vertices) else 0.0
        small = np.flatnonzero(volumes <= FLAT * whole**3)
        size = np.ptp(self.vertices[self.tets[small]], axis=1).max(axis=1) if small.size else 0.0
        bad = small[volumes[small] <= FLAT * size**3]
        if bad.size:
            first = bad[0]
            raise MeshError(
                f"tets: {bad.size} are inverted or flat, the first is number {first} "
                f"(vertices {self.tets[first].tolist()}, volume {volumes[first]:.3g} mm³; it must be positive)"
            )
        again, first = repeated_tet(self.tets)
        if again >= 0:
            raise MeshError(f"tets: number {again} is number {first} again (vertices {self.tets[again].tolist()})")
        volumes.flags.writeable = False
        object.__setattr__(self, "volumes", volumes)
