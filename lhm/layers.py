"""Tets between wraps that share a triangulation (SoftDECA 3.1.1)."""

from __future__ import annotations

import numpy as np

from .mesh import Ints


def prism_tets(triangles: Ints, outer_first: int, inner_first: int) -> Ints:
    """Split the prism under each triangle into three tets, shape (3 m, 4).

    Vertex v of the triangulation is vertex outer_first + v of the outer and inner_first + v of the inner wrap. The
    diagonal of each quad runs from its smaller index outside to its larger one inside, so neighbours agree and no
    prism is twisted into Schönhardt's polyhedron. Triangles that are counter-clockwise seen from outside give
    positive tets for wraps that do not cross.
    """
    order = np.argsort(triangles, axis=1)
    i, j, k = np.take_along_axis(triangles, order, axis=1).T
    a, b = outer_first, inner_first
    tets = np.stack(
        [
            np.stack([a + i, a + j, a + k, b + k], axis=1),
            np.stack([a + i, b + j, a + j, b + k], axis=1),
            np.stack([a + i, b + i, b + j, b + k], axis=1),
        ],
        axis=1,
    )
    # The orders above are right for an odd sorting permutation; an even one needs two corners swapped.
    even = (order == [0, 1, 2]).all(1) | (order == [1, 2, 0]).all(1) | (order == [2, 0, 1]).all(1)
    tets[even] = tets[even][..., [0, 2, 1, 3]]
    return tets.reshape(-1, 4)
