"""Rigid motions that a scene leaves free, by name."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..lhm.base.errors import SceneError
from ..lhm.base.mesh import Floats, Ints
from .scene import Scene

FREE = 1e-9  # of the largest singular value, below which nothing holds a motion
WORK = 1e-9  # of a load's norm, below which it does no work on a motion


def check_restrained(scene: Scene, *, loads: Floats | None):
    """Raise SceneError for a rigid motion that nothing holds, naming it.

    With dead loads [mN], shape (scene vertices, 3), only one on which they do work counts: without it there is an
    equilibrium all the same, though its place is not determined.
    """
    for part, motions, free in _free_motions(scene):
        if loads is not None and free.shape[1]:
            work = np.einsum("vck,vc->k", motions @ free, loads[part])
            if np.abs(work).max() <= WORK * max(float(np.linalg.norm(loads[part])), 1e-300):
                continue
        if free.shape[1]:
            names = ", ".join(_names(free))
            raise SceneError(
                f"the scene is under-constrained: nothing holds {names} of the part with vertex {part[0]}; hold it by "
                "Fixed or Target"
            )


def has_free_motion(scene: Scene) -> bool:
    """Whether a rigid motion of any part is free."""
    return any(free.shape[1] for _, _, free in _free_motions(scene))


def _free_motions(scene: Scene) -> Iterator[tuple[Ints, Floats, Floats]]:
    """Yield each part's vertices (v,), rigid motions (v, 3, 6), and combinations (6, r) that nothing holds."""
    held = np.zeros(scene.vertices.shape, dtype=bool)
    for term in scene.terms:
        term.hold(scene, held)
    for part in _parts(scene):
        motions = _motions(scene.vertices[part])
        rows = np.concatenate([motions[held[part]], np.zeros((6, 6))])
        _, s, Vt = np.linalg.svd(np.linalg.qr(rows, mode="r"), full_matrices=False)
        yield part, motions, Vt[s <= FREE * max(s[0], 1e-300)].T


def _parts(scene: Scene) -> list[Ints]:
    """Gather the vertices that energies and bodies join to parts."""
    groups = [joined for term in scene.terms if (joined := term.element_vertices(scene)).size]
    if not groups:
        return []
    first = np.concatenate([np.repeat(group[:, 0], group.shape[1]) for group in groups])
    other = np.concatenate([group.ravel() for group in groups])
    n = len(scene.vertices)
    _, label = connected_components(coo_matrix((np.ones(len(first)), (first, other)), shape=(n, n)), directed=False)
    used = np.unique(other)
    return [used[label[used] == part] for part in np.unique(label[used])]


def _motions(X: Floats) -> Floats:
    """Return displacements of three translations and three rotations, of length about 1 each, shape (v, 3, 6)."""
    centred = X - X.mean(axis=0)
    centred = centred / max(np.sqrt(np.sum(centred**2) / len(X)), 1e-300)
    result = np.zeros((len(X), 3, 6))
    for c in range(3):
        result[:, c, c] = 1.0
        result[:, :, 3 + c] = np.cross(np.eye(3)[c], centred)
    return result / np.sqrt(len(X))


def _names(free: Floats) -> list[str]:
    """Name translations among the motions (6, r), then the axes of what else is left."""
    _, s, Vt = np.linalg.svd(free[3:], full_matrices=True)
    turning = int((s > 1e-6).sum())
    translations = free[:3] @ Vt[turning:].T
    rotations = free[3:] @ Vt[:turning].T
    return [f"translation along {axis}" for axis in _axes(translations)] + [
        f"rotation about {axis}" for axis in _axes(rotations)
    ]


def _axes(directions: Floats) -> list[str]:
    """Name a basis of the span of directions (3, k): x, y, z where they lie in it."""
    if not directions.shape[1]:
        return []
    basis = np.linalg.svd(directions, full_matrices=False)[0]
    inside = [c for c in range(3) if np.linalg.norm(basis[c]) > 1.0 - 1e-6]
    if len(inside) == basis.shape[1]:
        return ["xyz"[c] for c in inside]
    return [f"({v[0]:.2f}, {v[1]:.2f}, {v[2]:.2f})" for v in basis.T]
