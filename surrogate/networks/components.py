"""Principal components of many rows, by random combinations."""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats, Floats32


def find_components(data: Floats32, count: int, rng: np.random.Generator) -> tuple[Floats32, Floats]:
    """Find the `count` leading right singular vectors (count, m) of data (rows, m), and their amplitudes' mean size.

    By one power iteration of random combinations (Halko, Martinsson and Tropp 2011); vectors beyond the rank are zero.
    Sizes (count,) are roots of mean squares.
    """
    more = min(len(data), count + 20)
    sketch = data.T @ (data @ (data.T @ rng.normal(size=(len(data), more)).astype(np.float32)))
    basis = np.linalg.qr(sketch)[0]
    _, size, vectors = np.linalg.svd(data @ basis, full_matrices=False)
    kept = min(count, len(size))
    modes, sizes = np.zeros((count, data.shape[1]), dtype=np.float32), np.zeros(count)
    modes[:kept] = vectors[:kept] @ basis.T
    sizes[:kept] = size[:kept] / np.sqrt(len(data))
    return modes, sizes
