"""A layered head on disk: one .npz to load again, and tagged tets for other programs."""

from __future__ import annotations

import os

import numpy as np

from ..base.errors import MeshError
from ..base.files.pack import load_packed, save_packed
from ..base.files.tet_file import TaggedTets
from ..base.mesh import TetMesh
from .head import LayeredHead

FORMAT = "softdeca layered head 2"


def save_head(path: str | os.PathLike[str], head: LayeredHead) -> None:
    """Write a head to a .npz file, whole or not at all."""
    save_packed(path, FORMAT, head)


def load_head(path: str | os.PathLike[str]) -> LayeredHead:
    """Read a head; InputError names a file that is missing, damaged, of another version or something else."""
    again = "fit the head again by `softdeca head fit`"
    return load_packed(path, FORMAT, LayeredHead, what="a layered head", else_do=again)


SOFT, MUSCLE = 1, 2
NAMES = {"soft_tissue": (SOFT, 3), "muscle": (MUSCLE, 3), "skin": (11, 2), "muscle_wrap": (12, 2), "skull": (13, 2)}
"""Name, and tag and dimension, of what a head's file holds."""


def tets_from_head(head: LayeredHead, layers: tuple[int, int] = (1, 1)) -> TaggedTets:
    """Return a head's tets, in so many layers of soft tissue and muscle or its own volume mesh, and its three wraps.

    Raises MeshError for layers of a head whose tets are a volume mesh, InputError for counts below one.
    """
    if head.volume is not None and tuple(layers) != (1, 1):
        raise MeshError(f"layers {tuple(layers)}: the head's tets are a volume mesh, not layers of prisms")
    soft, muscle = (head.soft, head.muscle) if tuple(layers) == (1, 1) else head.sub_layers(*layers)
    triangles, n = head.skin_wrap.triangles, len(head.bone)
    firsts = (0, n, 2 * n) if head.volume is not None else (0, layers[0] * n, sum(layers) * n)
    tags = [tag for tag, dimension in NAMES.values() if dimension == 2]
    return TaggedTets(
        TetMesh(soft.vertices, np.vstack([soft.tets, muscle.tets])),
        np.repeat([SOFT, MUSCLE], [len(soft.tets), len(muscle.tets)]),
        {tag: name for name, (tag, _) in NAMES.items()},
        {tag: triangles + first for tag, first in zip(tags, firsts, strict=True)},
    )
