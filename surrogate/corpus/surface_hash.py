"""A name for a template by which corpora and checkpoints tell theirs from others."""

from __future__ import annotations

import hashlib

import numpy as np

from ...lhm.base.mesh import Surface


def surface_hash(surface: Surface) -> str:
    """Of a surface's triangles, and its vertices to 0.01 mm: 16 hexadecimal digits."""
    digest = hashlib.sha256(np.ascontiguousarray(surface.triangles, dtype="<i8").tobytes())
    digest.update(np.round(surface.vertices * 100.0).astype("<i8").tobytes())
    return digest.hexdigest()[:16]
