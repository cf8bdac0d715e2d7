"""How a block of tets lies in memory: LANES tets at a time, quantity after quantity a row of LANES numbers.

So loops over lanes vectorise. The rows lie in one flat array and their offsets are compile-time constants: the compiler
then knows that no two rows overlap, and needs no run-time checks that would make it fall back to scalar code. Numba's
cache looks at the file of the outermost function only: after a change to a file of local steps, delete the `*.nbi`
files beside it.
"""

from __future__ import annotations

LANES = 32


def rows(first: int, count: int) -> tuple[int, ...]:
    """Return the offsets of so many rows from one on."""
    return tuple(LANES * row for row in range(first, first + count))


# What depends on the scene: Dm_inv (row j belongs to edge j), then weights (with the rest volume) and bounds.
G00, G01, G02, G10, G11, G12, G20, G21, G22 = rows(0, 9)
VOLUME, TARGET, STRAIN, LOW = rows(9, 4)
ALWAYS_READ = 13
HIGH, STRAIN2, LOW2, HIGH2 = rows(13, 4)
PARAMETERS = 17

# What the local step computes. F starts as the edges of the displacement and ends as the nodal forces.
F00, F01, F02, F10, F11, F12, F20, F21, F22 = rows(17, 9)
S0, S1, S2 = rows(26, 3)
D0, D1, D2 = rows(29, 3)
ENERGY, DOUBT, MULTIPLIER = rows(32, 3)

# By singular values F = U diag(s) Vᵀ, with V from Jacobi's sweeps on C = FᵀF.
C00, C11, C22, C01, C02, C12 = rows(35, 6)
V00, V01, V02, V10, V11, V12, V20, V21, V22 = rows(41, 9)
U00, U01, U02, U10, U11, U12, U20, U21, U22 = rows(50, 9)

# By the nearest rotation F = R S: cofactors of F, invariants of S, and a stress R (A0 + A1 S + A2 S²).
R00, R01, R02, R10, R11, R12, R20, R21, R22 = rows(59, 9)
K00, K01, K02, K10, K11, K12, K20, K21, K22 = rows(68, 9)
FIRST, SECOND, THIRD, SQUARES, MINORS = rows(77, 5)
A0, A1, A2 = rows(82, 3)
ROWS = 85

# No fast-math: with it, code loaded from numba's cache rounds otherwise than code just compiled, and a corpus made by
# two processes would differ from one made by one. It would be a tenth faster.
COMPILED = {"cache": True, "error_model": "numpy"}
