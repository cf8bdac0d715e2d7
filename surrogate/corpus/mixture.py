"""Parameter sets of a corpus: a documented mixture of materials and effects, uniform or varying over the face.

| kind      | what differs from the default face                                                                      |
|-----------|---------------------------------------------------------------------------------------------------------|
| materials | stiffnesses of soft tissue, muscle, skin and targets, volume ratios; a strain limit in a tenth of all    |
| effects   | two to four of: weight, muscle volume, growing skin, mandible, cranium, gravity on lean tissue, palsy  |
| both      | materials, and effects                                                                                  |
| single    | one of these effects alone                                                                              |

Frequency and damping differ in all. What is `local` is one number, or a smooth random field in the share of
sets that the plan gives. Ranges are those of `Parameters`, but for these, where the energy would have several minima:
muscle's strain ratio from 0.3 on, a strain limit up to 1.1, growth up to 1.4; a skin that is stiff or grows also bends.

A field is a few numbers on waves that are the same for everybody: u(x) = c_0 + Σ_m c_m cos(k_m · x + b_m) over points
x [mm] of the space's mean skin, where u is the parameter's value mapped to [-1, 1].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ...lhm.base.mesh import Floats, Surface
from ...lhm.head.head import LayeredHead
from ...reference import Parameters

KINDS = ("materials", "effects", "both", "single")
NAMES = tuple(info.name for info in Parameters.infos())
INFOS = {info.name: info for info in Parameters.infos()}
BONES = tuple(f"{bone}_scale_{axis}" for bone in ("cranium", "mandible") for axis in "xyz")
"""The parameters that scale bones."""
STATIC = tuple(name for name in NAMES if name not in ("frequency", "damping"))
"""The parameters that a static frame depends on."""
_STATIC_ROWS = [NAMES.index(name) for name in STATIC]
WAVES = 16
LENGTHS = (90.0, 300.0)
"""Shortest and longest wave [mm]: from a cheek to the head."""
FIELD_SEED = 20231
"""Seed of the waves' directions, lengths and phases. Another one changes the meaning of stored coefficients."""
MATERIALS: dict[str, tuple[float, float]] = {
    "soft_stiffness": (1.0, 20.0),
    "volume_ratio": (5.0, 75.0),
    "muscle_volume_ratio": (0.3, 3.0),
    "muscle_strain_ratio": (0.3, 1.0),
    "skin_stiffness": (5.0, 300.0),
    "target_stiffness": (1.0, 30.0),
}
LIMITED = 0.1
"""Share of materials with a strain limit."""
LEAN = (1.0, 3.0)
"""Soft tissue's stiffness [kPa] under gravity, where the material is not drawn itself: that of fat and SMAS."""
STIFF_SKIN = 40.0
"""Skin [mN/mm] from which on it bends, too: it would wrinkle into several minima."""
EDGE = 4.0
"""Edge [mm] of the wraps at the middle level: bending of w h²/100 keeps wrinkles wider than edges."""
COMPLETE = 0.65
"""Share of palsies that are complete: a half loses its expression between 90 and 100 %, where few others are."""
IN_FIELD = 3
"""Waves of one field."""


@cache
def _waves() -> tuple[Floats, Floats]:
    rng = np.random.default_rng(FIELD_SEED)
    directions = rng.normal(size=(WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lengths = np.exp(rng.uniform(np.log(LENGTHS[0]), np.log(LENGTHS[1]), size=(WAVES, 1)))
    return 2.0 * np.pi * directions / lengths, rng.uniform(0.0, 2.0 * np.pi, WAVES)


def basis(points: Floats) -> Floats:
    """Evaluate one, then the waves, at points [mm], shape (k, 3); shape (k, 1 + WAVES)."""
    vectors, phases = _waves()
    return np.column_stack([np.ones(len(points)), np.cos(points @ vectors.T + phases)])


def basis_on_wraps(head: LayeredHead, mean: Surface) -> Floats:
    """Evaluate `basis` on triangles of a head's wraps, carried from the mean skin, shape (triangles, 1 + WAVES)."""
    return (head.wrap_from_skin @ basis(mean.vertices))[head.skin_wrap.triangles].mean(axis=1)


def select_static(coefficients: Floats) -> Floats:
    """Return the rows of STATIC, shape (S, 1 + WAVES), of the coefficients of all parameters."""
    return coefficients[_STATIC_ROWS]


@dataclass(frozen=True, eq=False)
class ParameterSet:
    """One p: `kind` of KINDS; `varied` (P,) which of NAMES differ from the default; coefficients (P, 1 + WAVES).

    The coefficients are of values mapped to [-1, 1]; zero after the first where a value is uniform.
    """

    kind: str
    varied: np.ndarray
    coefficients: np.ndarray

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that differ from the default."""
        return tuple(name for name, varied in zip(NAMES, self.varied, strict=True) if varied)

    @property
    def static(self) -> Floats:
        """The coefficients of STATIC, shape (S, 1 + WAVES)."""
        return select_static(self.coefficients)

    @property
    def uniform(self) -> bool:
        """Whether no parameter varies over the face."""
        return not self.coefficients[:, 1:].any()

    def parameters(self, head: LayeredHead, mean: Surface) -> Parameters:
        """Return the parameters of a head whose skin has the vertices of the space's `mean`."""
        values: dict[str, Any] = {name: self.level(name) for name in self.names}
        if not self.uniform:
            waves = basis_on_wraps(head, mean)
            for name in self.names:
                row = self.coefficients[NAMES.index(name)].astype(np.float64)
                if row[1:].any():
                    values[name] = INFOS[name].denormalise(waves @ row)
        return Parameters(**values)

    def level(self, name: str) -> float:
        """Return a parameter's value without its waves: the default where it does not differ."""
        if name not in self.names:
            return INFOS[name].default
        return float(INFOS[name].denormalise(np.float64(self.coefficients[NAMES.index(name), 0])))


def draw(rng: np.random.Generator, kind: str, *, field: bool) -> ParameterSet:
    """Draw a random parameter set of a kind; with `field`, local parameters vary over the face."""
    drawn = _Draw(rng, field)
    if kind in ("materials", "both"):
        _materials(drawn)
    if kind in ("effects", "both", "single"):
        count = 1 if kind == "single" else 2 + rng.integers(3)
        for name in sorted(rng.choice(list(EFFECTS), count, replace=False)):
            EFFECTS[name](drawn)
    drawn.settle_skin()
    for name in ("frequency", "damping"):
        drawn.uniform(name, INFOS[name].low, INFOS[name].high)
    return ParameterSet(kind, drawn.varied, drawn.coefficients)


class _Draw:
    """Coefficients as they are drawn, in float32, so that what is simulated is what is stored."""

    def __init__(self, rng: np.random.Generator, field: bool):
        self.rng, self.field = rng, field
        self.varied = np.zeros(len(NAMES), dtype=bool)
        self.coefficients = np.zeros((len(NAMES), 1 + WAVES), dtype=np.float32)
        self.coefficients[:, 0] = [info.normalise(info.default) for info in INFOS.values()]

    def has(self, name: str) -> bool:
        return bool(self.varied[NAMES.index(name)])

    def largest(self, name: str) -> float:
        """Return an upper bound of the parameter over the face."""
        row = self.coefficients[NAMES.index(name)].astype(np.float64)
        return float(INFOS[name].denormalise(row[0] + np.abs(row[1:]).sum()))

    def uniform(self, name: str, low: float, high: float):
        """Draw one number of the range, by its logarithm where the parameter is sampled so."""
        self._set(name, self.rng.uniform(*INFOS[name].normalise(np.array([low, high]))))

    def local(self, name: str, low: float, high: float):
        """Draw a field within the range, or one number."""
        if not self.field:
            self.uniform(name, low, high)
            return
        bottom, top = INFOS[name].normalise(np.array([low, high]))
        amplitude = 0.5 * (top - bottom) * self.rng.uniform(0.3, 1.0)
        self._set(name, self.rng.uniform(bottom + amplitude, top - amplitude))
        waves = self.rng.choice(WAVES, IN_FIELD, replace=False)
        shares = self.rng.dirichlet(np.ones(IN_FIELD)) * self.rng.choice([-1.0, 1.0], IN_FIELD)
        self.coefficients[NAMES.index(name), 1 + waves] = amplitude * shares

    def _set(self, name: str, normalised: float):
        self.varied[NAMES.index(name)] = True
        self.coefficients[NAMES.index(name)] = 0.0
        self.coefficients[NAMES.index(name), 0] = normalised

    def settle_skin(self):
        """Add bending for a skin that is stiff or grows."""
        stiffness = self.largest("skin_stiffness")
        if stiffness <= STIFF_SKIN and not self.has("skin_growth"):
            return
        bending = max(stiffness, 100.0 if self.has("skin_growth") else 0.0) * EDGE**2 / 100.0
        self.uniform("skin_bending", *np.minimum([0.5 * bending, 2.0 * bending], INFOS["skin_bending"].high))


def _materials(drawn: _Draw):
    for name, span in MATERIALS.items():
        drawn.local(name, *span)
    if drawn.rng.random() < LIMITED:
        drawn.local("strain_limit", 1.0, 1.1)


def _weight(drawn: _Draw):
    drawn.local("soft_volume", 0.8, 1.5)


def _muscle(drawn: _Draw):
    drawn.local("muscle_volume", 0.8, 1.3)


def _growth(drawn: _Draw):
    drawn.local("skin_growth", 1.0, 1.4)


def _mandible(drawn: _Draw):
    for axis in "xyz":
        drawn.uniform(f"mandible_scale_{axis}", 0.85, 1.15)


def _cranium(drawn: _Draw):
    for axis in "xyz":
        drawn.uniform(f"cranium_scale_{axis}", 0.95, 1.05)


def _gravity(drawn: _Draw):
    drawn.uniform("gravity", 0.0, 3.0)
    if drawn.rng.random() < 0.5:
        direction = drawn.rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        for axis, value in zip("xyz", direction, strict=True):
            drawn.uniform(f"gravity_{axis}", value, value)
    if not drawn.has("soft_stiffness"):
        drawn.local("soft_stiffness", *LEAN)


def _palsy(drawn: _Draw):
    side = ("left", "right")[drawn.rng.integers(2)]
    low = 1.0 if drawn.rng.random() < COMPLETE else 0.3
    drawn.uniform(f"paralysis_{side}", low, 1.0)


EFFECTS: dict[str, Callable[[_Draw], None]] = {
    "cranium": _cranium,
    "gravity": _gravity,
    "growth": _growth,
    "mandible": _mandible,
    "muscle": _muscle,
    "palsy": _palsy,
    "weight": _weight,
}
