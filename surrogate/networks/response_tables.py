"""The part of the modal network that is linear in w: tables of every vertex and expression, mixed by a shared network.

    R_j(v) = g(v) Σ_k φ_k(v) M_kj(v) - l(v) S_j(v)

φ, the gain g and the lag l come from p at the vertex, the code and a trained position of the vertex; the last φ is 1.
l is `Features.give` times such a gain; S_j are the person's shapes. For given φ, g and l the best tables M follow by
ridge regression at each vertex, so training only descends in the network's own layers, and solves for the tables now
and then (variable projection, Golub and Pereyra 1973). A file has the tables in whole numbers of one byte and a scale
for each expression and vertex: their principal components would need a rank above 500 for the same error.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numba import njit

from ...lhm.base.mesh import Floats32
from ..rigs.rig import WEIGHTS, silu
from .features import GIVE
from .layers import EVERY, Arrays, concatenate, exp, linear

MIXED = 28
"""How many tables are mixed, besides the one that always counts."""
RIDGE = 0.03
"""Penalty of the tables, in shares of the mean square of φ."""


def mix(network: Arrays, local, code, vertices=EVERY):
    """Return g φ (..., v, k) and the lag (..., v, 1) at some vertices, of local features (..., v, f) and codes."""
    weight = network["response_in.weight"]
    place = network["response_position"][vertices] @ weight[:, local.shape[-1] :].T + network["response_in.bias"]
    hidden = silu(local @ weight[:, : local.shape[-1]].T + place + code @ network["response_code.weight"].T)
    hidden = silu(linear(network, "response_middle", hidden) + hidden)
    shares = linear(network, "response_share", hidden)
    shares = concatenate([shares, 1.0 + 0.0 * shares[..., :1]]) * exp(linear(network, "response_gain", hidden))
    return shares, local[..., [GIVE]] * (1.0 + linear(network, "lag", hidden))


def responses(tables: Floats32, shares: Floats32, lag: Floats32, shapes: Floats32) -> Floats32:
    """Return what each weight adds to T - S [mm], shape (52, n, 3), besides shapes (52, n, 3).

    tables: shape (k, 52, n, 3), of `expand`; shares (n, k) and lag (n, 1) of `mix`.
    """
    answer = -lag * shapes
    _add_mixed(tables, np.ascontiguousarray(shares), answer)
    return answer


@njit(cache=True, fastmath=True)
def _add_face(shares, moved, gram, pulled):
    """Add a face's normal equations at each vertex: shares (n, k), moved (n, 52, 3), both over the face's scale."""
    for v in range(len(shares)):
        for k in range(shares.shape[1]):
            for other in range(shares.shape[1]):
                gram[v, k, other] += np.float64(shares[v, k]) * np.float64(shares[v, other])
            for j in range(moved.shape[1]):
                for c in range(3):
                    pulled[v, k, 3 * j + c] += shares[v, k] * moved[v, j, c]


@njit(cache=True, fastmath=True)
def _add_mixed(tables, shares, answer):
    """Add tables (k, 52, n, 3), weighted at each vertex by shares (n, k), to an answer (52, n, 3)."""
    for j in range(answer.shape[0]):
        for k in range(len(tables)):
            for v in range(answer.shape[1]):
                for c in range(3):
                    answer[j, v, c] += shares[v, k] * tables[k, j, v, c]


def expand(network: Arrays) -> Floats32:
    """Return the tables of a file's network, shape (k, 52, n, 3)."""
    return network["response_table"] * network["response_scale"][..., None]


def compress(tables: Floats32) -> dict[str, Floats32]:
    """Return `response_table`, whole numbers of [-127, 127] in the shape of tables (k, 52, n, 3), and its scale."""
    scale = np.maximum(np.abs(tables).max(axis=(0, 3)) / 127.0, 1e-7).astype(np.float16).astype(np.float32)
    return {"response_table": np.rint(tables / scale[..., None]).clip(-127, 127), "response_scale": scale}


def solve_tables(faces: Iterable[tuple[Floats32, Floats32, float]], vertices: int, count: int) -> Floats32:
    """Solve for the tables of every vertex, shape (k, 52, n, 3), by ridge regression over faces.

    faces: of each, g φ (n, k), its responses with the lag added back (52, n, 3) [mm], and the scale [mm] by which its
    errors count. One face is in memory at a time.
    """
    gram = np.zeros((vertices, count, count))
    pulled = np.zeros((vertices, count, WEIGHTS * 3), dtype=np.float32)
    for shares, moved, scale in faces:
        _add_face(shares / scale, np.ascontiguousarray(moved.transpose(1, 0, 2)) / scale, gram, pulled)
    size = np.maximum(np.einsum("vkk->v", gram) / count, 1e-12)
    gram += RIDGE * size[:, None, None] * np.eye(count)
    tables = np.linalg.solve(gram, pulled.astype(np.float64)).astype(np.float32)
    return np.ascontiguousarray(tables.reshape(vertices, count, WEIGHTS, 3).transpose(1, 2, 0, 3))
