"""The wraps' one triangulation: neighbours, tets, the tets around each column, and values spread over it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.csgraph import connected_components

from ..base.geometry.cholesky import factorise
from ..base.geometry.mirror import symmetrise
from ..base.geometry.topology import graph_laplacian, neighbours, unique_edges
from ..base.mesh import Floats, Ints, Surface
from .layers import prism_tets


def edge_graph(vertices: Floats, triangles: Ints) -> csr_matrix:
    """Edges of a surface, open or closed, each once, with their lengths [mm]: a graph for shortest ways along it."""
    edges = unique_edges(triangles)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    return csr_matrix((np.maximum(length, 1e-9), edges.T), shape=(len(vertices),) * 2)


@dataclass(frozen=True, eq=False)
class Columns:
    """Three stacked wraps of n vertices over `triangles` (m, 3), made once per template.

    `twins` (n,): the vertex that mirrors each, where the wraps are to stay their own mirror image.
    `edges` (n, n): ones where two vertices share an edge, `mean` its rows' averages; `tets` (6 m, 4) of both layers;
    `incident[starts[v] : starts[v + 1]]`: the tets that touch column v, or its twin, under the smaller of their
    numbers; `owner`, `first`: the triangles `owner[first[v] : first[v + 1]]` around vertex v.
    """

    triangles: Ints
    n: int
    twins: Ints | None = field(default=None, repr=False)
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
        column = (tets % n).ravel()
        if self.twins is not None:
            column = np.minimum(column, self.twins[column])
        touched = np.unique(np.column_stack([column, np.repeat(np.arange(len(tets)), 4)]), axis=0)
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

    def symmetrise(self, vertices: Floats) -> Floats:
        """Return one wrap or several, stacked (k n, 3) [mm], as their own mirror image; without twins as they are."""
        return symmetrise(vertices.reshape(-1, self.n, 3), self.twins).reshape(-1, 3)

    def mean_edge(self, vertices: Floats) -> Floats:
        """Mean length [mm] of the edges at each vertex, shape (n,)."""
        rows = np.repeat(np.arange(self.n), np.diff(self.edges.indptr))
        length = np.linalg.norm(vertices[rows] - vertices[self.edges.indices], axis=1)
        return np.bincount(rows, length, self.n) / np.diff(self.edges.indptr)


def fill_harmonically(triangles: Ints, values: Floats, given: np.ndarray) -> Floats:
    """Extend values (n, ...) from where `given` (n,) holds: elsewhere each is the mean of its neighbours.

    A piece of the mesh in which nothing is given stays as it is.
    """
    filled = np.array(values, dtype=np.float64)
    edges = neighbours(triangles, len(filled))
    _, piece = connected_components(edges, directed=False)
    free = ~given & np.isin(piece, piece[given])
    if free.any():
        laplacian = graph_laplacian(edges)[free]
        right = -(laplacian[:, ~free] @ filled[~free].reshape(np.count_nonzero(~free), -1))
        filled[free] = factorise(laplacian[:, free].tocsc())(right).reshape(filled[free].shape)
    return filled
