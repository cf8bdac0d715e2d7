"""Deformation transfer by one prefactorised system (Sumner & Popović 2004; Botsch et al. 2006; SoftDECA Eq. 17).

Per face, J acts from the left on the gradient of the blended skin S. The answer x solves

    K (x - S) = Gᵀ D ((J - I) G S),    K = Gᵀ D G + anchors,

with gradients G and areas D of one fixed reference mesh. J that are integrable give their surface exactly whatever the
reference is, so one factorisation serves all identities, and faces move the answer away from S only where J is not I.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csc_matrix

from ..checks import indices_below
from ..errors import MeshError
from ..kernels import njit
from ..mesh import Floats, Surface
from .cholesky import factorise
from .topology import connected_parts

FLOOR = 1e-4
"""Added to each squared singular value of a face's edges, relative to their sum."""


def sumner_frames(vertices: Floats, triangles) -> Floats:
    """Return [e1, e2, n/√|n|] per face as columns [mm], n = e1 × e2, shape (m, 3, 3) (Sumner & Popović 2004, Eq. 2)."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.stack([b - a, c - a, normal / np.sqrt(length)], axis=2)


def deformation_gradients(before: Floats, after: Floats, triangles) -> Floats:
    """Return J per face, from the Sumner frame of `before` to that of `after` [mm, shape (n, 3)], shape (m, 3, 3).

    Raises MeshError for a triangle without area in `before`.
    """
    check_areas("before", before, triangles)
    frames, moved = sumner_frames(before, triangles), sumner_frames(after, triangles)
    return moved @ np.linalg.inv(frames)


def least_gradients(before: NDArray, moves: NDArray, triangles) -> NDArray:
    """Return the smallest J - I per face that moves the edges of `before` (n, 3) along `moves` (..., n, 3) [mm].

    Shape (..., m, 9). Faces that are nearly flat are moved less: FLOOR.
    """
    edges, moved = (_edges(positions, triangles) for positions in (before, moves))
    gram = edges.swapaxes(-1, -2) @ edges
    gram += FLOOR * np.trace(gram, axis1=-2, axis2=-1)[..., None, None] * np.eye(2, dtype=gram.dtype)
    return (moved @ np.linalg.solve(gram, edges.swapaxes(-1, -2))).reshape(*moves.shape[:-2], len(triangles), 9)


def _edges(positions: NDArray, triangles) -> NDArray:
    """Return the two edges of each face from its first corner as columns, shape (..., m, 3, 2)."""
    corners = positions[..., triangles, :]
    return (corners[..., 1:, :] - corners[..., :1, :]).swapaxes(-1, -2)


def check_areas(name: str, vertices: Floats, triangles) -> None:
    """Raise MeshError for triangles without area: how many, and the first by its number."""
    g11, g12, g22 = _edge_products(vertices, triangles)
    flat = np.flatnonzero(g11 * g22 - g12**2 <= 1e-14 * (g11 + g22) ** 2)  # left: (2 area)²
    if flat.size:
        raise MeshError(f"{name}: {flat.size} triangles have no area, the first is number {flat[0]}")


class DeformationTransfer:
    """The prefactorised system of a reference surface; `dtype` is float32 or float64.

    `anchors` (indices) are drawn to where the blended skin has them, with `weight` times the mean diagonal of GᵀDG.
    `matrix` is K; `solve` maps b, shape (n, columns), C-contiguous and of this dtype, to K⁻¹ b.
    Raises MeshError for reference triangles without area, for anchors that are no vertices, and for a connected part
    without one.
    """

    def __init__(self, reference: Surface, anchors, *, weight: float = 1.0, dtype=np.float64):
        self.dtype = np.dtype(dtype)
        self.triangles = np.ascontiguousarray(reference.triangles, dtype=np.int32)
        self.n_vertices = len(reference.vertices)
        self.stiffness = _edge_stiffness(reference).astype(self.dtype)
        places = indices_below("anchors", anchors, self.n_vertices, (None,), error=MeshError)
        self.matrix = self._matrix(places, weight).astype(self.dtype)
        self.solve = factorise(self.matrix)

    def _matrix(self, anchors, weight) -> csc_matrix:
        """Return K = GᵀDG + anchors."""
        count, part = connected_parts(self.triangles, self.n_vertices)
        bare = np.setdiff1d(np.arange(count), part[anchors])
        if bare.size:
            vertex = np.flatnonzero(part == bare[0])[0]
            raise MeshError(f"anchors: the part of vertex {vertex} has none; give each part one")
        c11, c12, c22 = self.stiffness.astype(np.float64).T
        local = np.stack([c11 + 2 * c12 + c22, -c11 - c12, -c12 - c22, c11, c12, c22], axis=1)
        blocks = local[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].ravel()
        rows = np.repeat(self.triangles, 3, axis=1).ravel()
        columns = np.tile(self.triangles, (1, 3)).ravel()
        matrix = coo_matrix((blocks, (rows, columns)), shape=(self.n_vertices,) * 2).tocsc()
        added = np.zeros(self.n_vertices)
        added[anchors] = weight * matrix.diagonal().mean()
        return (matrix + coo_matrix((added, (np.arange(self.n_vertices),) * 2))).tocsc()

    def delta(self, gradients: NDArray, blended: NDArray) -> NDArray:
        """Return the motion x - S [mm] of J - I, shape (batch, m, 9), and S [mm]; x and S have shape (batch, n, 3)."""
        forces = np.zeros((self.n_vertices, len(blended), 3), dtype=self.dtype)
        _face_forces(gradients, blended, self.triangles, self.stiffness, forces)
        return self.solve(forces.reshape(self.n_vertices, -1)).reshape(forces.shape).transpose(1, 0, 2)

    def displacements(self, edges: NDArray) -> NDArray:
        """Return the motions [mm], shape (batch, n, 3), whose edges are closest to those given; anchors stay.

        edges: per face what its edges (corner 2 - corner 1) and (corner 3 - corner 1) are to gain [mm], shape
        (batch, m, 2, 3).
        """
        forces = np.zeros((self.n_vertices, len(edges), 3), dtype=self.dtype)
        _edge_forces(edges, self.triangles, self.stiffness, forces)
        return self.solve(forces.reshape(self.n_vertices, -1)).reshape(forces.shape).transpose(1, 0, 2)

    def pull_back(self, cotangent: NDArray, blended: NDArray) -> NDArray:
        """Apply the transpose of `delta` in its gradients, from shape (batch, n, 3) to (batch, m, 9)."""
        right_side = np.ascontiguousarray(cotangent.transpose(1, 0, 2), dtype=self.dtype)
        solved = self.solve(right_side.reshape(self.n_vertices, -1)).reshape(right_side.shape)
        out = np.empty((len(blended), len(self.triangles), 9), dtype=self.dtype)
        _face_cotangents(solved, blended, self.triangles, self.stiffness, out)
        return out


def _edge_stiffness(reference: Surface) -> Floats:
    """Return area · Dm⁻¹ Dm⁻ᵀ per face as (c11, c12, c22): all of D and G that a face needs, shape (m, 3)."""
    check_areas("reference", reference.vertices, reference.triangles)
    g11, g12, g22 = _edge_products(reference.vertices, reference.triangles)
    return np.stack([g22, -g12, g11], axis=1) / (2.0 * np.sqrt(g11 * g22 - g12**2))[:, None]


def _edge_products(vertices: Floats, triangles) -> tuple[Floats, Floats, Floats]:
    """Return e1·e1, e1·e2 and e2·e2 per face [mm²]."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    e1, e2 = b - a, c - a
    return (e1 * e1).sum(axis=1), (e1 * e2).sum(axis=1), (e2 * e2).sum(axis=1)


@njit(cache=True, fastmath=True)
def _face_forces(gradients, blended, triangles, stiffness, forces):
    """Add Gᵀ D ((J - I) G S) of each batch item to forces, shape (n, batch, 3)."""
    for b in range(blended.shape[0]):
        for f in range(triangles.shape[0]):
            i, j, k = triangles[f]
            c11, c12, c22 = stiffness[f]
            u0, u1, u2, v0, v1, v2 = weighted_edges(blended[b], i, j, k, c11, c12, c22)
            for r in range(3):
                m0, m1, m2 = gradients[b, f, 3 * r], gradients[b, f, 3 * r + 1], gradients[b, f, 3 * r + 2]
                at_j = m0 * u0 + m1 * u1 + m2 * u2
                at_k = m0 * v0 + m1 * v1 + m2 * v2
                forces[j, b, r] += at_j
                forces[k, b, r] += at_k
                forces[i, b, r] -= at_j + at_k


@njit(cache=True)
def _edge_forces(edges, triangles, stiffness, forces):
    """Add Gᵀ D of the gradients that edges make to forces, shape (n, batch, 3)."""
    for b in range(edges.shape[0]):
        for f in range(triangles.shape[0]):
            i, j, k = triangles[f]
            c11, c12, c22 = stiffness[f]
            for r in range(3):
                at_j = c11 * edges[b, f, 0, r] + c12 * edges[b, f, 1, r]
                at_k = c12 * edges[b, f, 0, r] + c22 * edges[b, f, 1, r]
                forces[j, b, r] += at_j
                forces[k, b, r] += at_k
                forces[i, b, r] -= at_j + at_k


@njit(cache=True, fastmath=True)
def _face_cotangents(solved, blended, triangles, stiffness, out):
    for b in range(blended.shape[0]):
        for f in range(triangles.shape[0]):
            i, j, k = triangles[f]
            c11, c12, c22 = stiffness[f]
            u0, u1, u2, v0, v1, v2 = weighted_edges(blended[b], i, j, k, c11, c12, c22)
            for r in range(3):
                at_j = solved[j, b, r] - solved[i, b, r]
                at_k = solved[k, b, r] - solved[i, b, r]
                out[b, f, 3 * r] = at_j * u0 + at_k * v0
                out[b, f, 3 * r + 1] = at_j * u1 + at_k * v1
                out[b, f, 3 * r + 2] = at_j * u2 + at_k * v2


@njit(cache=True, fastmath=True, inline="always")
def weighted_edges(positions, i, j, k, c11, c12, c22):
    """Return D G of one face: its edges e1, e2 combined to c11 e1 + c12 e2 and c12 e1 + c22 e2."""
    a0, a1, a2 = (
        positions[j, 0] - positions[i, 0],
        positions[j, 1] - positions[i, 1],
        positions[j, 2] - positions[i, 2],
    )
    b0, b1, b2 = (
        positions[k, 0] - positions[i, 0],
        positions[k, 1] - positions[i, 1],
        positions[k, 2] - positions[i, 2],
    )
    return (
        c11 * a0 + c12 * b0,
        c11 * a1 + c12 * b1,
        c11 * a2 + c12 * b2,
        c12 * a0 + c22 * b0,
        c12 * a1 + c22 * b1,
        c12 * a2 + c22 * b2,
    )
