"""Principal deformation gradients of simulated frames: where the hypernetwork's table starts."""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats32
from .samples import Samples

FLOOR = 1e-4
"""Added to each squared singular value of a face's edges, relative to their sum: lids that close flatten faces."""


def least_gradients(samples: Samples) -> Floats32:
    """The smallest J - I per face that takes the edges of S_t to those of T_t, shape (N, faces, 9)."""
    edges = _edges(samples.blended, samples.reference.triangles)
    moved = _edges(samples.simulated - samples.blended, samples.reference.triangles)
    gram = np.einsum("nfia,nfib->nfab", edges, edges)
    trace = gram[..., 0, 0] + gram[..., 1, 1]
    gram += FLOOR * trace[..., None, None] * np.eye(2, dtype=np.float32)
    a, b, d = gram[..., 0, 0], gram[..., 0, 1], gram[..., 1, 1]
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)
    inverse = adjugate / (a * d - b * b)[..., None, None]
    return np.einsum("nfia,nfab,nfjb->nfij", moved, inverse, edges, optimize=True).reshape(*moved.shape[:2], 9)


def _edges(positions: Floats32, triangles) -> Floats32:
    corners = positions[:, triangles]
    return np.ascontiguousarray((corners[:, :, 1:] - corners[:, :, :1]).transpose(0, 1, 3, 2))


def principal_gradients(samples: Samples, count: int) -> Floats32:
    """Area-weighted principal components of `least_gradients`, shape (count, faces, 9).

    Each is scaled so that its coefficients over the samples have unit mean square; those beyond the rank are zero.
    """
    gradients = least_gradients(samples)
    weight = np.sqrt(samples.reference.areas / samples.reference.areas.mean()).astype(np.float32)[:, None]
    flat = (gradients * weight).reshape(len(samples), -1)
    size, vectors = np.linalg.eigh((flat @ flat.T).astype(np.float64))
    table = np.zeros((count, *gradients.shape[1:]), dtype=np.float32)
    kept = min(count, int(np.count_nonzero(size > 1e-7 * size[-1])))
    leading = vectors[:, ::-1][:, :kept].T.astype(np.float32)
    table[:kept] = (leading @ flat).reshape(kept, *gradients.shape[1:]) / weight / np.sqrt(len(samples))
    return table
