"""The terms a scene is made of: energies, constraints and loads. A term names what it acts on.

Energies are integrals over the rest configuration. Units: mm, kPa (= mN/mm²), kg/mm³; energies µJ = mN·mm.
A term without `tets` acts on all tets. Stiffnesses and the like are one number, or one per element acted on.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal, get_args

import numpy as np

from ..lhm.base.errors import MeshError, SceneError
from ..lhm.base.mesh import as_elements, as_points
from .materials import Guccione, Incompressible, Material

StrainRule = Literal["clamp", "indicator"]


def _numbers(name: str, values) -> np.ndarray:
    """Values as float64; SceneError for what are no numbers."""
    try:
        raw = np.asarray(values)
        if raw.dtype.kind not in "iufO":
            raise TypeError
        return np.array(raw, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError(f"{name}: expected numbers, got {values!r:.60}") from None


def _one(name: str, value, low: float, *, strict: bool = False) -> float:
    """A finite number, at least (strict: above) low."""
    number = _per_item(name, value, None, low, strict=strict)
    if number.ndim:
        raise SceneError(f"{name}: expected one number, got shape {number.shape}")
    return float(number)


def _per_item(name: str, values, count: int | None, low: float, *, strict: bool = False):
    """A finite number or a read-only array (count,), each at least (strict: above) low."""
    array = _numbers(name, values)
    if array.ndim > 1 or (array.ndim == 1 and count is not None and array.shape != (count,)):
        raise SceneError(f"{name}: expected one number or shape ({count},), got shape {array.shape}")
    bad = ~np.isfinite(array) | ((array <= low) if strict else (array < low))
    if bad.any():
        where = "" if array.ndim == 0 else f" (number {np.flatnonzero(bad)[0]})"
        value = array if array.ndim == 0 else array[bad][0]
        raise SceneError(f"{name}: must be finite and {'above' if strict else 'at least'} {low}, got {value}{where}")
    array.flags.writeable = False
    return array


def _ids(name: str, values) -> np.ndarray:
    """Unique indices, shape (k,), from indices or a mask."""
    try:
        array = np.asarray(values)
    except ValueError:
        raise SceneError(f"{name}: expected indices of shape (k,) or a mask") from None
    if array.dtype == bool and array.ndim == 1:
        array = np.flatnonzero(array)
    if array.size == 0 and array.ndim == 1:
        array = array.astype(np.int64)
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer):
        raise SceneError(f"{name}: expected indices of shape (k,), got shape {array.shape} of {array.dtype}")
    if len(np.unique(array)) != len(array):
        raise SceneError(f"{name}: an index appears twice")
    array = array.astype(np.int64)
    array.flags.writeable = False
    return array


def _scene_points(name: str, values, count: int | None):
    try:
        points = as_points(name, values)
    except MeshError as error:
        raise SceneError(str(error)) from None
    if count is not None and len(points) != count:
        raise SceneError(f"{name}: expected {count} rows, got {len(points)}")
    return points


def _triangles(name: str, values):
    try:
        return as_elements(name, values, 3, np.iinfo(np.int64).max)
    except MeshError as error:
        raise SceneError(str(error)) from None


def _vector(name: str, values):
    vector = _numbers(name, values)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise SceneError(f"{name}: expected three finite numbers, got {values!r}")
    vector.flags.writeable = False
    return vector


@dataclass(frozen=True, eq=False)
class Term:
    """Base of all terms; `name` is what errors and reports call it.

    `varying` are the fields in which scenes may differ that a solver is prepared for at once.
    """

    varying: ClassVar[tuple[str, ...]] = ()

    @property
    def name(self) -> str:
        """The term's class name."""
        return type(self).__name__

    @property
    def masks(self) -> dict[str, int]:
        """Of `vertices` and `tets` that were given as a mask the length that it had, by name."""
        return vars(self).get("_masks", {})

    def _chosen(self, key: str) -> np.ndarray:
        """The indices that `vertices` or `tets` name; the length of a mask is kept for the scene to check."""
        values = getattr(self, key)
        ids = _ids(f"{self.name}.{key}", values)
        if np.asarray(values).dtype == bool:
            object.__setattr__(self, "_masks", {**self.masks, key: len(values)})
        return ids

    def _set(self, **values):
        for key, value in values.items():
            object.__setattr__(self, key, value)


@dataclass(frozen=True, eq=False)
class Hyperelastic(Term):
    """The energy of a hyperelastic law, integral of growth psi(F growth^(-1/3)) over the tets.

    growth > 0 is the volume ratio at which the tissue is at rest: F growth^(-1/3) is the elastic part of F, and grown
    tissue is as stiff as it was (Rodriguez, Hoger, McCulloch 1994, "Stress-dependent finite growth in soft elastic
    tissues"). Raises SceneError for a law without a volumetric part that is not Incompressible.
    """

    material: Material
    tets: np.ndarray | None = field(default=None, repr=False)
    growth: float | np.ndarray = 1.0

    def __post_init__(self):
        if not isinstance(self.material, Material):
            raise SceneError(f"Hyperelastic: expected a material, got {type(self.material).__name__}")
        if not self.material.resists_volume_change:
            raise SceneError(f"Hyperelastic: {self.material.name} without kappa must be made Incompressible")
        tets = None if self.tets is None else self._chosen("tets")
        count = None if tets is None else len(tets)
        self._set(tets=tets, growth=_per_item("Hyperelastic.growth", self.growth, count, 0.0, strict=True))

    @property
    def fibres(self) -> np.ndarray | None:
        """The law's fibre directions, shape (3,) or (m, 3); None if it has none."""
        law = self.material.law if isinstance(self.material, Incompressible) else self.material
        return law.fibres if isinstance(law, Guccione) else None


@dataclass(frozen=True, eq=False)
class Strain(Term):
    """stiffness/2 ‖F - R‖² per rest volume; with limit L > 1, F's distance to stretches within [1/L, L].

    SoftDECA Eq. 10 in its clamped form, rule "clamp". Rule "indicator" is Eq. 10 to the letter: ‖F - R‖² where F's
    largest stretch is above the limit, else 0. That jumps at the limit, so it may have no minimiser, and local/global
    steps do not majorise it: on a sphere's shells (limit 1.05) the energy rose in 108 and 118 of 300 plain iterations,
    by up to 0.7 % of 20 mJ, and L-BFGS stagnated after 240; clamped it never rose. Only projective dynamics models it.
    stiffness [kPa] (= 2 mu), limit >= 1. growth > 0 is the volume ratio at rest: the stretches that F is compared with
    are multiplied by growth^(1/3), as if F growth^(-1/3) were. With a Volume of the same target, tissue grows freely
    without stress; the stiffness stays one per volume before growth. The indicator knows no growth.
    """

    varying: ClassVar[tuple[str, ...]] = ("limit", "growth")

    stiffness: float | np.ndarray
    limit: float | np.ndarray = 1.0
    tets: np.ndarray | None = field(default=None, repr=False)
    rule: StrainRule = "clamp"
    growth: float | np.ndarray = 1.0

    def __post_init__(self):
        if self.rule not in get_args(StrainRule):
            raise SceneError(f"Strain.rule: expected clamp or indicator, got {self.rule!r}")
        tets = None if self.tets is None else self._chosen("tets")
        count = None if tets is None else len(tets)
        self._set(
            tets=tets,
            stiffness=_per_item("Strain.stiffness", self.stiffness, count, 0.0),
            limit=_per_item("Strain.limit", self.limit, count, 1.0),
            growth=_per_item("Strain.growth", self.growth, count, 0.0, strict=True),
        )
        if self.rule == "indicator" and np.any(self.growth != 1.0):
            raise SceneError("Strain.growth: the indicator knows no growth; take rule clamp")


@dataclass(frozen=True, eq=False)
class Volume(Term):
    """stiffness/2 times the squared distance of F to the matrices of determinant `target`, per rest volume.

    SoftDECA Eq. 10. stiffness [kPa] (= 3 lmbda at small strain); target > 0 is the volume ratio sought.
    """

    varying: ClassVar[tuple[str, ...]] = ("target",)

    stiffness: float | np.ndarray
    target: float | np.ndarray = 1.0
    tets: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        tets = None if self.tets is None else self._chosen("tets")
        count = None if tets is None else len(tets)
        self._set(
            tets=tets,
            stiffness=_per_item("Volume.stiffness", self.stiffness, count, 0.0),
            target=_per_item("Volume.target", self.target, count, 0.0, strict=True),
        )


@dataclass(frozen=True, eq=False)
class SurfaceStrain(Term):
    """stiffness/2 ‖F₂ - √growth R₂‖² per rest area on triangles of the scene's vertices (SoftDECA Eq. 11).

    triangles (k, 3); stiffness [mN/mm] (= 2 mu times thickness); growth > 0 is the area ratio sought; rest [mm], shape
    (scene's vertices, 3), is the shape sought, default the scene's own; the area is that of the scene.
    """

    varying: ClassVar[tuple[str, ...]] = ("growth",)

    triangles: np.ndarray = field(repr=False)
    stiffness: float | np.ndarray
    growth: float | np.ndarray = 1.0
    rest: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        triangles = _triangles("SurfaceStrain.triangles", self.triangles)
        self._set(
            triangles=triangles,
            stiffness=_per_item("SurfaceStrain.stiffness", self.stiffness, len(triangles), 0.0),
            growth=_per_item("SurfaceStrain.growth", self.growth, len(triangles), 0.0, strict=True),
            rest=None if self.rest is None else _scene_points("SurfaceStrain.rest", self.rest, None),
        )


@dataclass(frozen=True, eq=False)
class Target(Term):
    """Springs: stiffness/2 |x_i - positions_i|² for each vertex (SoftDECA Eq. 14).

    vertices (k,), positions (k, 3) [mm], stiffness [mN/mm] per vertex: multiply one per area by the vertex' area.
    """

    varying: ClassVar[tuple[str, ...]] = ("positions",)

    vertices: np.ndarray = field(repr=False)
    positions: np.ndarray = field(repr=False)
    stiffness: float | np.ndarray

    def __post_init__(self):
        vertices = self._chosen("vertices")
        self._set(
            vertices=vertices,
            positions=_scene_points("Target.positions", self.positions, len(vertices)),
            stiffness=_per_item("Target.stiffness", self.stiffness, len(vertices), 0.0),
        )


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
        vertices = self._chosen("vertices")
        components = (self.components,) if isinstance(self.components, (int, np.integer)) else self.components
        try:
            components = tuple("xyz".index(str(c)) if c in ("x", "y", "z") else c for c in components)
        except (TypeError, ValueError):
            components = ()
        if not components or any(c not in (0, 1, 2) for c in components) or len(set(components)) != len(components):
            raise SceneError(f"Fixed.components: expected some of 0, 1, 2, got {self.components!r}")
        values = None if self.values is None else _scene_points("Fixed.values", self.values, len(vertices))
        self._set(vertices=vertices, values=values, components=tuple(sorted(int(c) for c in components)))


@dataclass(frozen=True, eq=False)
class Gravity(Term):
    """Dead load density · acceleration per rest volume; acceleration [mm/s²], shape (3,), density [kg/mm³]."""

    varying: ClassVar[tuple[str, ...]] = ("acceleration", "density")

    acceleration: np.ndarray
    density: float | np.ndarray
    tets: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        tets = None if self.tets is None else self._chosen("tets")
        count = None if tets is None else len(tets)
        self._set(
            acceleration=_vector("Gravity.acceleration", self.acceleration),
            density=_per_item("Gravity.density", self.density, count, 0.0),
            tets=tets,
        )


@dataclass(frozen=True, eq=False)
class Traction(Term):
    """Dead load `vector` [kPa] per rest area on triangles (k, 3) of the scene's vertices."""

    varying: ClassVar[tuple[str, ...]] = ("vector",)

    triangles: np.ndarray = field(repr=False)
    vector: np.ndarray

    def __post_init__(self):
        self._set(
            triangles=_triangles("Traction.triangles", self.triangles), vector=_vector("Traction.vector", self.vector)
        )


@dataclass(frozen=True, eq=False)
class Bending(Term):
    """stiffness/2 |L x - R L X|² per rest area at the inner vertices of triangles (SoftDECA Eq. 13, signed).

    L is the cotangent Laplacian over the rest area of a vertex, R the rotation that fits its ring of edges best, so a
    bump that turns into a dent costs energy. Vertices on the border of the triangles are left free to turn.
    triangles (k, 3); stiffness [mN mm], one number or one per triangle; rest [mm], shape (scene's vertices, 3), is the
    shape sought, default the scene's own.
    """

    triangles: np.ndarray = field(repr=False)
    stiffness: float | np.ndarray
    rest: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        triangles = _triangles("Bending.triangles", self.triangles)
        self._set(
            triangles=triangles,
            stiffness=_per_item("Bending.stiffness", self.stiffness, len(triangles), 0.0),
            rest=None if self.rest is None else _scene_points("Bending.rest", self.rest, None),
        )


@dataclass(frozen=True, eq=False)
class RigidBody(Term):
    """Vertices that move together as an exact rigid body, free but for what pulls at them.

    vertices (k,), at least three that are not in line; rest [mm], shape (k, 3), is the body's shape and first place,
    default where the scene has them: a scaled bone is a body with another rest.
    """

    varying: ClassVar[tuple[str, ...]] = ("rest",)

    vertices: np.ndarray = field(repr=False)
    rest: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        vertices = self._chosen("vertices")
        if len(vertices) < 3:
            raise SceneError(f"RigidBody.vertices: a body needs at least 3 vertices, got {len(vertices)}")
        rest = None if self.rest is None else _scene_points("RigidBody.rest", self.rest, len(vertices))
        self._set(vertices=vertices, rest=rest)


@dataclass(frozen=True, eq=False)
class Pressure(Term):
    """Follower pressure `value` [kPa] against the outer side of triangles (k, 3), along their present normals.

    The outer side is the one that sees the corners counter-clockwise. One number, or one per triangle; negative sucks.
    """

    varying: ClassVar[tuple[str, ...]] = ("value",)

    triangles: np.ndarray = field(repr=False)
    value: float | np.ndarray

    def __post_init__(self):
        triangles = _triangles("Pressure.triangles", self.triangles)
        self._set(
            triangles=triangles, value=_per_item("Pressure.value", self.value, len(triangles), -np.inf, strict=True)
        )


@dataclass(frozen=True, eq=False)
class Inertia(Term):
    """One step of implicit Euler: density/2 |x - X₁ - h v₁|² / h² per rest volume (method of Bouaziz et al. 2014).

    density [kg/mm³] of the tets, lumped at vertices; time_step h [s]; positions X₁ [mm] and velocities v₁ [mm/s] before
    the step, shape (scene's vertices, 3), default at rest. After the step v = (x - X₁) / h.
    """

    varying: ClassVar[tuple[str, ...]] = ("positions", "velocities")

    density: float | np.ndarray
    time_step: float
    positions: np.ndarray | None = field(default=None, repr=False)
    velocities: np.ndarray | None = field(default=None, repr=False)
    tets: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self):
        tets = None if self.tets is None else self._chosen("tets")
        count = None if tets is None else len(tets)
        step = _numbers("Inertia.time_step", self.time_step)
        if step.shape != () or not (np.isfinite(step) and step > 0):
            raise SceneError(f"Inertia.time_step: must be finite and above 0 s, got {self.time_step!r}")
        places = {
            key: None if value is None else _scene_points(f"Inertia.{key}", value, None)
            for key, value in (("positions", self.positions), ("velocities", self.velocities))
        }
        self._set(
            tets=tets, density=_per_item("Inertia.density", self.density, count, 0.0), time_step=float(step), **places
        )


@dataclass(frozen=True, eq=False)
class Contact(Term):
    """Self-contact of a surface: stiffness/2 per rest area times the squared depth below `thickness`.

    triangles (k, 3) of the scene's vertices, seen counter-clockwise from outside, are kept apart from one another
    (SoftDECA 3.3.2); stiffness [kPa/mm]; thickness [mm] is the gap kept. Solved after the scene without contact.
    """

    triangles: np.ndarray = field(repr=False)
    stiffness: float = 100.0
    thickness: float = 0.0

    def __post_init__(self):
        self._set(
            triangles=_triangles("Contact.triangles", self.triangles),
            stiffness=_one("Contact.stiffness", self.stiffness, 0.0, strict=True),
            thickness=_one("Contact.thickness", self.thickness, 0.0),
        )
