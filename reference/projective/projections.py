"""Local projections, a block of tets at a time: the block's layout, signed singular values, nearest volumes.

Of a block, quantity after quantity is a row of LANES numbers, so that loops vectorise. The rows lie in one flat array
and their offsets are compile-time constants: the compiler then knows that no two rows overlap, and needs no run-time
checks that would make it fall back to scalar code. Numba's cache looks at the file of the outermost function only:
after a change to this file, delete the `*.nbi` files beside it.

F = U diag(s) Vᵀ has rotations U and V, and s0 >= s1 >= |s2|.

The nearest matrix of determinant v (SoftDECA Eq. 10, after ShapeOp) is U diag(t) Vᵀ, since v > 0, with t of
min Σ (t_i - s_i)² subject to t0 t1 t2 = v. The stationary points have t_i (t_i - s_i) = m for one multiplier m, so
t_i = (s_i ± √(s_i² + 4 m))/2, and what is left is one equation for m.
"""

from __future__ import annotations

from math import sqrt

from numba import njit

LANES = 32


def _rows(first: int, count: int) -> tuple[int, ...]:
    return tuple(LANES * row for row in range(first, first + count))


# What depends on the scene: Dm_inv (row j belongs to edge j), then the weights (with the rest volume) and bounds.
# Shape counts where the largest stretch is above ACTIVE, which is what the indicator rule sets; else it is below all.
G00, G01, G02, G10, G11, G12, G20, G21, G22 = _rows(0, 9)
STRAIN, LOW, HIGH, ACTIVE, VOLUME, TARGET = _rows(9, 6)
PARAMETERS = 15

# What the local step computes. F starts as the edges of the displacement and ends as the nodal forces.
F00, F01, F02, F10, F11, F12, F20, F21, F22 = _rows(15, 9)
C00, C11, C22, C01, C02, C12 = _rows(24, 6)
V00, V01, V02, V10, V11, V12, V20, V21, V22 = _rows(30, 9)
U00, U01, U02, U10, U11, U12, U20, U21, U22 = _rows(39, 9)
S0, S1, S2 = _rows(48, 3)
D0, D1, D2 = _rows(51, 3)
ENERGY, DOUBT = _rows(54, 2)
ROWS = 56

# No fast-math: with it, code loaded from numba's cache rounds otherwise than code just compiled, and a corpus made by
# two processes would differ from one made by one. It would be a tenth faster.
COMPILED = {"cache": True, "error_model": "numpy"}

MAX_SWEEPS = 10
"""Of Jacobi rotations; four do for tets of a face."""
STEPS = 7
"""Of Newton's method for the multiplier."""
SCAN = 256
"""Steps of the search for roots where Newton's method is in doubt."""


@njit(inline="always", **COMPILED)
def _rotation(app, aqq, apq):
    """Cosine, sine and tangent of the Jacobi rotation that annihilates apq; the identity where it is zero."""
    difference, twice = aqq - app, 2.0 * apq
    t = twice / (abs(difference) + sqrt(difference * difference + twice * twice) + 1e-300)
    t = t if difference >= 0.0 else -t
    c = 1.0 / sqrt(1.0 + t * t)
    return c, t * c, t


@njit(**COMPILED)
def right_stretch(w):
    """C = FᵀF, and V = I to begin with."""
    for k in range(LANES):
        a, b, c = w[F00 + k], w[F01 + k], w[F02 + k]
        d, e, f = w[F10 + k], w[F11 + k], w[F12 + k]
        g, h, i = w[F20 + k], w[F21 + k], w[F22 + k]
        w[C00 + k] = a * a + d * d + g * g
        w[C11 + k] = b * b + e * e + h * h
        w[C22 + k] = c * c + f * f + i * i
        w[C01 + k] = a * b + d * e + g * h
        w[C02 + k] = a * c + d * f + g * i
        w[C12 + k] = b * c + e * f + h * i
        w[V00 + k], w[V01 + k], w[V02 + k] = 1.0, 0.0, 0.0
        w[V10 + k], w[V11 + k], w[V12 + k] = 0.0, 1.0, 0.0
        w[V20 + k], w[V21 + k], w[V22 + k] = 0.0, 0.0, 1.0


@njit(**COMPILED)
def sweep(w):
    """One cyclic Jacobi sweep over C and V; returns how many lanes were not yet diagonal to rounding."""
    pending = 0
    for k in range(LANES):
        c00, c11, c22 = w[C00 + k], w[C11 + k], w[C22 + k]
        c01, c02, c12 = w[C01 + k], w[C02 + k], w[C12 + k]
        trace = c00 + c11 + c22
        off = c01 * c01 + c02 * c02 + c12 * c12
        pending += 1 if off > 1e-33 * trace * trace else 0

        c, s, t = _rotation(c00, c11, c01)
        c00, c11 = c00 - t * c01, c11 + t * c01
        c02, c12 = c * c02 - s * c12, s * c02 + c * c12
        v00, v01 = c * w[V00 + k] - s * w[V01 + k], s * w[V00 + k] + c * w[V01 + k]
        v10, v11 = c * w[V10 + k] - s * w[V11 + k], s * w[V10 + k] + c * w[V11 + k]
        v20, v21 = c * w[V20 + k] - s * w[V21 + k], s * w[V20 + k] + c * w[V21 + k]

        c, s, t = _rotation(c00, c22, c02)
        c00, c22 = c00 - t * c02, c22 + t * c02
        c01, c12 = -s * c12, c * c12
        v00, v02 = c * v00 - s * w[V02 + k], s * v00 + c * w[V02 + k]
        v10, v12 = c * v10 - s * w[V12 + k], s * v10 + c * w[V12 + k]
        v20, v22 = c * v20 - s * w[V22 + k], s * v20 + c * w[V22 + k]

        c, s, t = _rotation(c11, c22, c12)
        c11, c22 = c11 - t * c12, c22 + t * c12
        c01, c02 = c * c01, s * c01
        w[C00 + k], w[C11 + k], w[C22 + k] = c00, c11, c22
        w[C01 + k], w[C02 + k], w[C12 + k] = c01, c02, 0.0
        w[V00 + k], w[V01 + k], w[V02 + k] = v00, c * v01 - s * v02, s * v01 + c * v02
        w[V10 + k], w[V11 + k], w[V12 + k] = v10, c * v11 - s * v12, s * v11 + c * v12
        w[V20 + k], w[V21 + k], w[V22 + k] = v20, c * v21 - s * v22, s * v21 + c * v22
    return pending


@njit(**COMPILED)
def _order(w, cp, v0p, v1p, v2p, cq, v0q, v1q, v2q):
    """Swap columns p and q of V where eigenvalue q is the larger; one sign changes, so that V stays a rotation."""
    for k in range(LANES):
        swap = w[cq + k] > w[cp + k]
        p, q = w[cp + k], w[cq + k]
        w[cp + k], w[cq + k] = (q if swap else p), (p if swap else q)
        p, q = w[v0p + k], w[v0q + k]
        w[v0p + k], w[v0q + k] = (q if swap else p), (-p if swap else q)
        p, q = w[v1p + k], w[v1q + k]
        w[v1p + k], w[v1q + k] = (q if swap else p), (-p if swap else q)
        p, q = w[v2p + k], w[v2q + k]
        w[v2p + k], w[v2q + k] = (q if swap else p), (-p if swap else q)


@njit(**COMPILED)
def left_vectors(w):
    """U and s from B = F V by Gram-Schmidt, the longest column first; any frame where F is a line or a point."""
    for k in range(LANES):
        f00, f01, f02 = w[F00 + k], w[F01 + k], w[F02 + k]
        f10, f11, f12 = w[F10 + k], w[F11 + k], w[F12 + k]
        f20, f21, f22 = w[F20 + k], w[F21 + k], w[F22 + k]

        a, b, c = w[V00 + k], w[V10 + k], w[V20 + k]
        x, y, z = f00 * a + f01 * b + f02 * c, f10 * a + f11 * b + f12 * c, f20 * a + f21 * b + f22 * c
        first = sqrt(x * x + y * y + z * z)
        scale = 1.0 / max(first, 1e-150)
        point = not first > 1e-150
        ux, uy, uz = (1.0 if point else x * scale), y * scale, z * scale

        a, b, c = w[V01 + k], w[V11 + k], w[V21 + k]
        x, y, z = f00 * a + f01 * b + f02 * c, f10 * a + f11 * b + f12 * c, f20 * a + f21 * b + f22 * c
        along = ux * x + uy * y + uz * z
        x, y, z = x - along * ux, y - along * uy, z - along * uz
        second = sqrt(x * x + y * y + z * z)
        line = not second > 1e-14 * first
        steep = abs(ux) > 0.9
        along = uy if steep else ux
        x = (0.0 if steep else 1.0) - along * ux if line else x
        y = (1.0 if steep else 0.0) - along * uy if line else y
        z = -along * uz if line else z
        scale = 1.0 / sqrt(x * x + y * y + z * z)
        vx, vy, vz = x * scale, y * scale, z * scale

        wx, wy, wz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        a, b, c = w[V02 + k], w[V12 + k], w[V22 + k]
        x, y, z = f00 * a + f01 * b + f02 * c, f10 * a + f11 * b + f12 * c, f20 * a + f21 * b + f22 * c
        w[S0 + k], w[S1 + k], w[S2 + k] = first, (0.0 if line else second), wx * x + wy * y + wz * z
        w[U00 + k], w[U10 + k], w[U20 + k] = ux, uy, uz
        w[U01 + k], w[U11 + k], w[U21 + k] = vx, vy, vz
        w[U02 + k], w[U12 + k], w[U22 + k] = wx, wy, wz


@njit(**COMPILED)
def decompose(w):
    """F = U diag(s) Vᵀ of every lane: Jacobi on FᵀF until all lanes are diagonal, then B = F V.

    The residual F - U diag(s) Vᵀ is a few roundings of s0, repeated and zero singular values included.
    """
    right_stretch(w)
    for _ in range(MAX_SWEEPS):
        if sweep(w) == 0:
            break
    _order(w, C00, V00, V10, V20, C11, V01, V11, V21)
    _order(w, C11, V01, V11, V21, C22, V02, V12, V22)
    _order(w, C00, V00, V10, V20, C11, V01, V11, V21)
    left_vectors(w)


@njit(**COMPILED)
def project_volume(w):
    """Write s - t of every lane to D and return how many lanes are in doubt (marked there).

    Newton's method for ln(t0 t1 t2 / v) = 0, with ln by its Padé form, in the multiplier m from m = 0, all roots
    with plus; m stays above the least value for which t2 is real. A lane is in doubt where it has not converged, or
    where t2 comes near s2 / 2, the end of that branch, beyond which the nearest point has a minus.
    """
    doubts = 0
    for k in range(LANES):
        s0, s1, s2, v = w[S0 + k], w[S1 + k], w[S2 + k], w[TARGET + k]
        least = -0.25 * s2 * s2
        m = 0.0
        r0, r1, r2 = s0, s1, abs(s2)
        t0, t1, t2 = s0, s1, 0.5 * (s2 + r2)
        for _ in range(STEPS):
            product = t0 * t1 * t2
            slope = t1 * t2 * r1 * r2 + t0 * t2 * r0 * r2 + t0 * t1 * r0 * r1
            change = 2.0 * (v - product) * product * r0 * r1 * r2 / ((v + product) * slope)
            m = max(m + change, 0.5 * (m + least))
            r0, r1, r2 = sqrt(s0 * s0 + 4.0 * m), sqrt(s1 * s1 + 4.0 * m), sqrt(s2 * s2 + 4.0 * m)
            t0, t1, t2 = 0.5 * (s0 + r0), 0.5 * (s1 + r1), 0.5 * (s2 + r2)
        sure = (abs(t0 * t1 * t2 - v) <= 1e-14 * v) and (t2 >= 0.51 * s2)
        w[D0 + k], w[D1 + k], w[D2 + k] = -m / t0, -m / t1, -m / t2
        w[DOUBT + k] = 0.0 if sure else 1.0
        doubts += 0 if sure else 1
    return doubts


@njit(inline="always", **COMPILED)
def _on_path(s0, s1, s2, t2):
    """The stationary points as a path: the other two roots (with plus) for a given t2."""
    m = t2 * (t2 - s2)
    t0 = 0.5 * (s0 + sqrt(max(s0 * s0 + 4.0 * m, 0.0)))
    t1 = 0.5 * (s1 + sqrt(max(s1 * s1 + 4.0 * m, 0.0)))
    return t0, t1


@njit(**COMPILED)
def _bisect(s0, s1, s2, v, low, high):
    """The t2 in [low, high] at which the path's product reaches v, to rounding."""
    for _ in range(200):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        t0, t1 = _on_path(s0, s1, s2, middle)
        if t0 * t1 * middle < v:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@njit(**COMPILED)
def nearest_of_determinant(s0, s1, s2, v):
    """The t of determinant v > 0 nearest to s0 >= s1 >= |s2|, wherever s is: slow, but sure.

    For s of a determinant below v the product grows along the path and has one root. Above it, it may have three:
    all that a scan sees are compared (a stretch to twice the size is nearer to a flat than to a round shape).
    """
    if s0 * s1 * s2 <= v:
        low = max(s2, 0.0)
        high = low + v ** (1.0 / 3.0)
        t2 = _bisect(s0, s1, s2, v, low, high)
        t0, t1 = _on_path(s0, s1, s2, t2)
        return t0, t1, t2
    best, best0, best1, best2 = 1e300, s0, s1, s2
    low = 0.0
    for step in range(1, SCAN + 1):
        high = s2 * step / SCAN
        t0, t1 = _on_path(s0, s1, s2, low)
        u0, u1 = _on_path(s0, s1, s2, high)
        if t0 * t1 * low < v <= u0 * u1 * high:
            t2 = _bisect(s0, s1, s2, v, low, high)
            t0, t1 = _on_path(s0, s1, s2, t2)
            distance = (t0 - s0) ** 2 + (t1 - s1) ** 2 + (t2 - s2) ** 2
            if distance < best:
                best, best0, best1, best2 = distance, t0, t1, t2
        low = high
    return best0, best1, best2


@njit(**COMPILED)
def settle_doubts(w):
    """Redo the lanes in doubt by `nearest_of_determinant`."""
    for k in range(LANES):
        if w[DOUBT + k] > 0.0:
            s0, s1, s2 = w[S0 + k], w[S1 + k], w[S2 + k]
            t0, t1, t2 = nearest_of_determinant(s0, s1, s2, w[TARGET + k])
            w[D0 + k], w[D1 + k], w[D2 + k] = s0 - t0, s1 - t1, s2 - t2
