"""Parameters that vary smoothly over the face: a few numbers per parameter on waves that are the same for everybody.

u(x) = c_0 + Σ_m c_m cos(k_m · x + b_m) over points x [mm] of the space's mean skin, where u is the parameter's value
mapped to [-1, 1]. So a field has one number more than there are waves, whatever the mesh.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ...lhm.base.mesh import Floats, Surface
from ...lhm.head import LayeredHead

WAVES = 16
LENGTHS = (90.0, 300.0)
"""Shortest and longest wave [mm]: from a cheek to the head."""
SEED = 20231
"""Of the waves' directions, lengths and phases. Another one would give stored coefficients another meaning."""


@cache
def _waves() -> tuple[Floats, Floats]:
    rng = np.random.default_rng(SEED)
    directions = rng.normal(size=(WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lengths = np.exp(rng.uniform(np.log(LENGTHS[0]), np.log(LENGTHS[1]), size=(WAVES, 1)))
    return 2.0 * np.pi * directions / lengths, rng.uniform(0.0, 2.0 * np.pi, WAVES)


def basis(points: Floats) -> Floats:
    """One, then the waves, at points [mm], shape (k, 3); shape (k, 1 + WAVES)."""
    vectors, phases = _waves()
    return np.column_stack([np.ones(len(points)), np.cos(points @ vectors.T + phases)])


def on_faces(mean: Surface) -> Floats:
    """`basis` on the faces of a space's mean skin: the mean of their corners, shape (faces, 1 + WAVES)."""
    return basis(mean.vertices)[mean.triangles].mean(axis=1)


def on_wraps(head: LayeredHead, mean: Surface) -> Floats:
    """`basis` on the triangles of a head's wraps, carried there from the mean skin, shape (triangles, 1 + WAVES)."""
    return (head.wrap_from_skin @ basis(mean.vertices))[head.skin_wrap.triangles].mean(axis=1)
