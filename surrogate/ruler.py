"""The ruler of every comparison of skins: what a method leaves of the motion that bones alone do not explain.

A face whose bones p scales moves by millimetres, and nearly all of that is bone. So errors are measured against
T - carried(S): simulated skin T less blendshapes S carried along by the scaled bones (`carry_skin`).

Frames are told apart by kind of p and by strength of the expression. A kind is named for the effect in p, or "several";
materials may differ in each, and "materials" are the faces in which nothing else differs.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..lhm.base.mesh import Floats
from ..reference import Parameters
from .corpus.mixture import BONES, STATIC

MOVES = 0.05
"""[mm] A vertex counts as moving where |T - carried(S)| is larger."""
EFFECTS = {
    "gravity": ("gravity", "gravity_x", "gravity_y", "gravity_z"),
    "volume and growth": ("soft_volume", "muscle_volume", "skin_growth"),
    "bones": BONES,
    "palsy": ("paralysis_left", "paralysis_right"),
}
"""The parameters of each kind of effect; all other static ones are materials."""
DEFAULT, MATERIALS, SEVERAL = "default", "materials", "several"
KINDS = (DEFAULT, MATERIALS, *EFFECTS, SEVERAL)
STRENGTHS = {
    "largest weight below 0.4": (0.0, 0.4),
    "largest weight 0.4 to 0.7": (0.4, 0.7),
    "largest weight above 0.7": (0.7, np.inf),
}
"""Classes of expressions, by their largest weight."""


@dataclass(frozen=True)
class Ruler:
    """Errors on the moving vertices of some frames.

    mean, p95, largest [mm]: distances to T. moved [mm]: mean |T - carried(S)|. share: mean over moved.
    vertices: number of moving vertices over all frames. All but `vertices` are NaN where nothing moves.
    """

    mean: float
    p95: float
    largest: float
    moved: float
    share: float
    vertices: int


def measure(error: Floats, motion: Floats) -> Ruler:
    """Measure distances to T, `error`, against `motion` = |T - carried(S)|; both [mm], shape (frames, n) or (n,)."""
    moves = motion > MOVES
    if not moves.any():
        nan = float("nan")
        return Ruler(nan, nan, nan, nan, nan, 0)
    errors, mean_motion = error[moves], float(motion[moves].mean())
    mean = float(errors.mean())
    return Ruler(
        mean, float(np.percentile(errors, 95.0)), float(errors.max()), mean_motion, mean / mean_motion, int(moves.sum())
    )


def kind_of(names: Iterable[str]) -> str:
    """Name the kind, of KINDS, of a face by the static parameters that differ from their default."""
    differing = set(names)
    effects = [kind for kind, parameters in EFFECTS.items() if differing & set(parameters)]
    if not effects:
        return MATERIALS if differing else DEFAULT
    return effects[0] if len(effects) == 1 else SEVERAL


def kind_of_coefficients(coefficients: Floats) -> str:
    """Name the kind, of KINDS, of a face of a corpus by its coefficients of STATIC, shape (P, 1 + WAVES)."""
    return kind_of(name for name, row in zip(STATIC, coefficients, strict=True) if not _is_default(name, row))


def strength_of(weights: Floats) -> str:
    """Name the class, of STRENGTHS, of an expression's weights (52,)."""
    largest = float(np.max(weights))
    return next(name for name, (low, high) in STRENGTHS.items() if low <= largest < high)


def _is_default(name: str, row: Floats) -> bool:
    info = Parameters.info(name)
    return not np.any(row[1:]) and bool(np.float32(row[0]) == np.float32(info.normalise(info.default)))
