"""The simulation parameters p of SoftDECA (3.3.3) as named fields with default, range, unit and source.

The paper's own list and ranges are not public; these are reconstructed, and each says from what.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from ..lhm.errors import InputError
from ..lhm.mesh import Floats

STANDARD_GRAVITY = 9810.0
"""[mm/s²]"""
TISSUE_DENSITY = 1.04e-6
"""Soft tissue [kg/mm³] (ArtiSynth's face model)."""


@dataclass(frozen=True)
class ParameterInfo:
    """Default, range [low, high] and unit of one parameter; `log` says that it is sampled by its logarithm."""

    name: str
    default: float
    low: float
    high: float
    unit: str
    log: bool
    source: str

    def normalise(self, values):
        """Values mapped so that [low, high] becomes [-1, 1], by the logarithm where `log` holds."""
        scale = np.log if self.log else np.asarray
        low, high = scale(self.low), scale(self.high)
        return 2.0 * (scale(values) - low) / (high - low) - 1.0

    def sample(self, rng: np.random.Generator) -> float:
        """A random value, uniform over the range (over its logarithm where `log` holds)."""
        if self.log:
            return float(np.exp(rng.uniform(np.log(self.low), np.log(self.high))))
        return float(rng.uniform(self.low, self.high))


def _parameter(default: float, low: float, high: float, unit: str, source: str, *, log: bool = False) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "unit": unit, "log": log, "source": source})


@dataclass(frozen=True)
class Parameters:
    """Material and simulation parameters of one face; InputError names a value outside its range."""

    soft_stiffness: float = _parameter(
        5.0,
        1.0,
        20.0,
        "kPa",
        "w_str = 2 mu; fat and SMAS 1.6 (Barbarino 2011), whole face 10 (Nazari 2010)",
        log=True,
    )
    volume_ratio: float = _parameter(
        13.5,
        5.0,
        75.0,
        "1",
        "w_vol / w_str: Poisson's ratio 0.38 to 0.49, 0.45 by default; above 30 linear tets lock",
        log=True,
    )
    strain_limit: float = _parameter(
        1.0,
        1.0,
        1.2,
        "1",
        "epsilon of Eq. 10; 1 by default, since below epsilon > 1 tissue has no shear stiffness and no unique answer",
    )
    muscle_volume_ratio: float = _parameter(1.0, 0.3, 3.0, "1", "w_vol of muscle over soft tissue's (Eq. 12)", log=True)
    muscle_strain_ratio: float = _parameter(
        0.3,
        0.05,
        1.0,
        "1",
        "w_mstr / w_str: Eq. 12 alone leaves the interior without shear stiffness; at 0.05 thin layers buckle into "
        "several minima, from 0.3 on random starts end in one; passive muscle is often given the fat's stiffness, 1",
        log=True,
    )
    skin_stiffness: float = _parameter(
        20.0,
        5.0,
        300.0,
        "mN/mm",
        "w_S = 2 mu t: skin 1.5 mm thick of mu = 6.7 kPa (Flynn's cross-fibre modulus is 5.9); near 60 (mu = 20 kPa) "
        "a membrane without bending stiffness wrinkles at the lips, into several minima",
        log=True,
    )
    target_stiffness: float = _parameter(10.0, 1.0, 30.0, "kPa/mm", "w_inv per area; tissue itself is near 1", log=True)
    soft_volume: float = _parameter(1.0, 0.8, 1.5, "1", "volume sought by soft tissue; +20 % and +40 % in Figure 7")
    muscle_volume: float = _parameter(1.0, 0.8, 1.3, "1", "volume sought by muscle")
    skin_growth: float = _parameter(1.0, 1.0, 1.5, "1", "area sought by the skin; zombification in Figure 7")
    gravity: float = _parameter(
        1.0, 0.0, 3.0, "g", "downward (-y); the scan hangs under 1 g already, so only the difference acts"
    )

    def __post_init__(self):
        for info in self.infos():
            value = getattr(self, info.name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise InputError(f"parameter {info.name}: expected a number, got {value!r}")
            if not info.low <= value <= info.high:
                raise InputError(
                    f"parameter {info.name} = {value:g} is outside [{info.low:g}, {info.high:g}] {info.unit}"
                )
            object.__setattr__(self, info.name, float(value))

    @classmethod
    def infos(cls) -> tuple[ParameterInfo, ...]:
        """Default, range and unit of every parameter, in the order of `vector`."""
        return tuple(ParameterInfo(name=f.name, default=float(f.default), **f.metadata) for f in fields(cls))  # type: ignore[arg-type]

    @classmethod
    def info(cls, name: str) -> ParameterInfo:
        """One parameter's; InputError for an unknown name."""
        for info in cls.infos():
            if info.name == name:
                return info
        raise InputError(f"unknown parameter {name!r}; there are {', '.join(i.name for i in cls.infos())}")

    def vector(self, names: tuple[str, ...] | None = None) -> Floats:
        """The values as an array, of all parameters or of the named ones."""
        names = names or tuple(info.name for info in self.infos())
        return np.array([getattr(self, self.info(name).name) for name in names])
