"""Tets between wraps that share a triangulation (SoftDECA 3.1.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..base.errors import InputError
from ..base.geometry.tets import untangle
from ..base.mesh import Floats, Ints, TetMesh

MOST = 32
"""Sub-layers of one gap: of the finest template's some 4 million tets, a gigabyte of them."""
SMALLEST = 0.1
"""Least volume of a sub-layer's tet, over an even share of its prism's smallest tet."""


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


def stack_wraps(wraps: Sequence[Floats], counts: Sequence[int]) -> Floats:
    """Stack wraps (n, 3) and evenly spaced vertices between them, from outside to inside; see `sub_layers`."""
    stack = [wraps[0]]
    for outer, inner, count in zip(wraps[:-1], wraps[1:], counts, strict=True):
        stack += [outer + (k / count) * (inner - outer) for k in range(1, count)] + [inner]
    return np.vstack(stack)


def sub_layers(wraps: Sequence[Floats], triangles: Ints, counts: Sequence[int]) -> tuple[TetMesh, ...]:
    """Make one tet mesh per gap between consecutive wraps, gap k split evenly into counts[k] layers of prisms.

    `wraps`: arrays (n, 3) [mm] from the outermost to the innermost over `triangles` (m, 3). The meshes share their
    vertices: the wraps and those between them, stacked from outside to inside. With counts of one they are a
    head's `soft` and `muscle`. Between twisted prisms' wraps, vertices are moved off their even places until all tets
    are upright. Raises InputError for counts outside 1 to 32, MeshError for wraps whose prisms have an inverted tet,
    and where no such places are found.
    """
    whole = len(counts) == len(wraps) - 1 and all(isinstance(count, (int, np.integer)) for count in counts)
    if not whole or not all(1 <= count <= MOST for count in counts):
        raise InputError(f"sub-layers {tuple(counts)}: expected {len(wraps) - 1} counts from 1 to {MOST}")
    n, vertices = len(wraps[0]), stack_wraps(wraps, counts)
    firsts = np.concatenate([[0], np.cumsum(counts)])
    if max(counts) > 1:
        vertices = _upright(sub_layers(wraps, triangles, [1] * len(counts)), vertices, triangles, counts)
    return tuple(
        TetMesh(vertices, np.vstack([prism_tets(triangles, k * n, (k + 1) * n) for k in range(first, last)]))
        for first, last in zip(firsts[:-1], firsts[1:], strict=True)
    )


def _upright(whole: Sequence[TetMesh], vertices: Floats, triangles: Ints, counts: Sequence[int]) -> Floats:
    """The stacked vertices moved where a sub-layer would have an inverted or tiny tet; the wraps' stay."""
    n = len(vertices) // (sum(counts) + 1)
    tets = np.vstack([prism_tets(triangles, k * n, (k + 1) * n) for k in range(sum(counts))])
    shares = [mesh.volumes.reshape(-1, 3).min(axis=1) / count for mesh, count in zip(whole, counts, strict=True)]
    least = np.concatenate([np.tile(np.repeat(share, 3), count) for share, count in zip(shares, counts, strict=True)])
    free = np.ones(len(vertices), dtype=bool)
    for first in np.concatenate([[0], np.cumsum(counts)]):
        free[first * n : (first + 1) * n] = False
    return untangle(vertices, tets, free, SMALLEST * least)
