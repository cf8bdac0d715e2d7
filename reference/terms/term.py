"""The base of all terms, the bases of those on tets and on triangles, and checks of their fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from ...lhm.base.checks import array_of_kind, finite
from ...lhm.base.errors import MeshError, SceneError
from ...lhm.base.mesh import Floats, Ints, as_elements
from ..materials import Material


class Mesh(Protocol):
    """A scene as its terms see it: rest vertices [mm], (n, 3), tets (m, 4) and their volumes [mm³], (m,)."""

    @property
    def vertices(self) -> Floats: ...

    @property
    def tets(self) -> Ints: ...

    @property
    def volumes(self) -> Floats: ...


@dataclass(frozen=True, eq=False)
class Term:
    """Base of all terms; `name` is what errors and reports call it.

    A term says by itself which vertices its elements have, what it holds and loads, and how stiff it is.

    `varying` are the fields in which scenes may differ that a solver is prepared for at once. `may_soften` says whether
    the energy may lose stiffness without a load that grows, as where tissue turns inside out or skin buckles.
    """

    varying: ClassVar[tuple[str, ...]] = ()
    may_soften: ClassVar[bool] = False

    @property
    def name(self) -> str:
        """The term's class name."""
        return type(self).__name__

    @property
    def masks(self) -> dict[str, int]:
        """Lengths of boolean masks given for `vertices` and `tets`, by field name."""
        return vars(self).get("_masks", {})

    def check(self, mesh: Mesh):
        """Raise SceneError for vertices, tets or triangles that a mesh lacks, and values that do not fit it."""
        n = len(mesh.vertices)
        kinds = (("vertices", "vertex", n), ("tets", "tet", len(mesh.tets)), ("triangles", "vertex", n))
        for key, kind, count in kinds:
            if self.masks.get(key, count) != count:
                raise SceneError(f"{key} is a mask of {self.masks[key]} for {count} {key}")
            ids = getattr(self, key, None)
            if ids is None or ids.size == 0:
                continue
            if ids.min() < 0 or ids.max() >= count:
                bad = ids.max() if ids.max() >= count else ids.min()
                raise SceneError(f"{kind} {bad} is outside 0..{count - 1}")
        rest = getattr(self, "rest", None)
        if rest is not None and not hasattr(self, "vertices") and len(rest) != n:
            raise SceneError(f"rest has {len(rest)} rows for {n} vertices")

    def element_vertices(self, mesh: Mesh) -> Ints:
        """Return the vertices, shape (k, j), that each of its elements joins; none unless it is an energy of them."""
        return np.empty((0, 1), dtype=np.int64)

    def hold(self, mesh: Mesh, held: np.ndarray):
        """Mark what cannot move freely in a mask over vertices and components (n, 3)."""

    def add_load(self, mesh: Mesh, forces: Floats):
        """Add its dead forces [mN], lumped exactly for linear shape functions, to an array (n, 3)."""

    def unit_force(self, mesh: Mesh) -> float:
        """Return the force [mN] that unit strain would cause, the sum over its elements."""
        return 0.0

    def explain_unmodelled(self, laws: tuple[type[Material], ...]) -> str | None:
        """Say what a solver that knows these laws of tissue cannot model of it, if anything."""
        return None

    def _set(self, **values):
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def _set_ids(self, key: str, *, in_threes: bool = False) -> Ints:
        """Take the indices that `vertices` or `tets` name; the length of a mask is kept for the scene to check."""
        values = getattr(self, key)
        ids = as_ids(f"{self.name}.{key}", values, in_threes=in_threes)
        if np.asarray(values).dtype == bool:
            self._set(_masks={**self.masks, key: len(values)})
        self._set(**{key: ids})
        return ids

    def _set_amounts(self, amounts: dict[str, Amount], count: int | None):
        """Check fields of one number, or of one per element of `count`."""
        for key, amount in amounts.items():
            self._set(**{key: amount.check(f"{self.name}.{key}", getattr(self, key), count)})


@dataclass(frozen=True)
class Amount:
    """The range of a field of numbers: at least (strict: above) `least`."""

    least: float
    strict: bool = False

    def check(self, name: str, values, count: int | None) -> np.ndarray:
        """Return a finite number or a read-only array (count,) in the range; SceneError for another."""
        array = read_only(array_of_kind(name, values, "iuf", "numbers", error=SceneError))
        if array.ndim > 1 or (array.ndim == 1 and count is not None and array.shape != (count,)):
            raise SceneError(f"{name}: expected one number or shape ({count},), got shape {array.shape}")
        bad = ~np.isfinite(array) | ((array <= self.least) if self.strict else (array < self.least))
        if bad.any():
            how = "above" if self.strict else "at least"
            raise SceneError(f"{name}: must be finite and {how} {self.least}, got {array[bad][0]}")
        return array


class OnTets(Term):
    """Base of terms on tets, None for all; `amounts` are fields of one number or one per row of `tets`.

    in_threes: whether `tets` may have rows of three, shape (k, 3), which are prisms.
    """

    amounts: ClassVar[dict[str, Amount]] = {}
    in_threes: ClassVar[bool] = False
    tets: Ints | None

    def __post_init__(self):
        count = None if self.tets is None else len(self._set_ids("tets", in_threes=self.in_threes))
        self._set_amounts(self.amounts, count)

    def check(self, mesh: Mesh):
        super().check(mesh)
        for key in self.amounts if self.tets is None else ():
            values = getattr(self, key)
            if values.ndim == 1 and len(values) != len(mesh.tets):
                raise SceneError(f"{key} has {len(values)} values for {len(mesh.tets)} tets")

    def tets_of(self, mesh: Mesh) -> Ints:
        """Return the indices of the tets that it acts on, shape (k,), or (k, 3) of prisms."""
        return np.arange(len(mesh.tets)) if self.tets is None else self.tets

    def lump(self, mesh: Mesh, density: float | Floats) -> Floats:
        """Share an amount per volume, one or one per tet, among vertices, shape (n,)."""
        tets = self.tets_of(mesh)
        amount = np.broadcast_to(density, tets.shape) * mesh.volumes[tets] / 4.0
        lumped = np.bincount(mesh.tets[tets].ravel(), np.repeat(amount, 4), minlength=len(mesh.vertices))
        return lumped.astype(np.float64, copy=False)


class OnTriangles(Term):
    """Base of terms on triangles (k, 3) of vertices; `amounts` are fields of one number or one per triangle."""

    amounts: ClassVar[dict[str, Amount]] = {}
    triangles: Ints

    def __post_init__(self):
        triangles = as_triangles(f"{self.name}.triangles", self.triangles)
        self._set(triangles=triangles)
        self._set_amounts(self.amounts, len(triangles))

    def check(self, mesh: Mesh):
        """See Term; triangles need an area, in the scene and in the shape sought."""
        super().check(mesh)
        rest = getattr(self, "rest", None)
        for points in (mesh.vertices,) if rest is None else (mesh.vertices, rest):
            check_areas(self.triangles, points)

    def areas(self, points: Floats) -> Floats:
        """Return the triangles' areas [mm²], shape (k,), with vertices at points [mm], shape (n, 3)."""
        return triangle_areas(points, self.triangles)


def triangle_areas(points: Floats, triangles: Ints) -> Floats:
    """Return the areas [mm²], shape (k,), of triangles (k, 3) with vertices at points [mm], shape (n, 3)."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0


def check_areas(triangles: Ints, points: Floats):
    """Raise SceneError for the first triangle without an area."""
    flat = np.flatnonzero(triangle_areas(points, triangles) <= 0)
    if flat.size:
        raise SceneError(f"triangle {flat[0]} has no area")


def as_triangles(name: str, values) -> Ints:
    """Return triangles, shape (k, 3); SceneError for others."""
    try:
        return as_elements(name, values, 3, np.iinfo(np.int64).max)
    except MeshError as error:
        raise SceneError(str(error)) from None


def as_ids(name: str, values, *, in_threes: bool = False) -> Ints:
    """Return unique indices, shape (k,), from indices or a mask; SceneError for others.

    in_threes: indices may have shape (k, 3) too, and are returned ascending in each row.
    """
    shapes = "(k,) or (k, 3)" if in_threes else "(k,)"
    array = array_of_kind(name, values, "biuf", f"indices of shape {shapes} or a mask", error=SceneError)
    if array.dtype == bool and array.ndim == 1:
        array = np.flatnonzero(array)
    if array.size == 0 and array.ndim == 1:
        array = array.astype(np.int64)
    fits = array.ndim == 1 or (in_threes and array.ndim == 2 and array.shape[1] == 3)
    if not fits or not np.issubdtype(array.dtype, np.integer):
        got = f"{type(values).__name__} of shape {array.shape} of {array.dtype}"
        raise SceneError(f"{name}: expected indices of shape {shapes}, got {got}")
    if len(np.unique(array)) != array.size:
        raise SceneError(f"{name}: an index appears twice")
    array = array.astype(np.int64)
    if array.ndim == 2:
        array.sort(axis=1)
    array.flags.writeable = False
    return array


def as_places(name: str, values, count: int | None) -> Floats | None:
    """Return points, shape (count, 3), None for None; SceneError for others."""
    return None if values is None else read_only(finite(name, values, (count, 3), error=SceneError))


def as_vector(name: str, values) -> Floats:
    """Return three finite numbers; SceneError for others."""
    return read_only(finite(name, values, (3,), error=SceneError))


def read_only(values: Floats) -> Floats:
    """Return a copy that nobody can change."""
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
