"""Resident memory grows by n * columns * 8 bytes with each factor that is made, used once and forgotten."""

import gc

import numpy as np
import scipy.sparse as sp
from cholespy import CholeskySolverD, MatrixType

COLUMNS = 156


def resident_megabytes() -> float:
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[1]) * 4096 / 1e6


line = sp.diags([-1.0, 2.2, -1.0], [-1, 0, 1], shape=(17, 17))
eye = sp.eye(17)
cube = (
    sp.kron(sp.kron(line, eye), eye)
    + sp.kron(sp.kron(eye, line), eye)
    + sp.kron(sp.kron(eye, eye), line)
)
lower = sp.tril(cube).tocoo()
n = cube.shape[0]
right, solution = np.ones((n, COLUMNS)), np.zeros((n, COLUMNS))
for number in range(13):
    solver = CholeskySolverD(
        n,
        lower.row.astype(np.int32),
        lower.col.astype(np.int32),
        lower.data,
        MatrixType.COO,
    )
    solver.solve(right, solution)
    del solver
    gc.collect()
    if number % 4 == 0:
        print(f"{number:2d} factors: {resident_megabytes():.0f} MB")
print(f"n * columns * 8 bytes: {right.nbytes / 1e6:.1f} MB")
