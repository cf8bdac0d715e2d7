"""The ruler of every comparison of skins: what a method leaves of the motion that bones alone do not explain.

A face whose bones p scales moves by millimetres, and nearly all of that is bone. So errors are measured against
T - carried(S): simulated skin T less blendshapes S carried along by the scaled bones (`carry_skin`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lhm.mesh import Floats

MOVES = 0.05
"""[mm] A vertex counts as moving where |T - carried(S)| is larger."""


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
    left, moved = error[moves], float(motion[moves].mean())
    mean = float(left.mean())
    return Ruler(mean, float(np.percentile(left, 95.0)), float(left.max()), moved, mean / moved, int(moves.sum()))
