"""The tangent of a law of singular values as an array, which FEniCSx' solver never makes."""

import numpy as np

PAIRS = ((0, 1), (0, 2), (1, 2))


def tangent(U, V, modes):
    """dP/dF [kPa], shape (m, 9, 9), rows and columns in the order of F's entries row by row; see `principal`."""
    frames = np.einsum("eai,ebj->eijab", U, V).reshape(len(U), 3, 3, 9)
    stretches = frames[:, np.arange(3), np.arange(3)]
    found = np.einsum("eik,eia,ekb->eab", modes.block, stretches, stretches)
    for k, (i, j) in enumerate(PAIRS):
        for value, sign in ((modes.flip[:, k], 1.0), (modes.twist[:, k], -1.0)):
            mode = frames[:, i, j] + sign * frames[:, j, i]
            found += 0.5 * value[:, None, None] * mode[:, :, None] * mode[:, None, :]
    return found
