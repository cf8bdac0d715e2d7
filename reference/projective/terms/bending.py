"""Bending: the cotangent Laplacian of a surface against that of its rest shape, turned along (SoftDECA Eq. 13).

E = Σ k/(2 A) |D|² with D = Σ w e - R B over a vertex' edges e, B = Σ w E over the edges E of the rest shape, and R the
rotation nearest to S = Σ w⁺ e Eᵀ, which depends on positions: as S = R Y with Y symmetric, R turns by ω with
(tr(Y) I - Y) ω = axial(Rᵀ dS - dSᵀ R). R does not minimise E, so the PD matrix need not majorise it.

The exact Hessian is worked out ring after ring, in the frame of S = U diag(s) Vᵀ, where R = 1 and
E = k/(2A) |y - R B|² with y = Σ w e. Along dS = e_i e_jᵀ, R turns by W = κ (e_i e_jᵀ - e_j e_iᵀ), κ = 1/(s_i + s_j),
and Y = RᵀS changes by the symmetric Y' = dS - W Y; along two such, p and q, R changes by (W_p W_q + W_q W_p)/2 + W_pq,
where W_pq Y + Y W_pq = - [(W_p W_q + W_q W_p)/2, Y] - {W_p, Y'_q} - {W_q, Y'_p}.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.sparse import csr_matrix

from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Bending
from ..unknowns.sparsity import add_block
from .local_step import (
    COMPILED,
    D0,
    F00,
    LANES,
    ROWS,
    S0,
    S1,
    S2,
    U00,
    V00,
    decompose,
)
from .part import Part

# Share of Σ w⁺ |E|² below which a ring is so far collapsed that its rotation is held.
FLOOR = 1e-9


@njit(**COMPILED)
def _gather(w, centres, starts, ring, cotangents, edges, sought, u):
    """Put D without its R B, and S, of a block of vertices into the rows D and F."""
    w[D0 : D0 + 3 * LANES] = 0.0
    w[F00 : F00 + 9 * LANES] = 0.0
    for k in range(len(centres)):
        i = centres[k]
        for a in range(starts[k], starts[k + 1]):
            j, weight = ring[a], max(cotangents[a], 0.0)
            for r in range(3):
                e = edges[a, r] + (u[j, r] - u[i, r])
                w[D0 + r * LANES + k] += cotangents[a] * e
                for c in range(3):
                    w[F00 + (3 * r + c) * LANES + k] += weight * e * sought[a, c]


@njit(**COMPILED)
def _turn(w, k, laplacian, least, R, D, z):
    """Write a lane's R, its D, and z with dE = k/A (D · Σ w de - Σ w⁺ de · R (z × E)); return |D|²."""
    s0, s1, s2 = w[S0 + k], w[S1 + k], w[S2 + k]
    stiff = (max(s1 + s2, least), max(s0 + s2, least), max(s0 + s1, least))
    square = 0.0
    for r in range(3):
        D[r] = w[D0 + r * LANES + k]
        for c in range(3):
            R[r, c] = 0.0
            for m in range(3):
                R[r, c] += w[U00 + (3 * r + m) * LANES + k] * w[V00 + (3 * c + m) * LANES + k]
            D[r] -= R[r, c] * laplacian[c]
        square += D[r] * D[r]
    g0 = R[0, 0] * D[0] + R[1, 0] * D[1] + R[2, 0] * D[2]
    g1 = R[0, 1] * D[0] + R[1, 1] * D[1] + R[2, 1] * D[2]
    g2 = R[0, 2] * D[0] + R[1, 2] * D[1] + R[2, 2] * D[2]
    b0, b1, b2 = laplacian
    moment = (b1 * g2 - b2 * g1, b2 * g0 - b0 * g2, b0 * g1 - b1 * g0)
    z[:] = 0.0
    for m in range(3):
        along = 0.0
        for r in range(3):
            along += w[V00 + (3 * r + m) * LANES + k] * moment[r]
        for r in range(3):
            z[r] += w[V00 + (3 * r + m) * LANES + k] * along / stiff[m]
    return square


@njit(**COMPILED)
def _add_bending(centres, starts, ring, cotangents, edges, sought, laplacians, least, weights, u, gradient):
    """Add the gradient at displacement u, both (n, 3), in place; return the energy."""
    w = np.zeros(ROWS * LANES)
    R, D, z = np.empty((3, 3)), np.empty(3), np.empty(3)
    energy = 0.0
    for first in range(0, len(centres), LANES):
        last = min(first + LANES, len(centres))
        _gather(w, centres[first:last], starts[first : last + 1], ring, cotangents, edges, sought, u)
        decompose(w)
        for v in range(first, last):
            energy += 0.5 * weights[v] * _turn(w, v - first, laplacians[v], least[v], R, D, z)
            for a in range(starts[v], starts[v + 1]):
                E0, E1, E2 = sought[a]
                t0, t1, t2 = z[1] * E2 - z[2] * E1, z[2] * E0 - z[0] * E2, z[0] * E1 - z[1] * E0
                for r in range(3):
                    turned = R[r, 0] * t0 + R[r, 1] * t1 + R[r, 2] * t2
                    force = weights[v] * (cotangents[a] * D[r] - max(cotangents[a], 0.0) * turned)
                    gradient[ring[a], r] += force
                    gradient[centres[v], r] -= force
    return energy


@dataclass(frozen=True, eq=False)
class Rings(Part):
    """The inner vertices of all Bending terms with their rings of edges; `weights` is k/A [mN/mm].

    Vertex v has the edges starts[v] to starts[v + 1]: `ring` is their far end, `edges` as the scene has them, `sought`
    as the rest shape has them [mm], `cotangents` their weights. `laplacians` is B [mm].
    The rest shape turns along, which the matrix does not bound.
    """

    is_bounded: ClassVar[bool] = False

    centres: Ints
    starts: Ints
    ring: Ints
    cotangents: Floats
    edges: Floats
    sought: Floats
    laplacians: Floats
    least: Floats
    weights: Floats

    @classmethod
    def from_scene(cls, scene: Scene) -> Rings | None:
        """Find the rings of a scene, or None if no vertex bends."""
        found = [_rings(scene, term) for term in scene.of(Bending) if len(term.triangles)]
        if not sum(len(centres) for centres, *_ in found):
            return None
        centres, sizes, ring, cotangents, sought, weights = (
            np.concatenate(parts) for parts in zip(*found, strict=True)
        )
        starts = np.concatenate([[0], np.cumsum(sizes)])
        edges = scene.vertices[ring] - scene.vertices[np.repeat(centres, sizes)]
        laplacians = np.add.reduceat(cotangents[:, None] * sought, starts[:-1])
        size = np.add.reduceat(np.maximum(cotangents, 0.0) * np.sum(sought**2, axis=1), starts[:-1])
        return cls(centres, starts, ring, cotangents, edges, sought, laplacians, FLOOR * size, weights)

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        """Add the gradient [mN] at displacements u (n, 3) [mm] in place; return `total` and the energy [µJ]."""
        return total + _add_bending(
            self.centres,
            self.starts,
            self.ring,
            self.cotangents,
            self.edges,
            self.sought,
            self.laplacians,
            self.least,
            self.weights,
            u,
            gradient,
        )

    def matrix_entries(self, scene: Scene, volume_share: float) -> tuple[Ints, Ints, Floats]:
        """Return rows, columns and values of Σ k/A l lᵀ, l the Laplacian's rows [mN/mm]: two rings wide."""
        rows = np.repeat(np.arange(len(self.centres)), np.diff(self.starts))
        sums = np.add.reduceat(self.cotangents, self.starts[:-1])
        laplacian = csr_matrix(
            (
                np.concatenate([self.cotangents, -sums]),
                (np.concatenate([rows, np.arange(len(sums))]), np.concatenate([self.ring, self.centres])),
            ),
            shape=(len(sums), len(scene.vertices)),
        )
        share = (laplacian.T @ laplacian.multiply(self.weights[:, None])).tocoo()
        return share.row, share.col, share.data

    def elements(self, scene: Scene) -> tuple[Ints, ...]:
        """Return centres, where rings begin, and far ends."""
        return self.centres, self.starts, self.ring

    def pairs(self, scene: Scene) -> Ints:
        """Return the pairs (k, 2) of each ring's vertices, centre first, each with itself and those after it."""
        pairs = []
        for i, centre in enumerate(self.centres):
            vertices = np.concatenate([[centre], self.ring[self.starts[i] : self.starts[i + 1]]])
            a, b = np.triu_indices(len(vertices))
            pairs.append(np.column_stack([vertices[a], vertices[b]]))
        return np.vstack(pairs)

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        """Add the Hessian; see `Part`. Where `least` is not negative, the rotations R are held."""
        size = np.diff(self.starts) + 1
        first = np.concatenate([[0], np.cumsum(size * (size + 1) // 2)])
        if least >= 0.0:
            _add_bound(self.starts, self.cotangents, self.weights, slots, first, blocks)
            return
        shape = (self.centres, self.starts, self.ring, self.cotangents, self.edges, self.sought, self.laplacians)
        _add_bending_tangent(*shape, self.least, self.weights, slots, first, u, blocks)


def _rings(scene: Scene, term: Bending) -> tuple[Ints, Ints, Ints, Floats, Floats, Floats]:
    """Return centres, sizes of rings, far ends, cotangent weights, rest edges and k/A of one term."""
    rest, n = scene.vertices if term.rest is None else term.rest, len(scene.vertices)
    triangles = term.triangles
    corners = rest[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    starts, ends, halves = [], [], []
    for k in range(3):
        here, there, opposite = k, (k + 1) % 3, (k + 2) % 3
        p, q = corners[:, here] - corners[:, opposite], corners[:, there] - corners[:, opposite]
        halves += [np.sum(p * q, axis=1) / (4.0 * area)] * 2
        starts += [triangles[:, here], triangles[:, there]]
        ends += [triangles[:, there], triangles[:, here]]
    keys, where, count = np.unique(
        np.concatenate(starts) * n + np.concatenate(ends), return_inverse=True, return_counts=True
    )
    weights = np.bincount(where.ravel(), np.concatenate(halves))
    centre, far = keys // n, keys % n
    border = np.zeros(n, dtype=bool)
    border[centre[count == 1]] = True
    inner = ~border[centre]
    centres, sizes = np.unique(centre[inner], return_counts=True)
    thirds = np.repeat(area / 3.0, 3)
    areas = np.bincount(triangles.ravel(), thirds, minlength=n)
    stiffness = np.bincount(
        triangles.ravel(), thirds * np.repeat(np.broadcast_to(term.stiffness, len(area)), 3), minlength=n
    )
    sought = rest[far[inner]] - rest[centre[inner]]
    return centres, sizes, far[inner], weights[inner], sought, stiffness[centres] / areas[centres] ** 2


@njit(**COMPILED)
def _second(s, least, y, B, H):
    """Write the Hessian H (12, 12) of |y - R B|²/2 over y and S, numbered 4 r + 0 for y_r and 4 r + 1 + c for S_rc.

    The second derivative of R along p and q, drawn by y and B, is linear in W_q and in Y'_q: it is <W_q, of_W> less
    <Y'_q, of_Y>, two matrices of p alone.
    """
    sums, by_square, by_mixed = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            sums[i, j] = max(s[i] + s[j], least)
            by_mixed[i, j] = y[i] * B[j] / sums[i, j]
            by_square[i, j] = y[i] * B[j] - by_mixed[i, j] * (s[j] - s[i])
    W, Y = np.zeros((9, 3, 3)), np.zeros((9, 3, 3))
    H[:] = 0.0
    for i in range(3):
        H[4 * i, 4 * i] = 1.0
        for j in range(3):
            p, at = 3 * i + j, 4 * i + 1 + j
            if i == j:
                Y[p, i, i] = 1.0
                continue
            kappa = 1.0 / sums[i, j]
            W[p, i, j], W[p, j, i] = kappa, -kappa
            Y[p, i, j] = Y[p, j, i] = kappa * s[i]
            H[4 * i, at] -= kappa * B[j]
            H[4 * j, at] += kappa * B[i]
            H[at, 4 * i], H[at, 4 * j] = H[4 * i, at], H[4 * j, at]
    of_W, of_Y = np.empty((3, 3)), np.empty((3, 3))
    for p in range(9):
        for i in range(3):
            for j in range(3):
                square, mixed, turned = 0.0, 0.0, 0.0
                for r in range(3):
                    square += W[p, r, i] * by_square[r, j] + by_square[i, r] * W[p, j, r]
                    mixed += Y[p, r, i] * by_mixed[r, j] + by_mixed[i, r] * Y[p, j, r]
                    turned += W[p, r, i] * by_mixed[r, j] + by_mixed[i, r] * W[p, j, r]
                of_W[i, j], of_Y[i, j] = 0.5 * square - mixed, turned
        for q in range(p, 9):
            value = 0.0
            for i in range(3):
                for j in range(3):
                    value += of_W[i, j] * W[q, i, j] - of_Y[i, j] * Y[q, i, j]
            a, b = 4 * (p // 3) + 1 + p % 3, 4 * (q // 3) + 1 + q % 3
            H[a, b] = H[b, a] = -value


@njit(**COMPILED)
def _turn_back(H, U, scale, turned):
    """Write H (12, 12) with y and S turned by U, times a number, to `turned`."""
    for alpha in range(4):
        for beta in range(4):
            for r in range(3):
                for t in range(3):
                    total = 0.0
                    for i in range(3):
                        for j in range(3):
                            total += U[r, i] * H[4 * i + alpha, 4 * j + beta] * U[t, j]
                    turned[4 * r + alpha, 4 * t + beta] = scale * total


@njit(**COMPILED)
def _ring(H, v, K):
    """Write the blocks K (m, m, 3, 3), a up to b, between a ring's vertices whose parts in (y, S) are v (m, 4)."""
    half = np.empty((12, 3))
    for b in range(len(v)):
        for at in range(12):
            for t in range(3):
                total = 0.0
                for beta in range(4):
                    total += H[at, 4 * t + beta] * v[b, beta]
                half[at, t] = total
        for a in range(b + 1):
            for r in range(3):
                for t in range(3):
                    total = 0.0
                    for alpha in range(4):
                        total += v[a, alpha] * half[4 * r + alpha, t]
                    K[a, b, r, t] = total


@njit(**COMPILED)
def _add_bending_tangent(
    centres, starts, ring, cotangents, edges, sought, laplacians, least, weights, slots, first, u, blocks
):
    """Add the rings' Hessian [mN/mm] at displacement u [mm], shape (n, 3), to blocks (pairs, 3, 3), in place.

    slots from first[v] on are the blocks of ring v: of its vertices, the centre before the ring, each with itself and
    those after it.
    """
    w = np.zeros(ROWS * LANES)
    U, V, s, y, B = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    H, turned = np.empty((12, 12)), np.empty((12, 12))
    for begin in range(0, len(centres), LANES):
        end = min(begin + LANES, len(centres))
        _gather(w, centres[begin:end], starts[begin : end + 1], ring, cotangents, edges, sought, u)
        decompose(w)
        for i in range(begin, end):
            k = i - begin
            for r in range(3):
                s[r] = w[S0 + r * LANES + k]
                for c in range(3):
                    U[r, c], V[r, c] = w[U00 + (3 * r + c) * LANES + k], w[V00 + (3 * r + c) * LANES + k]
            y[:], B[:] = 0.0, 0.0
            for r in range(3):
                for c in range(3):
                    y[c] += U[r, c] * w[D0 + r * LANES + k]
                    B[c] += V[r, c] * laplacians[i, r]
            _second(s, least[i], y, B, H)
            m = starts[i + 1] - starts[i] + 1
            v = np.zeros((m, 4))
            for a in range(1, m):
                at = starts[i] + a - 1
                v[a, 0] = cotangents[at]
                for c in range(3):
                    for r in range(3):
                        v[a, 1 + c] += max(cotangents[at], 0.0) * V[r, c] * sought[at, r]
                v[0] -= v[a]
            K = np.empty((m, m, 3, 3))
            _turn_back(H, U, weights[i], turned)
            _ring(turned, v, K)
            at = first[i]
            for a in range(m):
                here = centres[i] if a == 0 else ring[starts[i] + a - 1]
                for b in range(a, m):
                    there = centres[i] if b == 0 else ring[starts[i] + b - 1]
                    add_block(blocks, slots[at], K[a, b], here < there)
                    at += 1


@njit(**COMPILED)
def _add_bound(starts, cotangents, weights, slots, first, blocks):
    """Add Σ k/A l lᵀ, l the Laplacian's rows: the Hessian with R held, which has no negative eigenvalue."""
    for i in range(len(weights)):
        m = starts[i + 1] - starts[i] + 1
        total = 0.0
        for at in range(starts[i], starts[i + 1]):
            total += cotangents[at]
        slot = first[i]
        for a in range(m):
            la = -total if a == 0 else cotangents[starts[i] + a - 1]
            for b in range(a, m):
                lb = -total if b == 0 else cotangents[starts[i] + b - 1]
                for r in range(3):
                    blocks[slots[slot], r, r] += weights[i] * la * lb
                slot += 1
