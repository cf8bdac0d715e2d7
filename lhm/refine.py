"""Finer meshes of an unchanged domain, for studies of how an answer depends on the mesh."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, hstack, vstack
from scipy.sparse import identity as sparse_identity

from .base.geometry.topology import midpoints, split_triangles
from .base.mesh import Floats, Ints, Surface, TetMesh
from .head import LayeredHead

# Edges of a tet by their two corners; the corner tets of the red refinement, and the octahedron's four tets about each
# of its three diagonals (pairs of opposite edges), as indices into the ten nodes (corners, then edges' middles).
EDGES = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]])
CORNER_TETS = np.array([[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3]])
DIAGONALS = np.array([[4, 9], [5, 8], [6, 7]])
AROUND = np.array([[5, 6, 8, 7], [4, 7, 9, 6], [4, 5, 9, 8]])


def refined_tets(mesh: TetMesh) -> tuple[TetMesh, Ints]:
    """Every tet split into eight (Bey's red refinement), and each new tet's parent, shape (8 m,).

    The domain and each parent's volume stay; old vertices come first. The inner octahedron is cut along its shortest
    diagonal.
    """
    ends, middles = midpoints(mesh.tets, EDGES, len(mesh.vertices))
    vertices = np.vstack([mesh.vertices, mesh.vertices[ends].mean(axis=1)])
    nodes = np.hstack([mesh.tets, len(mesh.vertices) + middles])
    along = vertices[nodes[:, DIAGONALS[:, 0]]] - vertices[nodes[:, DIAGONALS[:, 1]]]
    shortest = np.argmin(np.einsum("mkd,mkd->mk", along, along), axis=1)
    first, last = np.take_along_axis(nodes, DIAGONALS[shortest], axis=1).T
    ring = np.take_along_axis(nodes, AROUND[shortest], axis=1)
    inner = [np.stack([first, last, ring[:, k], ring[:, (k + 1) % 4]], axis=1) for k in range(4)]
    tets = np.stack([*(nodes[:, corner] for corner in CORNER_TETS), *inner], axis=1).reshape(-1, 4)
    a, b, c, d = (vertices[tets[:, k]] for k in range(4))
    negative = np.einsum("md,md->m", np.cross(b - a, c - a), d - a) < 0.0
    tets[negative] = tets[negative][:, [0, 2, 1, 3]]
    return TetMesh(vertices, tets), np.repeat(np.arange(len(mesh.tets)), 8)


def refined_head(head: LayeredHead) -> LayeredHead:
    """The head with every triangle of its wraps split into four at its edges' middles: the same surfaces, finer.

    Its tets, a `volume`, are the head's split into eight (prisms between the finer wraps could be inverted where the
    head's are twisted), so a layer of tets becomes two. Old vertices of a wrap come first. The skin stays, tied to
    them. A new vertex belongs to a bone if both ends of its edge do, and to a region likewise.
    """
    triangles, n = head.skin_wrap.triangles, len(head.bone)
    finer, ends = split_triangles(triangles, n)
    count = len(ends)
    mean = csr_matrix((np.full(2 * count, 0.5), (np.repeat(np.arange(count), 2), ends.ravel())), shape=(count, n))
    carry = vstack([sparse_identity(n, format="csr"), mean]).tocsr()

    def surface(wrap: Surface) -> Surface:
        return Surface(_carried(carry, wrap.vertices), finer)

    bone = np.where(head.bone[ends[:, 0]] == head.bone[ends[:, 1]], head.bone[ends[:, 0]], 0)
    return LayeredHead(
        skin=head.skin,
        skin_wrap=surface(head.skin_wrap),
        muscle_wrap=surface(head.muscle_wrap),
        skull_wrap=surface(head.skull_wrap),
        bone=np.concatenate([head.bone, bone]),
        wrap_from_skin=(carry @ head.wrap_from_skin).tocsr(),
        skin_from_wrap=hstack([head.skin_from_wrap, csr_matrix((head.skin_from_wrap.shape[0], count))]).tocsr(),
        regions={name: np.concatenate([mask, mask[ends].all(axis=1)]) for name, mask in head.regions.items()},
        muscles=head.muscles,
        skull=head.skull,
        volume=_refined_volume(head, ends),
    )


def _refined_volume(head: LayeredHead, ends: Ints) -> tuple[TetMesh, TetMesh]:
    """Soft tissue and muscle split into eight, the finer wraps' vertices first; `ends` (e, 2) of a wrap's edges."""
    old, n = len(head.vertices), len(head.bone)
    finer, parent = refined_tets(TetMesh(head.vertices, head.tets))
    edges, _ = midpoints(head.tets, EDGES, old)
    keys = edges[:, 0] * old + edges[:, 1]
    wraps = []
    for first in (0, n, 2 * n):
        a, b = (ends + first).T
        wraps += [first + np.arange(n), old + np.searchsorted(keys, a * old + b)]
    first_ones = np.concatenate(wraps)
    order = np.concatenate([first_ones, np.setdiff1d(np.arange(len(finer.vertices)), first_ones)])
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    vertices, tets, soft = finer.vertices[order], place[finer.tets], parent < len(head.soft.tets)
    return TetMesh(vertices, tets[soft]), TetMesh(vertices, tets[~soft])


def _carried(carry: csr_matrix, vertices: Floats) -> Floats:
    return np.asarray(carry @ vertices)
