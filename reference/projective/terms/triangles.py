"""SurfaceStrain: the in-plane strain of triangles, with growth (SoftDECA Eq. 11): energy, gradient, matrix, Hessian.

In the frame of F's singular values s0 >= s1 >= 0, E = w/2 Σ (s_i - r)². Stretches have the eigenvalue w; the pair in
the plane the flip w and the twist w (1 - 2 r/(s0 + s1)); out of the plane there is w (1 - r/s_i) for each, negative
where the skin is compressed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import SurfaceStrain
from ..unknowns.sparsity import add_block
from .local_step import COMPILED, LANES, rows
from .part import Part

# Squared floor of s0 s1. A flat triangle has no one polar decomposition; with the floor its energy is smooth, and
# that of a triangle of sound shape is the same to rounding.
FLOOR = 1e-18
# A block of triangles as it lies in memory: inverse edges, weight, √growth, edges (and then forces), energy.
I00, I01, I10, I11, WEIGHT, SCALE = rows(0, 6)
E00, E01, E10, E11, E20, E21, ENERGY = rows(6, 7)
ROWS = 13
PAIRS = np.array([[a, b] for a in range(3) for b in range(a, 3)])
"""The pairs of a triangle's corners, one block of the Hessian each."""


@njit(**COMPILED)
def _add_triangles(corners, inverse, weight, scale, u, rest, gradient):
    """Add E = w/2 (‖F‖² - 2 r N + 2 r²), r = √growth and N = s0 + s1 = √(‖F‖² + 2 s0 s1), the nuclear norm."""
    w = np.zeros(ROWS * LANES)
    energy = 0.0
    for first in range(0, len(corners), LANES):
        last = min(first + LANES, len(corners))
        for t in range(first, last):
            a, b, c = corners[t]
            k = t - first
            w[I00 + k], w[I01 + k], w[I10 + k] = inverse[t, 0, 0], inverse[t, 0, 1], inverse[t, 1, 0]
            w[I11 + k], w[WEIGHT + k], w[SCALE + k] = inverse[t, 1, 1], weight[t], scale[t]
            w[E00 + k], w[E01 + k] = rest[t, 0, 0] + u[b, 0] - u[a, 0], rest[t, 0, 1] + u[c, 0] - u[a, 0]
            w[E10 + k], w[E11 + k] = rest[t, 1, 0] + u[b, 1] - u[a, 1], rest[t, 1, 1] + u[c, 1] - u[a, 1]
            w[E20 + k], w[E21 + k] = rest[t, 2, 0] + u[b, 2] - u[a, 2], rest[t, 2, 1] + u[c, 2] - u[a, 2]
        _stretch(w)
        for t in range(first, last):
            a, b, c = corners[t]
            k = t - first
            energy += w[ENERGY + k]
            for r in range(3):
                q0, q1 = w[E00 + 2 * r * LANES + k], w[E01 + 2 * r * LANES + k]
                gradient[a, r] -= q0 + q1
                gradient[b, r] += q0
                gradient[c, r] += q1
    return energy


@njit(**COMPILED)
def _stretch(w):
    """Write every lane's energy, and the forces on its second and third corner to E, which holds the edges.

    ∂N/∂F is the polar factor of F; s0 s1 = |f0 × f1| is what the floor acts on.
    """
    for k in range(LANES):
        i00, i01, i10, i11 = w[I00 + k], w[I01 + k], w[I10 + k], w[I11 + k]
        p0, p1 = w[E00 + k], w[E01 + k]
        f00, f01 = p0 * i00 + p1 * i10, p0 * i01 + p1 * i11
        p0, p1 = w[E10 + k], w[E11 + k]
        f10, f11 = p0 * i00 + p1 * i10, p0 * i01 + p1 * i11
        p0, p1 = w[E20 + k], w[E21 + k]
        f20, f21 = p0 * i00 + p1 * i10, p0 * i01 + p1 * i11
        c00 = f00 * f00 + f10 * f10 + f20 * f20
        c11 = f01 * f01 + f11 * f11 + f21 * f21
        c01 = f00 * f01 + f10 * f11 + f20 * f21
        n0, n1, n2 = f10 * f21 - f20 * f11, f20 * f01 - f00 * f21, f00 * f11 - f10 * f01
        area = sqrt(n0 * n0 + n1 * n1 + n2 * n2 + FLOOR)
        norm = sqrt(c00 + c11 + 2.0 * area)
        weight, growth = w[WEIGHT + k], w[SCALE + k]
        # ‖F‖² - 2 r N + 2 r² = (N - r)² - 2 (s0 s1 - r²) - r² has no large terms that cancel near F = r R.
        w[ENERGY + k] = 0.5 * weight * ((norm - 2.0 * growth) * norm - 2.0 * (area - growth * growth))
        # The stress w (F - r Q), with the polar factor Q = (F + F adj(C) / area) / norm, is F times a matrix.
        share = weight * growth / norm
        over = share / area
        m00, m11, m01 = weight - share - over * c11, weight - share - over * c00, over * c01
        h00, h01 = m00 * i00 + m01 * i01, m00 * i10 + m01 * i11
        h10, h11 = m01 * i00 + m11 * i01, m01 * i10 + m11 * i11
        w[E00 + k], w[E01 + k] = f00 * h00 + f01 * h10, f00 * h01 + f01 * h11
        w[E10 + k], w[E11 + k] = f10 * h00 + f11 * h10, f10 * h01 + f11 * h11
        w[E20 + k], w[E21 + k] = f20 * h00 + f21 * h10, f20 * h01 + f21 * h11


def _edges(points: Floats) -> Floats:
    """Return the first two edges as columns, shape (k, 3, 2), of triangles with corners (k, 3, 3)."""
    return (points[:, 1:] - points[:, :1]).transpose(0, 2, 1)


def _inverse(edges: Floats) -> Floats:
    """Invert the edges in an orthonormal frame of their triangle, shape (k, 2, 2)."""
    first = edges[:, :, 0] / np.linalg.norm(edges[:, :, 0], axis=1, keepdims=True)
    normal = np.cross(edges[:, :, 0], edges[:, :, 1])
    second = np.cross(normal / np.linalg.norm(normal, axis=1, keepdims=True), first)
    return np.linalg.inv(np.stack([first, second], axis=1) @ edges)


@dataclass(frozen=True, eq=False)
class Triangles(Part):
    """The triangles of a scene's SurfaceStrain terms; `weights` is stiffness times rest area, `scale` √growth.

    `edges` are the scene's, to which the displacement adds; `inverse` is that of the shape sought.
    """

    corners: Ints
    edges: Floats
    inverse: Floats
    areas: Floats
    weights: Floats
    scale: Floats

    @classmethod
    def from_scene(cls, scene: Scene) -> Triangles | None:
        """Take the triangles of a scene, or None if it names none."""
        terms = scene.of(SurfaceStrain)
        if not sum(len(term.triangles) for term in terms):
            return None
        corners = np.vstack([term.triangles for term in terms])
        edges = _edges(scene.vertices[corners])
        sought = [(scene.vertices if term.rest is None else term.rest)[term.triangles] for term in terms]
        inverse = _inverse(_edges(np.concatenate(sought)))
        areas = np.linalg.norm(np.cross(edges[:, :, 0], edges[:, :, 1]), axis=1) / 2.0
        return cls(corners, edges, inverse, areas, np.ones(0), np.ones(0)).for_scene(scene)

    def for_scene(self, scene: Scene) -> Triangles:
        """Return the same triangles with the stiffness and growth of another scene of the same terms."""
        terms = scene.of(SurfaceStrain)
        stiffness, growth = (
            np.concatenate([np.broadcast_to(getattr(term, name), len(term.triangles)) for term in terms])
            for name in ("stiffness", "growth")
        )
        return replace(self, weights=self.areas * stiffness, scale=np.sqrt(growth))

    def rebuilt(self, scene: Scene) -> Triangles | None:
        same_shape = all(term.rest is None for term in scene.of(SurfaceStrain))
        return self.for_scene(scene) if same_shape else Triangles.from_scene(scene)

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        return total + _add_triangles(self.corners, self.inverse, self.weights, self.scale, u, self.edges, gradient)

    def matrix_entries(self, scene: Scene, volume_share: float) -> tuple[Ints, Ints, Floats]:
        """Return rows, columns and values of Σ w A G Gᵀ, the triangles' share of the PD matrix [mN/mm]."""
        gradients = np.concatenate([-self.inverse.sum(axis=1, keepdims=True), self.inverse], axis=1)
        local = np.einsum("e,eai,ebi->eab", self.weights, gradients, gradients)
        return np.repeat(self.corners, 3, axis=1).ravel(), np.tile(self.corners, (1, 3)).ravel(), local.ravel()

    def elements(self, scene: Scene) -> tuple[Ints, ...]:
        """Return the corners (k, 3)."""
        return (self.corners,)

    def pairs(self, scene: Scene) -> Ints:
        """Return the pairs of corners (k, 2), six per triangle."""
        return self.corners[:, PAIRS].reshape(-1, 2)

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        """Add the Hessian; see `Part`."""
        shape = (self.corners, self.inverse, self.weights, self.scale, self.edges)
        _add_triangle_tangent(*shape, slots.reshape(-1, len(PAIRS)), least, u, blocks)


@njit(**COMPILED)
def _frame(f, U, V):
    """Return the singular values of f (3, 2), with U (3, 3) and V (2, 2) its frames; a flat f gets any normal."""
    a = f[0, 0] ** 2 + f[1, 0] ** 2 + f[2, 0] ** 2
    b = f[0, 1] ** 2 + f[1, 1] ** 2 + f[2, 1] ** 2
    g = f[0, 0] * f[0, 1] + f[1, 0] * f[1, 1] + f[2, 0] * f[2, 1]
    angle = 0.5 * np.arctan2(2.0 * g, a - b)
    c, s = np.cos(angle), np.sin(angle)
    V[0, 0], V[1, 0], V[0, 1], V[1, 1] = c, s, -s, c
    for r in range(3):
        U[r, 0], U[r, 1] = f[r, 0] * c + f[r, 1] * s, f[r, 1] * c - f[r, 0] * s
    s0 = sqrt(U[0, 0] ** 2 + U[1, 0] ** 2 + U[2, 0] ** 2)
    s0 = max(s0, 1e-150)
    for r in range(3):
        U[r, 0] /= s0
    along = U[0, 0] * U[0, 1] + U[1, 0] * U[1, 1] + U[2, 0] * U[2, 1]
    for r in range(3):
        U[r, 1] -= along * U[r, 0]
    s1 = sqrt(U[0, 1] ** 2 + U[1, 1] ** 2 + U[2, 1] ** 2)
    if s1 > 1e-14 * s0:
        for r in range(3):
            U[r, 1] /= s1
    else:
        axis = 0 if abs(U[0, 0]) < 0.9 else 1
        along = U[axis, 0]
        for r in range(3):
            U[r, 1] = (1.0 if r == axis else 0.0) - along * U[r, 0]
        norm = sqrt(U[0, 1] ** 2 + U[1, 1] ** 2 + U[2, 1] ** 2)
        for r in range(3):
            U[r, 1] /= norm
    U[0, 2] = U[1, 0] * U[2, 1] - U[2, 0] * U[1, 1]
    U[1, 2] = U[2, 0] * U[0, 1] - U[0, 0] * U[2, 1]
    U[2, 2] = U[0, 0] * U[1, 1] - U[1, 0] * U[0, 1]
    return s0, max(s1, sqrt(FLOOR) / s0)


@njit(**COMPILED)
def _add_triangle_tangent(corners, inverse, weight, scale, edges, slots, least, u, blocks):
    """Add the triangles' Hessian [mN/mm] at displacement u [mm], shape (n, 3), to blocks (pairs, 3, 3), in place.

    slots (triangles, 6) are the blocks of `PAIRS`; `least` is the share of the weight below which no eigenvalue is
    left, if it is not negative.
    """
    f, U, V, g = np.empty((3, 2)), np.empty((3, 3)), np.empty((2, 2)), np.empty((3, 2))
    M, block = np.empty((3, 3)), np.empty((3, 3))
    for t in range(len(corners)):
        a, b, c = corners[t]
        for r in range(3):
            p0, p1 = edges[t, r, 0] + u[b, r] - u[a, r], edges[t, r, 1] + u[c, r] - u[a, r]
            f[r, 0] = p0 * inverse[t, 0, 0] + p1 * inverse[t, 1, 0]
            f[r, 1] = p0 * inverse[t, 0, 1] + p1 * inverse[t, 1, 1]
        s0, s1 = _frame(f, U, V)
        w, growth = weight[t], scale[t]
        twist, out0, out1 = 1.0 - 2.0 * growth / (s0 + s1), 1.0 - growth / s0, 1.0 - growth / s1
        if least >= 0.0:
            twist, out0, out1 = max(twist, least), max(out0, least), max(out1, least)
        alpha, beta = 0.5 * w * (1.0 + twist), 0.5 * w * (1.0 - twist)
        out0, out1 = w * out0, w * out1
        for i in range(2):
            for j in range(2):
                g[i + 1, j] = V[0, j] * inverse[t, i, 0] + V[1, j] * inverse[t, i, 1]
        for j in range(2):
            g[0, j] = -(g[1, j] + g[2, j])
        number = 0
        for i in range(3):
            for j in range(i, 3):
                M[:] = 0.0
                M[0, 0] = w * g[i, 0] * g[j, 0] + alpha * g[i, 1] * g[j, 1]
                M[1, 1] = w * g[i, 1] * g[j, 1] + alpha * g[i, 0] * g[j, 0]
                M[0, 1], M[1, 0] = beta * g[i, 1] * g[j, 0], beta * g[i, 0] * g[j, 1]
                M[2, 2] = out0 * g[i, 0] * g[j, 0] + out1 * g[i, 1] * g[j, 1]
                for r in range(3):
                    w0 = U[r, 0] * M[0, 0] + U[r, 1] * M[1, 0]
                    w1 = U[r, 0] * M[0, 1] + U[r, 1] * M[1, 1]
                    w2 = U[r, 2] * M[2, 2]
                    for k in range(3):
                        block[r, k] = w0 * U[k, 0] + w1 * U[k, 1] + w2 * U[k, 2]
                add_block(blocks, slots[t, number], block, corners[t, i] < corners[t, j])
                number += 1
