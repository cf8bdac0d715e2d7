"""Motions of a surface that vary smoothly: one affine map per vertex, as in non-rigid ICP."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, hstack

from ..base.geometry.cholesky import Solve, factorise_definite
from ..base.mesh import Floats, Ints

RETURN = 0.01
"""Weight by which gradients return to the start's where nothing holds them: within 1 / sqrt(RETURN) edges."""

TIE = 4.0
"""Weight of what should move together, beside the edges' 1."""


class SmoothAffine:
    """Positions x_i and gradients A_i (3, 3) of a surface that moves away from a start X, and their stiffness.

    E = sum over edges, both ways, |x_j - x_i - A_i (X_j - X_i)|² + |X_j - X_i|² |A_i - A_j|² / 2, plus per vertex
    RETURN h² |A_i - I|² with h the mean length of its edges, plus TIE |ties (x - X)|² for the rows of `ties` (k, n),
    differences of points that should move together. But for the last two it vanishes for every affine map of
    the start (Amberg, Romdhani and Vetter, CVPR 2007, Eq. 4, written about each vertex in place of the origin).
    """

    def __init__(self, start: Floats, triangles: Ints, ties: csr_matrix):
        n = self.n = len(start)
        pairs = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
        i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
        along = start[j] - start[i]
        length = np.linalg.norm(along, axis=1)
        h = np.bincount(i, length, n) / np.maximum(np.bincount(i, minlength=n), 1)
        # Unknowns, for each coordinate alike: n positions, then 3 n gradients.
        at_i, at_j = (n + 3 * k[:, None] + np.arange(3) for k in (i, j))
        edges = np.arange(len(i))
        values = np.concatenate([np.ones(len(i)), -np.ones(len(i)), -along.ravel()])
        places = np.concatenate([edges, edges, np.repeat(edges, 3)]), np.concatenate([j, i, at_i.ravel()])
        stretch = csc_matrix((values, places), shape=(len(i), 4 * n))
        size, rows = np.repeat(length, 3), np.arange(3 * len(i))
        values = np.concatenate([size, -size])
        change = csc_matrix((values, (np.tile(rows, 2), np.append(at_i, at_j))), shape=(3 * len(i), 4 * n))
        back = np.concatenate([np.zeros(n), RETURN * np.repeat(h**2, 3)])
        tied = hstack([ties, csr_matrix((ties.shape[0], 3 * n))])
        self._matrix = (stretch.T @ stretch + 0.5 * change.T @ change + TIE * tied.T @ tied + diags(back)).tocsc()
        self._right = back[:, None] * np.vstack([np.zeros((n, 3)), np.tile(np.eye(3), (n, 1))])
        self._right[:n] += TIE * (ties.T @ (ties @ start))
        self._factor: Solve | None = None

    def solve(self, stiffness: float, weights: Floats, targets: Floats) -> Floats:
        """The positions (n, 3) [mm] of least stiffness E + sum_i weights_i |x_i - targets_i|²."""
        data = np.concatenate([weights, np.zeros(3 * self.n)])
        right = stiffness * self._right
        right[: self.n] += weights[:, None] * targets
        # The pattern stays, so that its analysis serves every step.
        self._factor = factorise_definite((stiffness * self._matrix + diags(data)).tocsc(), like=self._factor)
        return self._factor(right)[: self.n]
