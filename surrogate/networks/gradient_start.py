"""Where our hypernetwork begins: tables of deformation gradients by regression on a corpus' faces.

Fields are found at vertices, where a small error stays one, and then taken to gradients of the mean skin.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats, Floats32, Ints, Surface
from ..corpus.reading import Faces
from .hypernetwork import OFFSETS, RESPONSES
from .ridge import find_components

FLOOR = 1e-4
"""Added to each squared singular value of a face's edges, relative to their sum: lids that close flatten faces."""
REGRESSED, SPANNED = 400, 64
"""Faces by whose offsets a training begins, and those of them by whose responses and frames, at most."""
LEAST_MOTION = 0.02
"""[mm] Added to a frame's own size: a still one must not decide."""
PENALTY = 1e-5
"""Of the regression on p, per face; parameters are in [-1, 1]."""


def regress(
    faces: Faces,
    chosen: Ints,
    parameters: Callable[[Floats], Floats],
    followed: np.ndarray,
    latent: int,
    rng: np.random.Generator,
) -> dict[str, Floats32]:
    """Return tables and W by regression on some of the faces `chosen`, by the names of `Hypernetwork`'s arrays.

    They are what is linear in w, at rest in p, and directions of what is left. parameters: gives p at vertices (n, P)
    of coefficients; followed (P,): which of them count; latent: length of z.
    """
    picked = chosen[np.sort(rng.permutation(len(chosen))[:REGRESSED])]
    spanned = set(rng.permutation(picked)[:SPANNED].tolist())
    offsets, there, sizes, own, responses, remainders = [], [], [], [], [], []
    for number in picked.tolist():
        face = faces.face(number)
        of_shapes = np.asarray(face.responses, dtype=np.float32)
        sizes.append(_measure(of_shapes).mean() + 1e-9)
        offsets.append(face.offset.astype(np.float32) - faces.carried(number))
        there.append(parameters(face.coefficients)[:, followed])
        own.append(sizes[-1] + _measure(offsets[-1]) + LEAST_MOTION)
        if number in spanned:
            responses.append(of_shapes.reshape(len(of_shapes), -1) / sizes[-1])
            left = faces.frames(number).remainder(face)
            remainders += [*(left / (_measure(left)[:, None, None] + 1e-9)).reshape(len(left), -1)]
    shapes = np.array(responses)
    linear = _find_directions(shapes, latent)
    along = np.einsum("kj,fjx->fkx", linear, shapes, optimize=True)
    mean = along.mean(axis=0)
    away = (along - mean).reshape(len(along), -1)
    tables = np.zeros((RESPONSES, latent, shapes.shape[2]), dtype=np.float32)
    tables[0, : len(linear)] = mean
    tables[0, len(linear) :] = _spread(np.array(remainders), latent - len(linear), rng)
    tables[1:, : len(linear)] = _spread(away, RESPONSES - 1, rng).reshape(-1, *mean.shape)
    at_rest = regress_offsets(np.array(offsets), np.array(there), np.array(own), rng)
    to_gradients, typical = partial(_take_to_gradients, faces.mean), np.float32(np.median(sizes))
    gradients = np.stack([to_gradients(typical * table) for table in tables]).transpose(2, 0, 1, 3)
    scale = max(np.sqrt(np.mean(gradients**2)), np.float32(1e-9))
    weights = np.zeros((latent, shapes.shape[1]), dtype=np.float32)
    weights[: len(linear)] = linear
    return {
        "responses": gradients / scale,
        "offsets": to_gradients(at_rest).transpose(1, 0, 2) / scale,
        "scale": np.array([scale], dtype=np.float32),
        "expression_linear.weight": weights,
    }


def regress_offsets(offsets: Floats32, parameters: Floats32, sizes: Floats32, rng: np.random.Generator) -> Floats32:
    """Regress offsets (F, n, 3) on p at each vertex (F, n, k): fields of rest, of p and of what is left, (·, n, 3).

    Errors count in shares of the faces' sizes (F,) [mm].
    """
    share = (1.0 / sizes).astype(np.float32)[:, None, None] * np.float32(sizes.mean())
    factors = np.concatenate([np.ones((*parameters.shape[:2], 1), np.float32), parameters.astype(np.float32)], axis=2)
    factors, given = factors * share, offsets * share
    gram = np.einsum("fvk,fvl->vkl", factors, factors, optimize=True)
    gram += PENALTY * len(offsets) * np.eye(gram.shape[-1], dtype=np.float32)
    fields = np.linalg.solve(gram, np.einsum("fvk,fvc->vkc", factors, given, optimize=True)).astype(np.float32)
    left = given - np.einsum("fvk,vkc->fvc", factors, fields, optimize=True)
    directions = _spread(left.reshape(len(left), -1), OFFSETS, rng).reshape(OFFSETS, *offsets.shape[1:])
    return np.concatenate([fields.transpose(1, 0, 2), directions])


def _measure(fields: Floats32) -> Floats32:
    """The mean length (...) of fields (..., n, 3)."""
    return np.linalg.norm(fields, axis=-1).mean(axis=-1)


def _find_directions(shapes: Floats32, count: int) -> Floats32:
    """W of one length (k, 52), by which responses (F, 52, 3 n) keep most: each weight's own where `count` allows it."""
    size = shapes.shape[1]
    if count >= size:
        return np.eye(size, dtype=np.float32)
    gram = sum((each @ each.T for each in shapes), np.zeros((size, size)))
    return np.linalg.eigh(gram)[1][:, ::-1][:, :count].T.astype(np.float32)


def _spread(rows: Floats32, count: int, rng: np.random.Generator) -> Floats32:
    """The directions (count, m) along which rows (N, m) are largest, each as long as they are along it on average."""
    if not count:
        return np.zeros((0, rows.shape[1]), dtype=np.float32)
    modes, sizes = find_components(rows, count, rng)
    return (modes * sizes[:, None]).astype(np.float32)


def _take_to_gradients(mean: Surface, fields: Floats32) -> Floats32:
    """The gradients (N, faces, 9) by which the mean skin moves along fields (N, n, 3) or (N, 3 n) [mm]."""
    moved = fields.reshape(len(fields), *mean.vertices.shape)
    return least_gradients(mean, np.broadcast_to(mean.vertices.astype(np.float32), moved.shape), moved)


def least_gradients(reference: Surface, blended: Floats32, moved: Floats32) -> Floats32:
    """The smallest J - I per face that takes the edges of S_t to those of S_t + moved_t, shape (N, faces, 9)."""
    edges, moves = (_edges(positions, reference.triangles) for positions in (blended, moved))
    gram = np.einsum("nfia,nfib->nfab", edges, edges)
    trace = gram[..., 0, 0] + gram[..., 1, 1]
    gram += FLOOR * trace[..., None, None] * np.eye(2, dtype=np.float32)
    a, b, d = gram[..., 0, 0], gram[..., 0, 1], gram[..., 1, 1]
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)
    inverse = adjugate / (a * d - b * b)[..., None, None]
    return np.einsum("nfia,nfab,nfjb->nfij", moves, inverse, edges, optimize=True).reshape(*moves.shape[:2], 9)


def _edges(positions: Floats32, triangles) -> Floats32:
    corners = positions[:, triangles]
    return np.ascontiguousarray((corners[:, :, 1:] - corners[:, :, :1]).transpose(0, 1, 3, 2))
