"""Strain and Volume on tets: energy and gradient by a fused local step, matrix, and exact Hessian (SoftDECA Eq. 10).

E = Σ w/2 ‖F - p(F)‖² has the exact gradient Σ w (F - p) : ∂F/∂x, since p minimises the distance (but for the jumps of
Strain's indicator).

With F = U diag(s) Vᵀ and principal stresses p, dP/dF has a 3x3 block on the stretches and, per pair (i, j), a twist
(p_i + p_j)/(s_i + s_j) and a flip (p_i - p_j)/(s_i - s_j) (Smith, de Goes, Kim 2019, "Analytic Eigensystems for
Isotropic Distortion Energies", Section 4). Volume's nearest stretches have t_i (t_i - s_i) = m, so with
q_i = 1/(t_i² + m) its block, flip and twist are rational in t and m and nothing cancels where stretches are equal.
Pairs are ordered (0, 1), (0, 2), (1, 2); pairs of a tet's corners as `PAIRS`.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numba import njit

from ...lhm.base.mesh import Floats, Ints
from ..scene import Scene
from ..terms import Strain, Volume
from .part import Part
from .projections import (
    ACTIVE,
    COMPILED,
    D0,
    D1,
    D2,
    ENERGY,
    F00,
    F01,
    F02,
    F10,
    F11,
    F12,
    F20,
    F21,
    F22,
    G00,
    G01,
    G02,
    G10,
    G11,
    G12,
    G20,
    G21,
    G22,
    HIGH,
    LANES,
    LOW,
    PARAMETERS,
    ROWS,
    S0,
    S1,
    S2,
    STRAIN,
    TARGET,
    U00,
    U01,
    U02,
    U10,
    U11,
    U12,
    U20,
    U21,
    U22,
    V00,
    V01,
    V02,
    V10,
    V11,
    V12,
    V20,
    V21,
    V22,
    VOLUME,
    decompose,
    project_volume,
    settle_doubts,
)
from .sparsity import add_block

ALWAYS = -1.0
"""Below any largest stretch."""
WIDE = 2.0
"""A Strain whose limit is above that hardly ever acts."""
PAIRS = np.array([[a, b] for a in range(4) for b in range(a, 4)])
"""The pairs of a tet's corners, one block of the Hessian each."""
SMALLEST = 1e-9
"""Where s_i + s_j is less, the nearest rotation is not unique and the twist not finite: it is held there."""


@dataclass(frozen=True, eq=False)
class TetBlocks(Part):
    """Parameters and corners in the layout of `projections`, and which rows each Strain and Volume of the scene has."""

    corners: np.ndarray
    parameters: Floats
    has_volume: np.ndarray
    rows_of: tuple[Ints, ...]
    tets: Ints
    threads: int = 1

    @classmethod
    def from_scene(cls, scene: Scene) -> TetBlocks | None:
        """Build the blocks of a scene, or None if it has no tet with a stiffness."""
        tets, entries = _pair_up(scene)
        if not len(tets):
            return None
        blocks = -(-len(tets) // LANES)
        parameters = np.zeros((blocks, PARAMETERS, LANES))
        parameters[:, [LOW // LANES, HIGH // LANES, TARGET // LANES]] = 1.0
        parameters[:, ACTIVE // LANES] = ALWAYS
        corners = np.zeros((blocks, 4, LANES), dtype=np.uint32)
        every = np.arange(len(tets))
        inverse, _ = shape_gradients(scene, tets)
        for row in range(9):
            _spread(inverse[:, row // 3, row % 3], LANES * row, every, parameters)
        for corner in range(4):
            _spread(scene.tets[tets, corner], LANES * corner, every, corners)
        none = np.zeros(blocks, dtype=bool)
        return cls(corners, parameters, none, tuple(rows for _, rows in entries), tets).for_scene(scene)

    def for_scene(self, scene: Scene) -> TetBlocks:
        """Return the same blocks with the numbers, one or one per tet, of another scene of the same terms."""
        parameters = self.parameters.copy()
        for term, rows in zip(scene.of(Strain) + scene.of(Volume), self.rows_of, strict=True):
            stiffness = term.stiffness * scene.volumes[self.tets[rows]]
            _spread(stiffness, STRAIN if isinstance(term, Strain) else VOLUME, rows, parameters)
            if isinstance(term, Strain) and term.rule == "indicator":
                _spread(term.limit, ACTIVE, rows, parameters)
            elif isinstance(term, Strain):
                size = np.cbrt(term.growth)
                _spread(size / term.limit, LOW, rows, parameters)
                _spread(size * term.limit, HIGH, rows, parameters)
            else:
                _spread(term.target, TARGET, rows, parameters)
        has_volume = (parameters[:, VOLUME // LANES] > 0).any(axis=1)
        return replace(self, parameters=parameters, has_volume=has_volume)

    def rebuilt(self, scene: Scene) -> TetBlocks:
        """See Part."""
        return self.for_scene(scene)

    def on_threads(self, threads: int) -> TetBlocks:
        """See Part."""
        return replace(self, threads=threads)

    def separate(self) -> TetBlocks:
        """Return the same rows over vertices of their own: 4 r to 4 r + 3 are the corners of row r."""
        corners = np.zeros_like(self.corners)
        every = np.arange(len(self.tets))
        for corner in range(4):
            _spread(4 * every + corner, LANES * corner, every, corners)
        return replace(self, corners=corners, threads=1)

    def untangling(self, volume_share: float) -> TetBlocks:
        """Move a share of Volume's weight to Strain with limit 1, and leave the rest out.

        A Strain of wide limit is left with the share that the matrix has of it.
        """
        parameters = self.parameters.copy()
        parameters[:, STRAIN // LANES] *= _share(parameters, volume_share)
        parameters[:, STRAIN // LANES] += volume_share * parameters[:, VOLUME // LANES]
        parameters[:, VOLUME // LANES] = 0.0
        size = np.sqrt(parameters[:, LOW // LANES] * parameters[:, HIGH // LANES])
        parameters[:, LOW // LANES] = parameters[:, HIGH // LANES] = size
        parameters[:, ACTIVE // LANES] = ALWAYS
        return replace(self, parameters=parameters, has_volume=np.zeros_like(self.has_volume))

    def add_to(self, u: Floats, gradient: Floats, total: float = 0.0) -> float:
        """See Part.

        Threads share the blocks evenly and add up in order: the same bits each time for the same number of threads.
        """
        blocks = self.parameters.reshape(len(self.parameters), -1), self.corners.reshape(len(self.corners), -1)
        if self.threads == 1:
            return total + add_tets(*blocks, self.has_volume, u, gradient)

        def share(first: int, last: int) -> tuple[float, Floats]:
            own = np.zeros_like(gradient)
            return add_tets(*(part[first:last] for part in blocks), self.has_volume[first:last], u, own), own

        bounds = np.linspace(0, len(self.parameters), self.threads + 1).astype(int)
        mine = 0.0
        for energy, own in _workers(self.threads).map(share, bounds[:-1], bounds[1:]):
            mine += energy
            gradient += own
        return total + mine

    def matrix_entries(self, scene: Scene, volume_share: float) -> tuple[Ints, Ints, Floats]:
        """Return rows, columns and values of Σ w V G Gᵀ, the tets' part of the PD matrix [mN/mm]: see `Part`."""
        strain, volume = (self.parameters[:, row // LANES].ravel()[: len(self.tets)] for row in (STRAIN, VOLUME))
        shares = _share(self.parameters, volume_share).ravel()[: len(self.tets)]
        _, gradients = shape_gradients(scene, self.tets)
        local = np.einsum("e,eai,ebi->eab", shares * strain + volume_share * volume, gradients, gradients)
        corners = scene.tets[self.tets]
        return np.repeat(corners, 4, axis=1).ravel(), np.tile(corners, (1, 4)).ravel(), local.ravel()

    def elements(self, scene: Scene) -> tuple[Ints, ...]:
        """Return the corners (k, 4) of all rows."""
        return (scene.tets[self.tets],)

    def pairs(self, scene: Scene) -> Ints:
        """Return the pairs of corners (k, 2), ten per row."""
        return scene.tets[self.tets][:, PAIRS].reshape(-1, 2)

    def add_tangent(self, slots: Ints, least: float, u: Floats, blocks: Floats):
        """Add the Hessian; see `Part`. Of Strain's weight no eigenvalue of dP/dF is below the share `least`."""
        parameters, corners = (a.reshape(len(a), -1) for a in (self.parameters, self.corners))
        slots = slots.reshape(-1, len(PAIRS))
        add_tet_tangent(parameters, corners, self.has_volume, len(self.tets), slots, least, u, blocks)


@cache
def _workers(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads)


def shape_gradients(scene: Scene, tets: Ints) -> tuple[Floats, Floats]:
    """Return Dm_inv [1/mm] of tets, shape (k, 3, 3), and the gradients G of their shape functions, (k, 4, 3)."""
    corners = scene.vertices[scene.tets[tets]]
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    inverse = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)  # far faster than linalg.inv
    inverse /= np.sum(a * inverse[:, 0], axis=1)[:, None, None]
    return inverse, np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)


def _pair_up(scene: Scene) -> tuple[Ints, list[tuple[Strain | Volume, Ints]]]:
    """Make one row per tet, or one per Strain or Volume term of it: the rows' tets, and each term's rows.

    The k-th Strain and the k-th Volume of a tet share a row, for they share F and its decomposition.
    """
    entries: list[tuple[Strain | Volume, Ints]] = []
    for kind in (Strain, Volume):
        count = np.zeros(len(scene.tets), dtype=np.int64)
        for term in scene.of(kind):
            tets = scene.tets_of(term)
            entries.append((term, tets + len(scene.tets) * count[tets]))
            count[tets] += 1
    keys = [key for _, key in entries]
    rows = np.unique(np.concatenate(keys)) if keys else np.zeros(0, dtype=np.int64)
    return rows % max(len(scene.tets), 1), [(term, np.searchsorted(rows, key)) for term, key in entries]


def _spread(values, row: int, rows: Ints, blocks: np.ndarray):
    """Write one value per row of `_pair_up` at the offset `row` of the blocks."""
    blocks[rows // LANES, row // LANES, rows % LANES] = values


def _share(parameters: Floats, volume_share: float) -> Floats:
    """Return the share of each row's Strain that the matrix has, (blocks, LANES): all, or little where it rarely acts.

    On eight shapes of two heads L-BFGS took 532, 457, 434 and 460 iterations with shares of 0.3, 0.15, 0.08 and 0.04.
    """
    return np.where(parameters[:, HIGH // LANES] > WIDE, volume_share**2, 1.0)


@njit(**COMPILED)
def gather(w, parameters, corners, u):
    """Copy a block's parameters, and put the edges of the displacement u into F: row r, column j is u_j - u_0."""
    for i in range(PARAMETERS * LANES):
        w[i] = parameters[i]
    for k in range(LANES):
        a, b, c, d = corners[k], corners[LANES + k], corners[2 * LANES + k], corners[3 * LANES + k]
        w[F00 + k], w[F01 + k], w[F02 + k] = u[b, 0] - u[a, 0], u[c, 0] - u[a, 0], u[d, 0] - u[a, 0]
        w[F10 + k], w[F11 + k], w[F12 + k] = u[b, 1] - u[a, 1], u[c, 1] - u[a, 1], u[d, 1] - u[a, 1]
        w[F20 + k], w[F21 + k], w[F22 + k] = u[b, 2] - u[a, 2], u[c, 2] - u[a, 2], u[d, 2] - u[a, 2]


@njit(**COMPILED)
def deformation_gradient(w):
    """Compute F = I + Du Dm_inv: from displacements, for differences of positions far from the origin lose digits."""
    for k in range(LANES):
        g00, g01, g02 = w[G00 + k], w[G01 + k], w[G02 + k]
        g10, g11, g12 = w[G10 + k], w[G11 + k], w[G12 + k]
        g20, g21, g22 = w[G20 + k], w[G21 + k], w[G22 + k]
        a, b, c = w[F00 + k], w[F01 + k], w[F02 + k]
        w[F00 + k] = 1.0 + (a * g00 + b * g10 + c * g20)
        w[F01 + k], w[F02 + k] = a * g01 + b * g11 + c * g21, a * g02 + b * g12 + c * g22
        a, b, c = w[F10 + k], w[F11 + k], w[F12 + k]
        w[F11 + k] = 1.0 + (a * g01 + b * g11 + c * g21)
        w[F10 + k], w[F12 + k] = a * g00 + b * g10 + c * g20, a * g02 + b * g12 + c * g22
        a, b, c = w[F20 + k], w[F21 + k], w[F22 + k]
        w[F22 + k] = 1.0 + (a * g02 + b * g12 + c * g22)
        w[F20 + k], w[F21 + k] = a * g00 + b * g10 + c * g20, a * g01 + b * g11 + c * g21


@njit(**COMPILED)
def _is_slack(w):
    """Whether no lane's Strain acts, told by bounds of the stretches from F alone, without its decomposition.

    With I = |F|² and J = det F > 0: the largest stretch is at most √I, the smallest at least 2 J / I.
    """
    acting = 0
    for k in range(LANES):
        a, b, c = w[F00 + k], w[F01 + k], w[F02 + k]
        d, e, f = w[F10 + k], w[F11 + k], w[F12 + k]
        g, h, i = w[F20 + k], w[F21 + k], w[F22 + k]
        squares = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i
        j = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        high = w[HIGH + k]
        slack = squares <= high * high and 2.0 * j >= w[LOW + k] * squares
        acting += 0 if slack or w[STRAIN + k] == 0.0 else 1
    return acting == 0


@njit(**COMPILED)
def _add_strain(w):
    """Turn D, the volume's s - t, into the principal stresses of both terms; and their energy."""
    for k in range(LANES):
        low, high, volume = w[LOW + k], w[HIGH + k], w[VOLUME + k]
        s0, s1, s2 = w[S0 + k], w[S1 + k], w[S2 + k]
        strain = w[STRAIN + k] if s0 > w[ACTIVE + k] else 0.0
        a, b, c = s0 - min(max(s0, low), high), s1 - min(max(s1, low), high), s2 - min(max(s2, low), high)
        d, e, f = w[D0 + k], w[D1 + k], w[D2 + k]
        w[ENERGY + k] = 0.5 * (strain * (a * a + b * b + c * c) + volume * (d * d + e * e + f * f))
        w[D0 + k], w[D1 + k], w[D2 + k] = strain * a + volume * d, strain * b + volume * e, strain * c + volume * f


@njit(**COMPILED)
def _forces(w):
    """Write P = U diag(D) Vᵀ and the nodal derivatives P Dm_invᵀ to F: row r, column j belongs to vertex j."""
    for k in range(LANES):
        d0, d1, d2 = w[D0 + k], w[D1 + k], w[D2 + k]
        v00, v01, v02 = w[V00 + k] * d0, w[V01 + k] * d1, w[V02 + k] * d2
        v10, v11, v12 = w[V10 + k] * d0, w[V11 + k] * d1, w[V12 + k] * d2
        v20, v21, v22 = w[V20 + k] * d0, w[V21 + k] * d1, w[V22 + k] * d2
        g00, g01, g02 = w[G00 + k], w[G01 + k], w[G02 + k]
        g10, g11, g12 = w[G10 + k], w[G11 + k], w[G12 + k]
        g20, g21, g22 = w[G20 + k], w[G21 + k], w[G22 + k]
        a, b, c = w[U00 + k], w[U01 + k], w[U02 + k]
        p, q, r = a * v00 + b * v01 + c * v02, a * v10 + b * v11 + c * v12, a * v20 + b * v21 + c * v22
        w[F00 + k], w[F01 + k] = p * g00 + q * g01 + r * g02, p * g10 + q * g11 + r * g12
        w[F02 + k] = p * g20 + q * g21 + r * g22
        a, b, c = w[U10 + k], w[U11 + k], w[U12 + k]
        p, q, r = a * v00 + b * v01 + c * v02, a * v10 + b * v11 + c * v12, a * v20 + b * v21 + c * v22
        w[F10 + k], w[F11 + k] = p * g00 + q * g01 + r * g02, p * g10 + q * g11 + r * g12
        w[F12 + k] = p * g20 + q * g21 + r * g22
        a, b, c = w[U20 + k], w[U21 + k], w[U22 + k]
        p, q, r = a * v00 + b * v01 + c * v02, a * v10 + b * v11 + c * v12, a * v20 + b * v21 + c * v22
        w[F20 + k], w[F21 + k] = p * g00 + q * g01 + r * g02, p * g10 + q * g11 + r * g12
        w[F22 + k] = p * g20 + q * g21 + r * g22


@njit(**COMPILED)
def _scatter(w, corners, gradient):
    """Add a block's nodal derivatives to the gradient; vertex 0 of each tet gets minus their sum."""
    total = 0.0
    for k in range(LANES):
        total += w[ENERGY + k]
        a, b, c, d = corners[k], corners[LANES + k], corners[2 * LANES + k], corners[3 * LANES + k]
        for r in range(3):
            row = F00 + 3 * r * LANES + k
            p, q, s = w[row], w[row + LANES], w[row + 2 * LANES]
            gradient[a, r] -= p + q + s
            gradient[b, r] += p
            gradient[c, r] += q
            gradient[d, r] += s
    return total


@njit(nogil=True, **COMPILED)
def add_tets(parameters, corners, has_volume, u, gradient):
    """Add the tets' gradient [mN] at displacement u [mm], both (n, 3), in place; return their energy [µJ].

    parameters (blocks, PARAMETERS * LANES) and corners (blocks, 4 * LANES) have the layout of `projections`; has_volume
    (blocks,) tells where the volume projection is needed at all. Guards, which hardly ever act, cost a test of F.
    """
    w = np.zeros(ROWS * LANES)
    total = 0.0
    for block in range(len(parameters)):
        gather(w, parameters[block], corners[block], u)
        deformation_gradient(w)
        if not has_volume[block] and _is_slack(w):
            continue
        decompose(w)
        if not has_volume[block]:
            w[D0 : D0 + 3 * LANES] = 0.0
        elif project_volume(w) > 0:
            settle_doubts(w)
        _add_strain(w)
        _forces(w)
        total += _scatter(w, corners[block], gradient)
    return total


@njit(inline="always", **COMPILED)
def _away(value):
    """Keep a divisor away from zero."""
    return value if abs(value) > SMALLEST else (SMALLEST if value >= 0.0 else -SMALLEST)


@njit(inline="always", **COMPILED)
def _strain_pair(a, b, ca, cb, inside_a, inside_b):
    """Return twist and flip of unit Strain for stretches a >= b with distances ca, cb from their bounds."""
    if a - b > 1e-8:
        flip = (ca - cb) / (a - b)
    else:
        flip = 0.0 if inside_a and inside_b else 1.0
    return (ca + cb) / _away(a + b), flip


@njit(**COMPILED)
def _moduli(w, k, h, twist, flip):
    """Write the block h (3, 3), twist (3,) and flip (3,) of one lane, weights and rest volume included."""
    s0, s1, s2 = w[S0 + k], w[S1 + k], w[S2 + k]
    strain = w[STRAIN + k] if s0 > w[ACTIVE + k] else 0.0
    low, high, volume = w[LOW + k], w[HIGH + k], w[VOLUME + k]
    c0, c1, c2 = s0 - min(max(s0, low), high), s1 - min(max(s1, low), high), s2 - min(max(s2, low), high)
    in0, in1, in2 = low < s0 < high, low < s1 < high, low < s2 < high
    h[:] = 0.0
    h[0, 0], h[1, 1], h[2, 2] = (0.0 if in0 else strain), (0.0 if in1 else strain), (0.0 if in2 else strain)
    turned, exchanged = _strain_pair(s0, s1, c0, c1, in0, in1)
    twist[0], flip[0] = strain * turned, strain * exchanged
    turned, exchanged = _strain_pair(s0, s2, c0, c2, in0, in2)
    twist[1], flip[1] = strain * turned, strain * exchanged
    turned, exchanged = _strain_pair(s1, s2, c1, c2, in1, in2)
    twist[2], flip[2] = strain * turned, strain * exchanged
    if volume == 0.0:
        return
    t0, t1, t2 = s0 - w[D0 + k], s1 - w[D1 + k], s2 - w[D2 + k]
    m = -t0 * w[D0 + k]
    q0, q1, q2 = 1.0 / _away(t0 * t0 + m), 1.0 / _away(t1 * t1 + m), 1.0 / _away(t2 * t2 + m)
    scale = volume / (q0 + q1 + q2)
    h[0, 0] += scale * q0 * (1.0 + m * (q1 + q2))
    h[1, 1] += scale * q1 * (1.0 + m * (q0 + q2))
    h[2, 2] += scale * q2 * (1.0 + m * (q0 + q1))
    h[0, 1] = h[1, 0] = scale * t0 * t1 * q0 * q1
    h[0, 2] = h[2, 0] = scale * t0 * t2 * q0 * q2
    h[1, 2] = h[2, 1] = scale * t1 * t2 * q1 * q2
    twist[0] -= volume * m / _away(t0 * t1 - m)
    twist[1] -= volume * m / _away(t0 * t2 - m)
    twist[2] -= volume * m / _away(t1 * t2 - m)
    flip[0] += volume * m / _away(t0 * t1 + m)
    flip[1] += volume * m / _away(t0 * t2 + m)
    flip[2] += volume * m / _away(t1 * t2 + m)


@njit(**COMPILED)
def _raise_block(h, least):
    """Raise the eigenvalues of a symmetric h (n, n) to at least `least`, in place (cyclic Jacobi)."""
    n = len(h)
    V = np.eye(n)
    for _ in range(30):
        off, size = 0.0, 0.0
        for i in range(n):
            size += h[i, i] ** 2
            for j in range(i):
                off += h[i, j] ** 2
        if off <= 1e-28 * size:
            break
        for i in range(n - 1):
            for j in range(i + 1, n):
                if h[i, j] == 0.0:
                    continue
                zeta = (h[j, j] - h[i, i]) / (2.0 * h[i, j])
                t = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + np.sqrt(1.0 + zeta * zeta))
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = t * c
                for r in range(n):
                    x, y = h[r, i], h[r, j]
                    h[r, i], h[r, j] = c * x - s * y, s * x + c * y
                for r in range(n):
                    x, y = h[i, r], h[j, r]
                    h[i, r], h[j, r] = c * x - s * y, s * x + c * y
                for r in range(n):
                    x, y = V[r, i], V[r, j]
                    V[r, i], V[r, j] = c * x - s * y, s * x + c * y
    values = np.empty(n)
    for i in range(n):
        values[i] = max(h[i, i], least)
    for r in range(n):
        for c2 in range(n):
            total = 0.0
            for i in range(n):
                total += V[r, i] * values[i] * V[c2, i]
            h[r, c2] = total


@njit(**COMPILED)
def _raise(h, twist, flip, least):
    """Raise all nine eigenvalues to at least `least`."""
    for pair in range(3):
        twist[pair], flip[pair] = max(twist[pair], least), max(flip[pair], least)
    a, b, c = h[0, 0] - least, h[0, 1], h[0, 2]
    d, f, g = h[1, 1] - least, h[1, 2], h[2, 2] - least
    det = a * (d * g - f * f) - b * (b * g - c * f) + c * (b * f - c * d)
    if not (a > 0.0 and a * d - b * b > 0.0 and det > 0.0):
        _raise_block(h, least)


@njit(**COMPILED)
def _pair_block(h, alpha, beta, ga, gb, U, block, work):
    """Compute U M Uᵀ with M the Hessian between two corners whose shape gradients are ga, gb in the frame of V."""
    for i in range(3):
        for k in range(3):
            if i == k:
                value = h[i, i] * ga[i] * gb[i]
                for j in range(3):
                    if j != i:
                        value += alpha[i + j - 1] * ga[j] * gb[j]
            else:
                value = h[i, k] * ga[i] * gb[k] + beta[i + k - 1] * ga[k] * gb[i]
            work[i, k] = value
    for r in range(3):
        w0 = U[r, 0] * work[0, 0] + U[r, 1] * work[1, 0] + U[r, 2] * work[2, 0]
        w1 = U[r, 0] * work[0, 1] + U[r, 1] * work[1, 1] + U[r, 2] * work[2, 1]
        w2 = U[r, 0] * work[0, 2] + U[r, 1] * work[1, 2] + U[r, 2] * work[2, 2]
        for c in range(3):
            block[r, c] = w0 * U[c, 0] + w1 * U[c, 1] + w2 * U[c, 2]


@njit(**COMPILED)
def add_tet_tangent(parameters, corners, has_volume, count, slots, least, u, blocks):
    """Add the tets' Hessian [mN/mm] at displacement u [mm], shape (n, 3), to blocks (pairs, 3, 3), in place.

    slots (count, 10) are the blocks of `PAIRS`, of which each holds rows of its higher vertex. Where `least` is not
    negative, no eigenvalue of dP/dF is left below that share of the tet's Strain weight.
    """
    w = np.zeros(ROWS * LANES)
    h, twist, flip, alpha, beta = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    U, g, work = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    K = np.empty((3, 3, 3, 3))
    edge = np.empty((3, 3))
    at = np.array([[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]])
    for block in range(len(parameters)):
        gather(w, parameters[block], corners[block], u)
        deformation_gradient(w)
        decompose(w)
        if not has_volume[block]:
            w[D0 : D0 + 3 * LANES] = 0.0
        elif project_volume(w) > 0:
            settle_doubts(w)
        for k in range(min(LANES, count - block * LANES)):
            _moduli(w, k, h, twist, flip)
            if least >= 0.0:
                _raise(h, twist, flip, least * w[STRAIN + k])
            # Pairs in the order 01, 02, 12: i + j - 1 is their number.
            for pair in range(3):
                alpha[pair], beta[pair] = 0.5 * (flip[pair] + twist[pair]), 0.5 * (flip[pair] - twist[pair])
            for i in range(3):
                for j in range(3):
                    U[i, j] = w[U00 + (3 * i + j) * LANES + k]
                    total = 0.0
                    for r in range(3):
                        total += w[V00 + (3 * r + j) * LANES + k] * w[G00 + (3 * i + r) * LANES + k]
                    g[i, j] = total
            t = block * LANES + k
            for a in range(3):
                for b in range(a, 3):
                    _pair_block(h, alpha, beta, g[a], g[b], U, K[a, b], work)
                    if a != b:
                        K[b, a] = K[a, b].T
            for a in range(3):
                here = corners[block, (a + 1) * LANES + k]
                for b in range(a, 3):
                    add_block(blocks, slots[t, at[a + 1, b + 1]], K[a, b], here < corners[block, (b + 1) * LANES + k])
            # Shape gradients add up to nothing, so a corner's row is minus the sum of the others'.
            origin = corners[block, k]
            for b in range(3):
                edge[:] = -(K[0, b] + K[1, b] + K[2, b])
                add_block(blocks, slots[t, at[0, b + 1]], edge, origin < corners[block, (b + 1) * LANES + k])
                work[:] = edge if b == 0 else work + edge
            add_block(blocks, slots[t, 0], -work, False)
