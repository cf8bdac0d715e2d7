"""The simulation parameters p of SoftDECA (3.3.3) as named fields with default, range, unit and source.

The paper's own list and ranges are not public; these are reconstructed, and each says from what. Some may vary over
the face, on the triangles of a head's wraps or on its tets (3.5, Eq. 20). A TOML file names some of them:

    soft_stiffness = 4.0
    gravity = 1.5
    skin_stiffness = "cheek.npy"     # one value per triangle of the wraps; beside this file
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.base.checks import array_of_kind, finite
from ...lhm.base.errors import InputError, SceneError, escape, quote
from ...lhm.base.files.text import find_beside, read_toml
from ...lhm.base.mesh import Floats, Surface

STANDARD_GRAVITY = 9810.0
"""[mm/s²]"""
TISSUE_DENSITY = 1.04e-6
"""Soft tissue [kg/mm³] (ArtiSynth's face model)."""
TETS_PER_PRISM = 3


@dataclass(frozen=True)
class ParameterInfo:
    """Default, range [low, high] and unit of one parameter.

    `log` says that it is sampled by its logarithm, `local` that it may vary over the face.
    """

    name: str
    default: float
    low: float
    high: float
    unit: str
    log: bool
    local: bool
    source: str

    def normalise(self, values):
        """Values mapped so that [low, high] becomes [-1, 1], by the logarithm where `log` holds."""
        scale = np.log if self.log else np.asarray
        low, high = scale(self.low), scale(self.high)
        return 2.0 * (scale(values) - low) / (high - low) - 1.0

    def denormalise(self, values):
        """Invert `normalise`; values beyond [-1, 1] are cut to the range."""
        scale, back = (np.log, np.exp) if self.log else (np.asarray, np.asarray)
        low, high = scale(self.low), scale(self.high)
        values = back(low + 0.5 * (np.asarray(values, dtype=np.float64) + 1.0) * (high - low))
        return np.clip(values, self.low, self.high)

    def sample(self, rng: np.random.Generator) -> float:
        """A random value, uniform over the range (over its logarithm where `log` holds)."""
        if self.log:
            return float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))
        return float(rng.uniform(self.low, self.high))


def _parameter(
    default: float, low: float, high: float, unit: str, source: str, *, log: bool = False, local: bool = False
) -> Any:
    described = {"low": low, "high": high, "unit": unit, "log": log, "local": local, "source": source}
    return field(default=default, metadata=described)


def _scale(part: str, low: float, high: float) -> Any:
    return _parameter(1.0, low, high, "1", f"scale of the {part} (bone scale factors, 3.3.3; Figure 7)")


@dataclass(frozen=True, eq=False)
class Parameters:
    """Material and simulation parameters of one face; InputError names a value outside its range.

    A `local` parameter may be an array: one value per triangle of the wraps, or, for those of tissue, one per tet of
    its layer. What belongs to vertices takes the mean of the triangles around.
    """

    soft_stiffness: float | Floats = _parameter(
        5.0,
        1.0,
        20.0,
        "kPa",
        "w_str = 2 mu; fat and SMAS 1.6 (Barbarino 2011), whole face 10 (Nazari 2010)",
        log=True,
        local=True,
    )
    volume_ratio: float | Floats = _parameter(
        13.5,
        5.0,
        75.0,
        "1",
        "w_vol / w_str: Poisson's ratio 0.38 to 0.49, 0.45 by default; above 30 linear tets lock",
        log=True,
        local=True,
    )
    strain_limit: float | Floats = _parameter(
        1.0,
        1.0,
        1.2,
        "1",
        "epsilon of Eq. 10; 1 by default, since below epsilon > 1 tissue has no shear stiffness and no unique answer",
        local=True,
    )
    muscle_volume_ratio: float | Floats = _parameter(
        1.0, 0.3, 3.0, "1", "w_vol of muscle over soft tissue's (Eq. 12)", log=True, local=True
    )
    muscle_strain_ratio: float | Floats = _parameter(
        0.3,
        0.05,
        1.0,
        "1",
        "w_mstr / w_str: Eq. 12 alone leaves the interior without shear stiffness; at 0.05 thin layers buckle into "
        "several minima, from 0.3 on random starts end in one; passive muscle is often given the fat's stiffness, 1",
        log=True,
        local=True,
    )
    skin_stiffness: float | Floats = _parameter(
        20.0,
        5.0,
        300.0,
        "mN/mm",
        "w_S = 2 mu t: skin 1.5 mm thick of mu = 6.7 kPa (Flynn's cross-fibre modulus is 5.9); near 60 (mu = 20 kPa) "
        "a membrane without bending stiffness wrinkles at the lips, into several minima",
        log=True,
        local=True,
    )
    skin_bending: float | Floats = _parameter(
        0.0, 0.0, 100.0, "mN mm", "curvature of the skin; w_S h²/100 = 3 keeps wrinkles wider than edges", local=True
    )
    connector_ratio: float = _parameter(
        10.0, 3.0, 30.0, "1", "w_con: stiffness of connecting tets over soft tissue's (Eq. 15)", log=True
    )
    target_stiffness: float | Floats = _parameter(
        10.0, 1.0, 30.0, "kPa/mm", "w_inv per area; tissue itself is near 1", log=True, local=True
    )
    soft_volume: float | Floats = _parameter(
        1.0, 0.8, 1.5, "1", "volume sought by soft tissue; +20 % and +40 % in Figure 7", local=True
    )
    muscle_volume: float | Floats = _parameter(1.0, 0.8, 1.3, "1", "volume sought by muscle", local=True)
    skin_growth: float | Floats = _parameter(
        1.0, 1.0, 1.5, "1", "area sought by the skin; zombification in Figure 7", local=True
    )
    mandible_scale_x: float = _scale("mandible's width, about its condyles", 0.85, 1.15)
    mandible_scale_y: float = _scale("mandible's height", 0.85, 1.15)
    mandible_scale_z: float = _scale("mandible's length", 0.85, 1.15)
    cranium_scale_x: float = _scale("cranium's width, about its centre", 0.95, 1.05)
    cranium_scale_y: float = _scale("cranium's height", 0.95, 1.05)
    cranium_scale_z: float = _scale("cranium's length", 0.95, 1.05)
    gravity: float = _parameter(
        1.0, 0.0, 3.0, "g", "along gravity_x, y, z; the scan hangs under 1 g downward already: the difference acts"
    )
    gravity_x: float = _parameter(0.0, -1.0, 1.0, "1", "direction of gravity, of any length but zero")
    gravity_y: float = _parameter(-1.0, -1.0, 1.0, "1", "direction of gravity; down (-1) by default")
    gravity_z: float = _parameter(0.0, -1.0, 1.0, "1", "direction of gravity")
    paralysis_left: float = _parameter(
        0.0,
        0.0,
        1.0,
        "1",
        "share of its targets' stiffness that the left half of the subject's face loses (Bell's palsy, Figure 1)",
    )
    paralysis_right: float = _parameter(0.0, 0.0, 1.0, "1", "the same of the right half")
    frequency: float | Floats = _parameter(
        4.0, 2.0, 8.0, "Hz", "of loose flesh in Eq. 9, whose alpha, beta, gamma follow", local=True
    )
    damping: float | Floats = _parameter(0.3, 0.1, 0.7, "1", "damping ratio of loose flesh in Eq. 9", local=True)

    def __post_init__(self):
        for info in self.infos():
            object.__setattr__(self, info.name, _check_value(info, getattr(self, info.name)))
        if not np.any(self.gravity_vector):
            raise InputError("parameters gravity_x, gravity_y, gravity_z: all zero; a direction is needed")

    def __eq__(self, other) -> bool:
        if not isinstance(other, Parameters):
            return NotImplemented
        return all(np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self))

    def __hash__(self) -> int:
        return hash(tuple((np.asarray(getattr(self, f.name)) + 0.0).tobytes() for f in fields(self)))  # no -0.0

    @property
    def gravity_vector(self) -> Floats:
        """gravity_x, gravity_y, gravity_z as they were given."""
        return np.array([self.gravity_x, self.gravity_y, self.gravity_z])

    @property
    def added_gravity(self) -> Floats:
        """The acceleration [mm/s²], shape (3,), beyond the 1 g downward that the scan hangs under."""
        direction = self.gravity_vector / np.abs(self.gravity_vector).max()  # squares of tiny numbers are zero
        return STANDARD_GRAVITY * (self.gravity * direction / np.linalg.norm(direction) - np.array([0.0, -1.0, 0.0]))

    def scale(self, bone: str) -> Floats:
        """The scale factors of a bone, "mandible" or "cranium", shape (3,)."""
        return np.array([getattr(self, f"{bone}_scale_{axis}") for axis in "xyz"])

    @classmethod
    @cache
    def infos(cls) -> tuple[ParameterInfo, ...]:
        """Default, range and unit of every parameter, in the order of `vector`."""
        return tuple(ParameterInfo(name=f.name, default=float(f.default), **f.metadata) for f in fields(cls))  # type: ignore[arg-type]

    @classmethod
    def info(cls, name: str) -> ParameterInfo:
        """One parameter's; InputError for an unknown name."""
        for info in cls.infos():
            if info.name == name:
                return info
        raise InputError(f"unknown parameter {quote(name, 20)!r}; there are {', '.join(i.name for i in cls.infos())}")


def _check_value(info: ParameterInfo, value: Any) -> float | Floats:
    """Return a parameter's value, a float or a read-only array (k,), within its range."""
    if isinstance(value, (bool, str)) or not isinstance(value, (int, float, np.number, np.ndarray)):
        raise InputError(f"parameter {info.name}: expected a number, got {quote(value)}")
    array = np.array(array_of_kind(f"parameter {info.name}", value, "fiu", "a number"), dtype=np.float64)
    if array.ndim and not info.local:
        raise InputError(f"parameter {info.name}: one number for the whole head, got an array of shape {array.shape}")
    if array.ndim > 1 or array.size == 0:
        raise InputError(f"parameter {info.name}: expected one number or shape (k,), got shape {array.shape}")
    bad = np.flatnonzero(~((array >= info.low) & (array <= info.high)))
    if bad.size:
        where = f" (number {bad[0]})" if array.ndim else ""
        unit = "" if info.unit == "1" else f" {info.unit}"
        value = array.ravel()[bad[0]]
        raise InputError(f"parameter {info.name} = {value:g}{where} is outside [{info.low:g}, {info.high:g}]{unit}")
    if array.ndim == 0:
        return float(array)
    array.flags.writeable = False
    return array


def spread_to_triangles(name: str, value: float | Floats, wrap: Surface) -> float | Floats:
    """Spread a parameter to each triangle of the wrap; one number stays one. SceneError for another count."""
    if np.ndim(value) and len(value) != len(wrap.triangles):  # type: ignore[arg-type]
        raise SceneError(f"parameter {name}: {len(value)} values for {len(wrap.triangles)} triangles")  # type: ignore[arg-type]
    return value


def spread_to_tets(name: str, value: float | Floats, wrap: Surface) -> float | Floats:
    """Spread a parameter to each tet of a layer of prisms, from one number, one per triangle, or one per tet."""
    if not np.ndim(value):
        return value
    triangles, count = len(wrap.triangles), len(value)  # type: ignore[arg-type]
    if count == triangles:
        return np.repeat(value, TETS_PER_PRISM)
    if count != TETS_PER_PRISM * triangles:
        raise SceneError(
            f"parameter {name}: {count} values for {triangles} triangles, or {TETS_PER_PRISM * triangles} tets"
        )
    return value


def spread_to_vertices(name: str, value: float | Floats, wrap: Surface) -> float | Floats:
    """Spread a parameter to each vertex: the mean over the triangles around, weighted by their area."""
    if not np.ndim(value):
        return value
    weight = np.repeat(wrap.areas, 3)
    values = np.repeat(spread_to_triangles(name, value, wrap), 3)
    corners, n = wrap.triangles.ravel(), len(wrap.vertices)
    return np.bincount(corners, weight * values, n) / np.maximum(np.bincount(corners, weight, n), 1e-300)


def read_parameters(path: str | os.PathLike[str]) -> Parameters:
    """Read the parameters in a TOML file; what it does not name keeps its default.

    Raises InputError, one line that names the file and the parameter, for a file that is missing or no TOML, an unknown
    name, and a value that is no number or out of range.
    """
    path = Path(path)
    named = read_toml(path)
    try:
        values: dict[str, Any] = {
            Parameters.info(name).name: _read_array(path, value, name) if isinstance(value, str) else value
            for name, value in named.items()
        }
        return Parameters(**values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read_array(naming: Path, value: str, name: str) -> Floats:
    if not value.endswith(".npy"):
        raise InputError(f"parameter {name}: {quote(value)}: expected a number, or an .npy file")
    try:
        path = find_beside(naming, value)
    except InputError as error:
        raise InputError(f"parameter {name}: {error}") from None
    try:
        # A map of the file cannot be longer than the file, whatever its header says.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # numpy's reader raises whatever the damage makes it raise
        reason = escape(" ".join(str(error).split()))[:60]
        raise InputError(f"parameter {name}: {path}: not an array of numbers ({reason})") from None
    values = np.array(finite(f"parameter {name}: {path}", array))
    try:
        Parameters(**{Parameters.info(name).name: values})  # type: ignore[arg-type]  # one of those that may vary
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return values
