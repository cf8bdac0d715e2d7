"""The layout of a block of tets: quantity after quantity, each a row of LANES numbers, so that loops vectorise.

The rows lie in one flat array and their offsets are compile-time constants: the compiler then knows that no two
rows overlap, and needs no run-time checks that would make it fall back to scalar code.

Numba's cache looks at the file of the outermost function only: after a change to this file, `singular_values` or
`volume_projection`, delete the `*.nbi` files beside them.
"""

from __future__ import annotations

LANES = 32


def _rows(first: int, count: int) -> tuple[int, ...]:
    return tuple(LANES * row for row in range(first, first + count))


# What depends on the scene: Dm_inv (row j belongs to edge j), then the weights (with the rest volume) and bounds.
# Strain acts where the largest stretch is above ACTIVE, which is what the indicator rule sets; else it is below all.
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
