"""What ties a registered template and the skin it lies on: displacements of the one as those of the other."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags

from ..base.geometry.bvh import TriangleTree
from ..base.geometry.cholesky import factorise
from ..base.mesh import Floats, Ints, Surface
from ..wraps.landmarks import Mask
from ..wraps.shrinkwrap import neighbours
from .matching import FACING, open_edges

MATCHED = 4.0
"""[mm] Farther from the skin a vertex of the template lies on nothing: its displacement is that of those around it."""
LEAST = 1e-4


def on_template(template: Surface, skin: Surface) -> csr_matrix:
    """Weights (skin vertices, n) of the template's closest point that faces the same way, else of the closest."""
    return _closest(template, skin)[0]


def on_skin(template: Surface, skin: Surface, lid: Mask) -> csr_matrix:
    """Weights (n, skin vertices): displacements of the skin as those of the template's vertices; rows sum to one.

    A vertex within 4 mm of a point that faces the same way, and is not on an open edge, moves as that does. What the
    skin lacks (the lining of a mouth, eye sockets, a neck) follows harmonically what lies around it, but for the `lid`
    (n,) of the template's neck, which moves as what is farthest from it: with the skull, however much a jaw draws at
    the edge of a neck that ends under the chin.
    """
    weights, distance, facing = _closest(skin, template)
    rim = np.zeros(len(skin.vertices), bool)
    rim[open_edges(skin.triangles).ravel()] = True
    on_rim = np.asarray(weights @ rim.astype(float)).ravel() > 0.99
    lost = ~facing | (distance > MATCHED) | (on_rim & (distance > 1.0))
    if not lost.any() or lost.all():
        return weights
    below = np.flatnonzero(lost & lid)
    if below.size:
        away = np.linalg.norm(template.vertices - template.vertices[below].mean(axis=0), axis=1)
        crown = np.where(lost, -1.0, away).argmax()
        weights, lost = with_rows(weights, below, weights[np.full(below.size, crown)]), lost & ~lid
    edges = neighbours(template.triangles, len(template.vertices))
    laplacian = (diags(np.asarray(edges.sum(axis=1)).ravel() + 1e-9) - edges).tocsr()
    inner, around = laplacian[lost][:, lost], laplacian[lost][:, ~lost]
    border = np.flatnonzero(np.asarray(abs(around).sum(axis=0)).ravel())
    filled = factorise(inner.tocsc())(np.asarray(-around[:, border].todense()))
    filled = np.where(filled > LEAST, filled, 0.0)
    total = filled.sum(axis=1, keepdims=True)
    # A piece of the template of which nothing lies on the skin keeps its closest points.
    reached = total[:, 0] > 0.5
    follow = csr_matrix(filled[reached] / total[reached])
    return with_rows(weights, np.flatnonzero(lost)[reached], follow @ weights[np.flatnonzero(~lost)[border]])


def with_rows(matrix: csr_matrix, ids: Ints, rows: csr_matrix) -> csr_matrix:
    """The matrix with `rows` (k, columns) in place of its own `ids` (k,)."""
    n, k = matrix.shape[0], len(ids)
    kept = np.setdiff1d(np.arange(n), ids)
    places = csr_matrix((np.ones(k), (ids, np.arange(k))), shape=(n, k))
    others = csr_matrix((np.ones(len(kept)), (kept, np.arange(len(kept)))), shape=(n, len(kept)))
    return (others @ matrix[kept] + places @ rows).tocsr()


def _closest(surface: Surface, points: Surface) -> tuple[csr_matrix, Floats, np.ndarray]:
    """Weights (points, n) of the closest point on `surface`, its distance [mm], whether it faces the same way."""
    faces = surface.face_normals
    faces = faces / np.maximum(np.linalg.norm(faces, axis=1, keepdims=True), 1e-30)
    tree = TriangleTree(surface.vertices, surface.triangles)
    triangle, weights, distance = tree.closest_facing(points.vertices, points.vertex_normals, faces, FACING)
    lost = triangle < 0
    triangle[lost], weights[lost], distance[lost] = tree.closest(points.vertices[lost])
    shape = (len(points.vertices), len(surface.vertices))
    return barycentric(surface.triangles[triangle], weights, shape), distance, ~lost


def barycentric(ids: Ints, weights: Floats, shape: tuple[int, int]) -> csr_matrix:
    """A matrix whose rows have the weights (k, 3) of the vertices `ids` (k, 3)."""
    return csr_matrix((weights.ravel(), (np.repeat(np.arange(len(ids)), 3), ids.ravel())), shape=shape)
