"""Depths and their errors as colours on the skin wrap, from the front and from behind (SoftDECA, Figure 5)."""

from __future__ import annotations

import numpy as np

from ..lhm.base.mesh import Floats, Surface
from ..lhm.regressor import MeasuredDepths
from ..viewer.pictures import Panel, strip

HALF_TURN = np.array([-1.0, 1.0, -1.0])


def depth_error(skin_wrap: Surface, errors: Floats, caption: str) -> bytes:
    """PNG of errors (n,) [mm] per vertex on the skin wrap, NaN is grey; colours end at the 99 % quantile."""
    top = float(np.nanquantile(errors, 0.99))
    return strip([Panel(caption, skin_wrap, errors, top), Panel("from behind", _turned(skin_wrap), errors, top)])


def depth_comparison(skin_wrap: Surface, predicted: Floats, measured: MeasuredDepths) -> bytes:
    """PNG of one head's measured depths, grey where no ray met bone, beside the predicted ones (n,) [mm]."""
    met = np.where(measured.met, measured.depths, np.nan)
    top, behind = float(np.nanquantile(met, 0.95)), _turned(skin_wrap)
    return strip(
        [
            Panel("measured depth", skin_wrap, met, top),
            Panel("predicted depth", skin_wrap, predicted, top),
            Panel("measured, from behind", behind, met, top),
            Panel("predicted, from behind", behind, predicted, top),
        ],
    )


def _turned(surface: Surface) -> Surface:
    """The same by half a turn about its vertical axis: panels of a strip share their view."""
    x = surface.vertices
    centre = (x.max(axis=0) + x.min(axis=0)) / 2
    return surface.with_vertices(centre + HALF_TURN * (x - centre))
