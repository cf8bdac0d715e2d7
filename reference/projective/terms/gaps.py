"""Pairs of vertex and triangle, or of two edges: their distances, and the energy of those that are too near.

A pair (a, b, c, d) is the vertex a and the triangle b c d, or the edges a b and c d. Its distance is that of the
nearest points, so the normal between them follows the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ....lhm.base.geometry.triangles import closest_on_triangle
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Gaps
from ..unknowns.sparsity import add_block
from .lanes import COMPILED
from .part import Part

CORNERS = tuple((i, j) for i in range(4) for j in range(i, 4))
DIFFERENCE = 1e-6
"""[mm] by which corners are moved for a Hessian, the difference of two gradients."""


@dataclass(frozen=True, eq=False)
class Pairs(Part):
    """The pairs (r, 4) of a scene's Gaps, their stiffness [mN/mm] and offset [mm], both (r,); rest (n, 3) [mm]."""

    is_bounded = False

    rest: Floats
    ids: Ints
    between_edges: np.ndarray
    stiffness: Floats
    offset: Floats

    @classmethod
    def from_scene(cls, scene: Scene) -> Pairs | None:
        """See Part."""
        terms = scene.of(Gaps)
        if not terms:
            return None
        amounts = (
            np.concatenate([np.broadcast_to(getattr(term, name), len(term.pairs)) for term in terms])
            for name in ("stiffness", "offset")
        )
        ids = np.concatenate([term.pairs for term in terms])
        return cls(scene.vertices, ids, np.concatenate([term.between_edges for term in terms]), *amounts)

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        """See Part."""
        return total + _add_pairs(self.rest + u, self.ids, self.between_edges, self.stiffness, self.offset, gradient)

    def elements(self, scene: Scene) -> tuple[Ints, ...]:
        """See Part."""
        return (self.ids,)

    def pairs(self, scene: Scene) -> Ints:
        """See Part."""
        return self.ids[:, CORNERS].reshape(-1, 2)

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        """See Part."""
        if not len(self.ids):
            return
        local = _find_hessians(self.rest + u, self.ids, self.between_edges, self.stiffness, self.offset)
        if least >= 0.0:
            values, vectors = np.linalg.eigh(local)
            local = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
        _add_blocks(self.ids, local, slots.reshape(-1, len(CORNERS)), blocks)


@njit(cache=True)
def closest_between_edges(p0, p1, q0, q1):
    """Return where along two edges, from 0 to 1, their nearest points lie (Ericson, Real-Time Collision Detection)."""
    a = e = f = c = b = 0.0
    for k in range(3):
        u, v, r = p1[k] - p0[k], q1[k] - q0[k], p0[k] - q0[k]
        a += u * u
        e += v * v
        f += v * r
        c += u * r
        b += u * v
    det = a * e - b * b
    s = min(max((b * f - c * e) / det, 0.0), 1.0) if det > 1e-12 * a * e else 0.0
    t = (b * s + f) / e
    if t < 0.0:
        return min(max(-c / a, 0.0), 1.0), 0.0
    if t > 1.0:
        return min(max((b - c) / a, 0.0), 1.0), 1.0
    return s, t


@njit(cache=True)
def measure_pair(corners, between_edges, weights, normal):
    """Return the distance [mm] of a pair with corners (4, 3); write the nearest points' weights (4,) and the normal.

    The gap is Σ weight_j x_j, from the second to the first; the normal is its direction.
    """
    if between_edges:
        s, t = closest_between_edges(corners[0], corners[1], corners[2], corners[3])
        weights[0], weights[1], weights[2], weights[3] = 1.0 - s, s, t - 1.0, -t
    else:
        u, v, w, _ = closest_on_triangle(corners[0], corners[1:])
        weights[0], weights[1], weights[2], weights[3] = 1.0, -u, -v, -w
    squared = 0.0
    for c in range(3):
        normal[c] = 0.0
        for j in range(4):
            normal[c] += weights[j] * corners[j, c]
        squared += normal[c] * normal[c]
    distance = np.sqrt(squared)
    for c in range(3):
        normal[c] /= max(distance, 1e-12)
    return distance


@njit(**COMPILED)
def _add_pairs(x, ids, between_edges, stiffness, offset, gradient):
    """Add the pairs' gradient in place; return their energy."""
    corners, weights, normal = np.empty((4, 3)), np.empty(4), np.empty(3)
    energy = 0.0
    for r in range(len(ids)):
        for j in range(4):
            corners[j] = x[ids[r, j]]
        depth = offset[r] - measure_pair(corners, between_edges[r], weights, normal)
        if depth > 0.0:
            energy += 0.5 * stiffness[r] * depth * depth
            for j in range(4):
                for c in range(3):
                    gradient[ids[r, j], c] -= stiffness[r] * depth * weights[j] * normal[c]
    return energy


@njit(cache=True)
def _find_hessians(x, ids, between_edges, stiffness, offset):
    """Find the pairs' Hessians [mN/mm], shape (r, 12, 12), by central differences of their gradients."""
    hessians = np.zeros((len(ids), 12, 12))
    corners, weights, normal = np.empty((4, 3)), np.empty(4), np.empty(3)
    for r in range(len(ids)):
        for j in range(4):
            corners[j] = x[ids[r, j]]
        if measure_pair(corners, between_edges[r], weights, normal) >= offset[r]:
            continue
        for column in range(12):
            j, c = divmod(column, 3)
            place = corners[j, c]
            for side in (1.0, -1.0):
                corners[j, c] = place + side * DIFFERENCE
                depth = offset[r] - measure_pair(corners, between_edges[r], weights, normal)
                for row in range(12):
                    force = stiffness[r] * max(depth, 0.0) * weights[row // 3] * normal[row % 3]
                    hessians[r, row, column] -= side * force / (2.0 * DIFFERENCE)
            corners[j, c] = place
    return 0.5 * (hessians + hessians.transpose(0, 2, 1))


@njit(cache=True)
def _add_blocks(ids, local, slots, blocks):
    """Add Hessians (r, 12, 12) to blocks (pairs, 3, 3), in place."""
    block = np.empty((3, 3))
    for r in range(len(ids)):
        for number in range(len(CORNERS)):
            i, j = CORNERS[number]
            block[:] = local[r, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
            add_block(blocks, slots[r, number], block, ids[r, i] < ids[r, j])
