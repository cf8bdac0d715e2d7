"""Identity spaces: models of neutral heads, each with the 52 ARKit expressions."""

from __future__ import annotations

import os

from ..base.checks import check_arguments
from ..base.errors import InputError
from .space import IdentitySpace, LinearSpace

__all__ = ["FLAME", "Anny", "ICTFaceKit", "IdentitySpace", "LinearSpace", "MeshFolder", "from_text"]


def Anny() -> LinearSpace:
    """The default space (MakeHuman's CC0 data), which is part of this package; see `anny`."""
    from .anny import load

    return load()


@check_arguments
def ICTFaceKit(path: str | os.PathLike[str]) -> LinearSpace:
    """ICT-FaceKit's space from its .npz [cm in the file]; see `ict`. InputError names a bad file."""
    from .ict import load

    return load(path)


@check_arguments
def FLAME(path: str | os.PathLike[str]) -> LinearSpace:
    """FLAME's space from the user's licensed .pkl or .npz [m in the file]; see `flame`. InputError names a bad file."""
    from .flame import load

    return load(path)


@check_arguments
def MeshFolder(path: str | os.PathLike[str], *, unit: str = "mm") -> LinearSpace:
    """The space of a folder of meshes that share a topology; see `folder`. InputError names a bad file."""
    from .folder import load

    return load(path, unit=unit)


@check_arguments
def from_text(text: str) -> LinearSpace:
    """The space that a command line names: "anny", "ict:FILE", "flame:FILE" or "folder:DIR"; InputError for others."""
    kind, _, path = text.partition(":")
    if kind == "anny" and not path:
        return Anny()
    if kind == "ict" and path:
        return ICTFaceKit(path)
    if kind == "flame" and path:
        return FLAME(path)
    if kind == "folder" and path:
        return MeshFolder(path)
    raise InputError(f"identities {text!r}: expected 'anny', 'ict:FILE', 'flame:FILE' or 'folder:DIR'")
