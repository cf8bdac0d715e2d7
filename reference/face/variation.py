"""Parameters a little off, for difference quotients of a face by p: all over the face, or on one triangle at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from ...lhm.base.mesh import Ints, Surface
from .parameters import Parameters

STEP = 1e-5
"""Step of a difference quotient, of a parameter's range."""
WIDE = ("target_stiffness", "skin_bending")
"""Parameters that act on a triangle by the springs at its corners, which their neighbours share."""


def vary(parameters: Parameters, name: str, triangles: Ints | None = None) -> tuple[Parameters, Parameters, Any]:
    """Return p ahead and behind in one parameter, within its range, and how far apart they are.

    triangles: those on which a field (m,) varies, by default all. The distance is a number, or for a
    field of shape (m,).
    """
    info = Parameters.info(name)
    value = np.array(getattr(parameters, name), dtype=np.float64)
    ahead, behind = value.copy(), value.copy()
    step, on = STEP * (info.high - info.low), ... if triangles is None else triangles
    ahead[on] = np.minimum(value[on] + step, info.high)
    behind[on] = np.maximum(value[on] - step, info.low)
    either: list[dict[str, Any]] = [{name: values if values.ndim else float(values)} for values in (ahead, behind)]
    return replace(parameters, **either[0]), replace(parameters, **either[1]), ahead - behind


def split_apart(surface: Surface, wide: bool) -> Iterator[tuple[Ints, Ints]]:
    """Split a surface's triangles into groups whose surroundings share no vertex, so that all of one may vary at once.

    Gives the triangles (k,) of each group, and for each vertex (n,) the triangle that it surrounds, or -1. A triangle's
    surroundings are its corners, and their neighbours where it is `wide`.
    """
    m, n = len(surface.triangles), len(surface.vertices)
    around = csr_matrix((np.ones(3 * m), (np.repeat(np.arange(m), 3), surface.triangles.ravel())), (m, n))
    if wide:
        around = around @ (around.T @ around)
    near = (around @ around.T).tocsr()
    group = np.full(m, -1)
    for t in range(m):
        taken = set(group[near.indices[near.indptr[t] : near.indptr[t + 1]]])
        group[t] = next(number for number in count() if number not in taken)
    for number in range(group.max() + 1):
        own = np.flatnonzero(group == number)
        surroundings = around[own].tocoo()
        owner = np.full(n, -1)
        owner[surroundings.col] = own[surroundings.row]
        yield own, owner
