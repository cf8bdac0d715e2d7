"""The connected parts of a surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..mesh import Ints


def connected_parts(triangles: NDArray[np.integer], n_vertices: int) -> tuple[int, Ints]:
    """How many parts hang together through triangles, and the part of each vertex, shape (n,)."""
    pairs = (np.repeat(triangles[:, 0], 2), triangles[:, 1:].ravel())
    graph = coo_matrix((np.ones(len(pairs[0])), pairs), shape=(n_vertices, n_vertices))
    return connected_components(graph, directed=False)
