"""Lids that are one surface, and stay shut or as they are while the face around them moves."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags

from ..arkit import ARKIT
from ..base.geometry.cholesky import factorise
from ..base.mesh import Floats, Surface
from ..rig import Rig
from ..wraps.landmarks import distance_to
from ..wraps.shrinkwrap import neighbours

REACH = 8.0
"""[mm] From the template's lid rims: its lids part or meet there, where this skin is one piece."""
LEAST = 0.1
"""[mm] Shorter edges count as this long."""


def carried_along(rig: Rig, skin: Surface, rims: Floats, own: Collection[str]) -> Rig:
    """The rig in which a skin near the registered rims (k, 3) [mm] of lids that stay still goes with what is around it.

    Displacements there are those of least squared Laplacian, so that no expression draws one lid over the other; the
    expressions in `own` stay as they are.
    """
    x, edges = skin.vertices, neighbours(skin.triangles, len(skin.vertices)).tocoo()
    used = np.bincount(edges.row, minlength=len(x)) > 0
    inside = (distance_to(x, rims) < REACH) & used
    if not inside.any() or inside[used].all():
        return rig
    # By their lengths, so that short edges take no more of a stretch than long ones.
    length = np.linalg.norm(x[edges.row] - x[edges.col], axis=1)
    weights = csr_matrix((1.0 / np.maximum(length, LEAST), (edges.row, edges.col)), shape=edges.shape)
    total = np.maximum(np.asarray(weights.sum(axis=1)).ravel(), 1e-12)
    laplacian = (diags(used.astype(float)) - diags(1.0 / total) @ weights).tocsr()
    rows = np.asarray(abs(laplacian[:, inside]).sum(axis=1)).ravel() > 0
    free = laplacian[rows][:, inside]
    # A piece that lies wholly inside has nothing to go along with.
    solve = factorise((free.T @ free + 1e-9 * diags(np.ones(int(inside.sum())))).tocsc())
    moved = [k for k, name in enumerate(ARKIT) if name not in own and np.abs(rig.deltas[k][inside]).max() > 0]
    deltas = np.array(rig.deltas)
    around = laplacian[rows][:, ~inside]
    for k in moved:
        deltas[k, inside] = solve(-(free.T @ (around @ deltas[k, ~inside].astype(np.float64))))
    return replace(rig, deltas=deltas)
