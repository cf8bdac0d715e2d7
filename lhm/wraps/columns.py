"""What the stacked wraps' triangulation alone decides: edges, tets, and which tets are around each column."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import connected_components

from ..base.geometry.cholesky import factorise
from ..base.mesh import Floats, Ints, Surface
from ..layers import prism_tets


def neighbours(triangles: Ints, n: int) -> csr_matrix:
    """The edges of a closed surface as a symmetric matrix of ones, shape (n, n)."""
    i, j, k = triangles.T
    rows, columns = np.concatenate([i, j, k]), np.concatenate([j, k, i])
    matrix = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(n, n))
    return ((matrix + matrix.T) > 0).astype(np.float64).tocsr()


def unit(vectors: Floats) -> Floats:
    """The directions of vectors (n, 3); those of no length stay so."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


@dataclass(frozen=True, eq=False)
class Columns:
    """Three stacked wraps of n vertices over `triangles` (m, 3), made once per template.

    `edges` (n, n): ones where two vertices share an edge, `mean` its rows' averages; `tets` (6 m, 4) of both layers;
    `incident[starts[v] : starts[v + 1]]`: the tets that touch column v; `corner`, `owner`, `first`: the triangles
    `owner[first[v] : first[v + 1]]` around vertex v.
    """

    triangles: Ints
    n: int
    edges: csr_matrix = field(init=False, repr=False)
    mean: csr_matrix = field(init=False, repr=False)
    tets: Ints = field(init=False, repr=False)
    incident: Ints = field(init=False, repr=False)
    starts: Ints = field(init=False, repr=False)
    owner: Ints = field(init=False, repr=False)
    first: Ints = field(init=False, repr=False)

    def __post_init__(self):
        n, triangles = self.n, self.triangles
        edges = neighbours(triangles, n)
        tets = np.vstack([prism_tets(triangles, 0, n), prism_tets(triangles, n, 2 * n)])
        touched = np.unique(np.column_stack([(tets % n).ravel(), np.repeat(np.arange(len(tets)), 4)]), axis=0)
        around = np.argsort(triangles.ravel(), kind="stable")
        for name, value in (
            ("edges", edges),
            ("mean", (diags(1 / np.asarray(edges.sum(axis=1)).ravel()) @ edges).tocsr()),
            ("tets", tets),
            ("incident", np.ascontiguousarray(touched[:, 1])),
            ("starts", np.searchsorted(touched[:, 0], np.arange(n + 1))),
            ("owner", around // 3),
            ("first", np.searchsorted(triangles.ravel()[around], np.arange(n + 1))),
        ):
            object.__setattr__(self, name, value)

    def surface(self, vertices: Floats) -> Surface:
        """One wrap with these vertices [mm], shape (n, 3)."""
        return Surface(vertices, self.triangles)

    def mean_edge(self, vertices: Floats) -> Floats:
        """Mean length [mm] of the edges at each vertex, shape (n,)."""
        rows = np.repeat(np.arange(self.n), np.diff(self.edges.indptr))
        length = np.linalg.norm(vertices[rows] - vertices[self.edges.indices], axis=1)
        return np.bincount(rows, length, self.n) / np.diff(self.edges.indptr)


# DOC """Values spread over a mesh's vertices from those that are given, as evenly as edges allow."""
def fill_harmonically(triangles: Ints, values: Floats, given: np.ndarray) -> Floats:
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
