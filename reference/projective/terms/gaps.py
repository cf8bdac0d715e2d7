"""Pairs of vertex and triangle, or of two edges: their distances, and the energy of those that are too near.

A pair (a, b, c, d) is the vertex a and the triangle b c d, or the edges a b and c d. Its distance is that of the
nearest points, so the normal between them follows the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....lhm.base.geometry.triangles import closest_on_triangle
from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Gaps
from ..unknowns.sparsity import add_block
from .part import Part

DIFFERENCE, NEARER = 1e-6, 1e-3
"""[mm], and share of a pair's distance, by which corners are moved at most for a Hessian: a difference of gradients."""
PARALLEL = 1e-3
"""Squared sine between two edges, below which less than all of their energy is taken."""


@dataclass(frozen=True, eq=False)
class Pairs(Part):
    """The pairs of a scene's Gaps, with the stiffness [mN/mm] and offset [mm] of each, (r,); rest (n, 3) [mm]."""

    is_bounded = False

    rest: Floats
    terms: tuple[Gaps, ...]
    amounts: tuple[tuple[Floats, Floats], ...]

    @classmethod
    def from_scene(cls, scene: Scene) -> Pairs | None:
        terms = tuple(scene.of(Gaps))
        amounts = []
        for term in terms:
            stiffness, offset = (np.array(np.broadcast_to(x, len(term.pairs))) for x in (term.stiffness, term.offset))
            amounts.append((stiffness, offset))
        return cls(scene.vertices, terms, tuple(amounts)) if terms else None

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        for term, amounts in zip(self.terms, self.amounts, strict=True):
            energy, forces = _push(self._find_corners(term, u), term.between_edges, *amounts)
            np.subtract.at(gradient, term.pairs, term.spread_forces(forces))
            total += energy
        return total

    def elements(self, scene: Scene) -> tuple[Ints, ...]:
        return tuple(term.pairs for term in self.terms)

    def pairs(self, scene: Scene) -> Ints:
        return np.vstack([term.pairs[:, _find_couples(term.pairs.shape[1])].reshape(-1, 2) for term in self.terms])

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        """Add the Hessian; see `Part`. Where `least` is not negative, no pair has a negative eigenvalue."""
        begin = 0
        for term, amounts in zip(self.terms, self.amounts, strict=True):
            couples = _find_couples(term.pairs.shape[1])
            end = begin + len(term.pairs) * len(couples)
            local = _find_hessians(self._find_corners(term, u), term.between_edges, *amounts)
            if least >= 0.0:
                values, vectors = np.linalg.eigh(local)
                local = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
            local = term.spread_hessians(local)
            _add_blocks(term.pairs, local, couples, slots[begin:end].reshape(-1, len(couples)), blocks)
            begin = end

    def _find_corners(self, term: Gaps, u: Floats) -> Floats:
        return term.find_corners((self.rest + u)[term.pairs])


def _find_couples(count: int) -> Ints:
    """Find the couples (i, j), i <= j, of so many vertices, shape (couples, 2)."""
    return np.stack(np.triu_indices(count), axis=1)


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


@njit(cache=True)
def find_share(corners, slopes):
    """Return the share of its energy that a pair of edges has, corners (4, 3), and write its derivative by these."""
    slopes[:] = 0.0
    u, v = corners[1] - corners[0], corners[3] - corners[2]
    uu, vv, uv = np.sum(u * u), np.sum(v * v), np.sum(u * v)
    part = max(1.0 - uv * uv / (uu * vv), 0.0) / PARALLEL
    if part >= 1.0:
        return 1.0
    slope = -4.0 * (1.0 - part) / PARALLEL * uv / (uu * vv)
    by_u, by_v = slope * (v - uv / uu * u), slope * (u - uv / vv * v)
    slopes[0], slopes[1], slopes[2], slopes[3] = -by_u, by_u, -by_v, by_v
    return part * (2.0 - part)


@njit(cache=True)
def find_shares(corners, between_edges):
    """Find the shares (r,) of pairs with corners (r, 4, 3) [mm], and their derivatives by these, (r, 4, 3)."""
    shares, slopes = np.ones(len(corners)), np.zeros(corners.shape)
    for r in range(len(corners)):
        if between_edges[r]:
            shares[r] = find_share(corners[r], slopes[r])
    return shares, slopes


@njit(cache=True)
def _push_apart(corners, between_edges, stiffness, offset, weights, normal, forces):
    """Return the energy [µJ] of a pair with corners (4, 3), and write the forces [mN] on these; see `terms.Gaps`."""
    forces[:] = 0.0
    distance = measure_pair(corners, between_edges, weights, normal)
    if distance >= offset:
        return 0.0
    if distance == 0.0:
        return np.inf
    energy = 0.5 * stiffness * (offset - distance) ** 2 * offset / distance
    share = 1.0
    if between_edges:
        share = find_share(corners, forces)
        forces *= -energy
    push = 0.5 * share * stiffness * offset * ((offset / distance) ** 2 - 1.0)
    for j in range(4):
        for c in range(3):
            forces[j, c] += push * weights[j] * normal[c]
    return share * energy


@njit(cache=True)
def _push(corners, between_edges, stiffness, offset):
    """Return the energy [µJ] of pairs with corners (r, 4, 3), and the forces [mN] on these."""
    forces, weights, normal = np.empty(corners.shape), np.empty(4), np.empty(3)
    energy = 0.0
    for r in range(len(corners)):
        energy += _push_apart(corners[r], between_edges[r], stiffness[r], offset[r], weights, normal, forces[r])
    return energy, forces


@njit(cache=True)
def _find_hessians(at, between_edges, stiffness, offset):
    """Find the Hessians [mN/mm] of pairs with corners (r, 4, 3), (r, 12, 12), by central differences of gradients."""
    hessians = np.zeros((len(at), 12, 12))
    corners, weights, normal, forces = np.empty((4, 3)), np.empty(4), np.empty(3), np.empty((4, 3))
    for r in range(len(at)):
        corners[:] = at[r]
        distance = measure_pair(corners, between_edges[r], weights, normal)
        if distance >= offset[r]:
            continue
        step = min(DIFFERENCE, NEARER * distance)
        for column in range(12):
            j, c = divmod(column, 3)
            place = corners[j, c]
            for side in (1.0, -1.0):
                corners[j, c] = place + side * step
                _push_apart(corners, between_edges[r], stiffness[r], offset[r], weights, normal, forces)
                for row in range(12):
                    hessians[r, row, column] -= side * forces[row // 3, row % 3] / (2.0 * step)
            corners[j, c] = place
    return 0.5 * (hessians + hessians.transpose(0, 2, 1))


@njit(cache=True)
def _add_blocks(ids, local, couples, slots, blocks):
    """Add Hessians (r, 3 m, 3 m) to blocks (pairs, 3, 3), in place; couples (k, 2) and slots (r, k) of each."""
    block = np.empty((3, 3))
    for r in range(len(ids)):
        for number in range(len(couples)):
            i, j = couples[number]
            block[:] = local[r, 3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
            if i != j and ids[r, i] == ids[r, j]:
                block[:] = block + block.T  # one vertex twice: both sides fall on its own block
            add_block(blocks, slots[r, number], block, ids[r, i] < ids[r, j])
