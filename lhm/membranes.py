"""Skin that is drawn out between lips or lids when they part: stretched fivefold and more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from .arkit import ARKIT
from .base.geometry.deformation import folded_length, torn_area
from .base.mesh import Floats, Ints, Surface
from .rig import Rig

MOUTH, EYES = ("lips", "mouth"), ("lids", "eyes")
"""Regions of a wrap."""
OPEN, BLINK = ("jawOpen",), ("eyeBlinkLeft", "eyeBlinkRight")


def at(
    skin: Surface, skin_from_wrap: csr_matrix, regions: Mapping[str, NDArray[np.bool_]], names: Sequence[str]
) -> Ints:
    """The skin's triangles (k, 3) with a corner at some of a wrap's regions; none where the wrap lacks them."""
    masks = [regions[name] for name in names if name in regions]
    if not masks:
        return skin.triangles[:0]
    there = skin_from_wrap @ np.any(masks, axis=0).astype(np.float64) > 0.5
    return skin.triangles[there[skin.triangles].any(axis=1)]


def torn(skin: Surface, rig: Rig, triangles: Ints, names: Sequence[str]) -> float:
    """The area [mm²] of triangles that expressions, at full weight together, stretch more than five times."""
    return torn_area(skin.vertices, _moved(skin, rig, names), triangles)


def folded(skin: Surface, rig: Rig, triangles: Ints, names: Sequence[str]) -> float:
    """The length [mm] of the triangles' edges that expressions, at full weight together, fold sharply."""
    return folded_length(skin.vertices, _moved(skin, rig, names), triangles)


def _moved(skin: Surface, rig: Rig, names: Sequence[str]) -> Floats:
    weights = np.zeros(len(ARKIT))
    weights[[ARKIT.index(name) for name in names]] = 1.0
    return skin.vertices + rig.moved(weights)
