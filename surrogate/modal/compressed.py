"""The remainder of a bound face in as few modes as usual expressions of it need: they are what a frame costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg.blas import ssyrk

from ..usual import usual_expressions
from .rig import BoundModes

LEFT_OUT = 5e-4
"""[mm] Root mean square over vertices and usual expressions of what may be left out of the remainder."""
SAMPLED = 300


def compressed(bound: BoundModes) -> BoundModes:
    """The same face in principal components of its remainder; what they leave out is within LEFT_OUT."""
    amplitudes = bound.remainder_of(usual_expressions(2, SAMPLED)).astype(np.float64)
    flat = bound.modes.reshape(len(bound.modes), -1)
    second = amplitudes.T @ amplitudes / len(amplitudes)
    # Of the two Gram matrices, since components of amplitudes · modes are wanted and modes are not orthogonal.
    gram = ssyrk(1.0, flat.T, trans=1).astype(np.float64)  # its upper triangle, in a third of a product's time
    size, turn = np.linalg.eigh(gram, UPLO="U")
    root = turn * np.sqrt(np.maximum(size, 1e-12 * size[-1]))
    power, vectors = np.linalg.eigh(root.T @ second @ root)
    tail = np.cumsum(np.maximum(power, 0.0)) / bound.modes.shape[1]
    kept = vectors[:, np.count_nonzero(tail <= LEFT_OUT**2) :][:, ::-1]
    into = root @ kept  # amplitudes of the components, of those of the modes
    back = np.linalg.solve(root.T, kept).T  # components, of the modes
    remainder = bound.remainder_of
    return replace(
        bound,
        modes=(back.astype(np.float32) @ flat).reshape(-1, *bound.modes.shape[1:]),
        remainder_of=replace(
            remainder,
            outer=np.ascontiguousarray(remainder.outer @ into, dtype=np.float32),
            linear=np.ascontiguousarray(remainder.linear @ into, dtype=np.float32),
            rest=(remainder.rest @ into).astype(np.float32),
        ),
    )
