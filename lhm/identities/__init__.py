"""Identity spaces: models of neutral heads, each with the 52 ARKit expressions."""

from __future__ import annotations

import os

from ..base.errors import InputError
from .anny import ANNY, ANNY_WITHIN, Anny, TransferredSpace
from .space import LinearSpace

__all__ = [
    "ANNY",
    "ANNY_WITHIN",
    "FLAME",
    "Anny",
    "ICTFaceKit",
    "LinearSpace",
    "MeshFolder",
    "TransferredSpace",
    "from_text",
]


def ICTFaceKit(path: str | os.PathLike[str]) -> LinearSpace:
    """Load ICT-FaceKit's space from its .npz [cm in the file]; see `ict`. InputError names a bad file."""
    from .ict import load

    return load(path)


def FLAME(path: str | os.PathLike[str]) -> LinearSpace:
    """Load FLAME's space from a licensed .pkl or .npz [m in the file]; see `flame`. InputError names a bad file."""
    from .flame import load

    return load(path)


def MeshFolder(path: str | os.PathLike[str], *, unit: str = "mm") -> LinearSpace:
    """Load the space of a folder of meshes that share a topology; see `folder`. InputError names a bad file."""
    from .folder import load

    return load(path, unit=unit)


def from_text(text: str) -> LinearSpace:
    """Load the space that a command line names: "anny", "ict:FILE", "flame:FILE" or "folder:DIR".

    Raises InputError for others.
    """
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
