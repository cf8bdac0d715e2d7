"""Openings of a neutral face: the lids of both eyes, and the lips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..base.mesh import Floats, Ints, Surface
from .arkit import index
from .space import EYES, MOUTH, rim_of

FOLLOWS = 0.5
"""Share of the largest motion on a rim from which on a vertex belongs to the part that moves."""
CORNERS = 0.2
"""Share of a rim's width at either end that is left out: corners are never apart."""


@dataclass(frozen=True, eq=False)
class Gap:
    """Pairs of vertices across an opening: upper and lower (k,)."""

    name: str
    upper: Ints
    lower: Ints

    def width(self, skin: np.ndarray) -> float:
        """The mean height [mm] of upper over lower vertices of a skin (n, 3); negative where they cross."""
        return float((skin[self.upper, 1] - skin[self.lower, 1]).mean())


def find_gaps(skin: Surface, parts: Ints, shapes: Floats) -> list[Gap]:
    """Find both eyes' lids and the lips of a neutral skin whose parts are known; shapes (52, n, 3) [mm]."""
    x = skin.vertices[:, 0]
    lids, mouth = (rim_of(skin.triangles, parts, part) for part in (EYES, MOUTH))
    middle = 0.5 * (x.min() + x.max())
    return [
        _gap("left lids", skin, lids[x[lids] > middle], shapes[index("eyeBlinkLeft")], moves="upper"),
        _gap("right lids", skin, lids[x[lids] <= middle], shapes[index("eyeBlinkRight")], moves="upper"),
        _gap("lips", skin, mouth, shapes[index("jawOpen")], moves="lower"),
    ]


def _gap(name: str, skin: Surface, rim: Ints, shape: Floats, *, moves: str) -> Gap:
    x = skin.vertices[rim]
    margin = CORNERS * float(np.ptp(x[:, 0]))
    rim = rim[(x[:, 0] > x[:, 0].min() + margin) & (x[:, 0] < x[:, 0].max() - margin)]
    down = -shape[rim, 1]
    moving, still = rim[down > FOLLOWS * down.max()], rim[down <= FOLLOWS * down.max()]
    upper, lower = (moving, still) if moves == "upper" else (still, moving)
    across = skin.vertices[lower, 0][None] - skin.vertices[upper, 0][:, None]
    return Gap(name, upper, lower[np.argmin(np.abs(across), axis=1)])
