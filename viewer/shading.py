"""How dark the hidden parts of a head are drawn: else the inside of a mouth or socket would look like skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..lhm.base.geometry.rays import visible_sky
from ..lhm.base.mesh import Floats, Surface

SKIN, INSIDE = "#d8a48f", "#4a211f"
LIGHT = 0.2
"""The share of the sky from which up a vertex is drawn as skin; one that sees nothing is drawn as INSIDE."""


def lit(surface: Surface) -> Floats:
    """The share (n,) of SKIN in a vertex' colour, from 0 where it sees nothing of the sky to 1."""
    return np.clip(visible_sky(surface) / LIGHT, 0.0, 1.0)


def shades(surface: Surface) -> NDArray[np.uint8]:
    """Colours (n, 3) of a skin at rest: SKIN where it sees the sky, INSIDE where it does not."""
    seen = lit(surface)[:, None]
    return np.round(seen * colour(SKIN) + (1 - seen) * colour(INSIDE)).astype(np.uint8)


def colour(text: str) -> Floats:
    """Red, green and blue, 0 to 255, shape (3,), of a colour as #rrggbb."""
    return np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)], dtype=float)


def linear_light(colours: Floats | NDArray[np.uint8]) -> Floats:
    """Colours of a screen, 0 to 255, as shares of light in [0, 1], which a renderer reckons in (gamma 2.2)."""
    return (colours / 255.0) ** 2.2
