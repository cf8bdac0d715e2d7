"""Closed surfaces of scalar fields on a grid: surface nets."""

from __future__ import annotations

import numpy as np

from ..mesh import Floats, Ints, Surface

_AXES = ((0, 1, 2), (1, 2, 0), (2, 0, 1))


def zero_surface(field: Floats, origin: Floats, spacing: float) -> Surface:
    """The closed surface around where `field` (i, j, k) is negative, normals outward; empty if it nowhere is.

    Point (a, b, c) of the grid lies at origin + spacing (a, b, c) [mm]. Every cell with both signs gets one vertex, the
    mean of its edges' zeros; every edge with both signs gets a quad of its four cells (surface nets, Gibson 1998).
    Where cells would touch at an edge or corner only, points change to negative, so the result is a 2-manifold.
    """
    values = np.pad(field, 1, constant_values=np.inf)
    inside = _well_composed(values < 0)
    # What changed sign lies just inside; what is infinite, or far from zero, far outside.
    depth = np.where(inside, np.minimum(values, -1e-3 * spacing), np.maximum(values, 1e-3 * spacing))
    depth = np.clip(depth, -4 * spacing, 4 * spacing)
    total, count = np.zeros((*np.subtract(inside.shape, 1), 3)), np.zeros(np.subtract(inside.shape, 1))
    for axis, u, v in _AXES:
        start = np.argwhere(_edges(inside, axis)[0])
        step = np.eye(3, dtype=np.int64)[axis]
        a, b = depth[tuple(start.T)], depth[tuple((start + step).T)]
        zero = start + (a / (a - b))[:, None] * step
        for cell in _around(start, u, v):
            np.add.at(total, tuple(cell.T), zero)
            np.add.at(count, tuple(cell.T), 1.0)
    used = count > 0
    number = np.cumsum(used.ravel()).reshape(used.shape) - 1
    vertices = origin + spacing * (total[used] / count[used][:, None] - 1.0)
    quads = []
    for axis, u, v in _AXES:
        mixed, outward = _edges(inside, axis)
        start = np.argwhere(mixed)
        ring = np.stack([number[tuple(cell.T)] for cell in _around(start, u, v)], axis=1)
        quads.append(np.where(outward[tuple(start.T)][:, None], ring, ring[:, ::-1]))
    ring = np.vstack(quads)
    return Surface(vertices, _split(vertices, ring))


def _edges(inside, axis: int):
    """Masks over the edges along an axis: both signs, and negative at the start."""
    start = np.take(inside, range(inside.shape[axis] - 1), axis)
    end = np.take(inside, range(1, inside.shape[axis]), axis)
    return start != end, start


def _around(start: Ints, u: int, v: int) -> list[Ints]:
    """The four cells around edges, counter-clockwise as seen from the edge's end."""
    eu, ev = np.eye(3, dtype=np.int64)[[u, v]]
    return [start - eu - ev, start - ev, start, start - eu]


def _split(x: Floats, quads: Ints) -> Ints:
    """Two triangles per quad, along its shorter diagonal."""
    a, b, c, d = quads.T
    first = np.linalg.norm(x[a] - x[c], axis=1) <= np.linalg.norm(x[b] - x[d], axis=1)
    one = np.where(first[:, None], np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    two = np.where(first[:, None], np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    return np.vstack([one, two])


def _well_composed(inside):
    """Points added until none of them meet at an edge or corner only: the surface between is then a manifold.

    Latecki, 3D well-composed pictures, Graph. Models Image Process. 59 (1997).
    """
    inside = inside.copy()
    while True:
        before = inside.sum()
        for axis in range(3):
            x = np.moveaxis(inside, axis, 0)
            a, b, c, d = x[:, :-1, :-1], x[:, 1:, 1:], x[:, :-1, 1:], x[:, 1:, :-1]
            add = a & b & ~c & ~d
            c |= add
            add = c & d & ~a & ~b
            a |= add
        corners = [
            (
                inside[i : inside.shape[0] - 1 + i, j : inside.shape[1] - 1 + j, k : inside.shape[2] - 1 + k],
                inside[1 - i : inside.shape[0] - i, 1 - j : inside.shape[1] - j, 1 - k : inside.shape[2] - k],
            )
            for i, j, k in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
        ]
        count = sum(a.astype(np.int8) + b for a, b in corners)
        for pair, (a, b) in enumerate(corners):
            touching, bare = (count == 2) & a & b, (count == 6) & ~a & ~b
            a |= bare
            corners[(pair + 1) % 4][0][touching] = True
        if inside.sum() == before:
            return inside
