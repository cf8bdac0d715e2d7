"""Values spread over a mesh's vertices from those that are given, as evenly as edges allow."""

from __future__ import annotations

import numpy as np
from scipy.sparse import diags
from scipy.sparse.csgraph import connected_components

from ..base.geometry.cholesky import factorise
from ..base.mesh import Floats, Ints
from .columns import neighbours


def harmonic(triangles: Ints, values: Floats, given: np.ndarray) -> Floats:
    """Values (n, ...) where `given` (n,) holds; elsewhere each the mean of its neighbours'.

    A piece of the mesh in which nothing is given stays as it is.
    """
    found = np.array(values, dtype=np.float64)
    edges = neighbours(triangles, len(found))
    _, piece = connected_components(edges, directed=False)
    free = ~given & np.isin(piece, piece[given])
    if free.any():
        laplacian = (diags(np.asarray(edges.sum(axis=1)).ravel()) - edges).tocsr()[free]
        right = -(laplacian[:, ~free] @ found[~free].reshape(np.count_nonzero(~free), -1))
        found[free] = factorise(laplacian[:, free].tocsc())(right).reshape(found[free].shape)
    return found
