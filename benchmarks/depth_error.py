"""Depths and their errors as colours on the skin wrap, from the front and from behind (SoftDECA, Figure 5)."""

from __future__ import annotations

import numpy as np

from ..lhm.mesh import Floats, Surface
from .pictures import Panel, strip

HALF_TURN = np.array([-1.0, 1.0, -1.0])


def depth_error(skin_wrap: Surface, errors: Floats, caption: str) -> bytes:
    """PNG of errors (n,) [mm] per vertex on the skin wrap; colours end at the 99 % quantile."""
    top = float(np.quantile(errors, 0.99))
    return strip([Panel(caption, skin_wrap, errors, top), Panel("from behind", _turned(skin_wrap), errors, top)])


def depth_comparison(skin_wrap: Surface, predicted: Floats, measured: Floats) -> bytes:
    """PNG of measured and predicted depths (n,) [mm] of one head beside the size of their difference."""
    off = np.abs(predicted - measured)
    top = float(np.quantile(measured, 0.95))
    return strip(
        [
            Panel("measured depth", skin_wrap, measured, top),
            Panel("predicted depth", skin_wrap, predicted, top),
            Panel("difference", skin_wrap, off, 0.5 * top),
            Panel("from behind", _turned(skin_wrap), off, 0.5 * top),
        ],
    )


def _turned(surface: Surface) -> Surface:
    """The same by half a turn about its vertical axis: panels of a strip share their view."""
    x = surface.vertices
    centre = (x.max(axis=0) + x.min(axis=0)) / 2
    return surface.with_vertices(centre + HALF_TURN * (x - centre))
