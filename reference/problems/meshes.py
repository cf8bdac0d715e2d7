"""Meshes of verification problems: boxes of cells split into tets, and the faces of their boundary."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from ...lhm.base.mesh import FACES, Floats, Ints, tet_volumes


def box(cells: tuple[int, int, int], lengths: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> tuple[Floats, Ints]:
    """Vertices [mm] and tets of [0, lengths] in cells of six tets each (Kuhn's triangulation, one per axis order)."""
    shape = np.array(cells) + 1
    grid = np.stack(np.meshgrid(*[np.arange(k) for k in shape], indexing="ij"), axis=-1).reshape(-1, 3)
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    first = grid[(grid < np.array(cells)).all(axis=1)] @ strides
    tets = []
    for order in permutations(range(3)):
        walk = np.concatenate([[0], np.cumsum(strides[list(order)])])
        tets.append(first[:, None] + walk)
    X = grid * (np.array(lengths) / np.array(cells))
    return X, positive(X, np.stack(tets, axis=1).reshape(-1, 4))


def block(cells: int, size: float = 1.0) -> tuple[Floats, Ints]:
    """A cube [mm] of cells³ cells."""
    return box((cells,) * 3, (size,) * 3)


def unstructured(cells: int, size: float = 1.0, *, seed: int = 0) -> tuple[Floats, Ints]:
    """A cube whose interior vertices are moved by up to a fifth of a cell, so that no two tets are alike."""
    X, tets = block(cells, size)
    inside = np.setdiff1d(np.arange(len(X)), boundary_triangles(tets))
    X[inside] += np.random.default_rng(seed).uniform(-0.2, 0.2, (len(inside), 3)) * size / cells
    return X, tets


def boundary_triangles(tets: Ints) -> Ints:
    """The triangles that belong to one tet only, shape (k, 3), counter-clockwise from outside."""
    faces = tets[:, FACES].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[first[count == 1]]


def triangles_at(X: Floats, tets: Ints, axis: int, position: float) -> Ints:
    """The boundary's triangles in the plane where coordinate `axis` is `position` [mm], shape (k, 3)."""
    triangles = boundary_triangles(tets)
    return triangles[np.isclose(X[triangles, axis], position).all(axis=1)]


def vertices_at(X: Floats, axis: int, position: float) -> Ints:
    """The vertices in the plane where coordinate `axis` is `position` [mm], shape (k,)."""
    return np.flatnonzero(np.isclose(X[:, axis], position))


def principal_stretches(X: Floats, x: Floats, tets: Ints) -> Floats:
    """The singular values of each tet's F from rest X to x [mm], largest first, shape (m, 3)."""
    rest, edges = ((p[tets][:, 1:] - p[tets][:, :1]).transpose(0, 2, 1) for p in (X, x))
    return np.linalg.svd(edges @ np.linalg.inv(rest), compute_uv=False)


def twist(X: Floats, angle: float) -> Floats:
    """Positions [mm] of a box from x = 0 on, its sections along x turned about its axis, the last by `angle` [rad]."""
    turned = angle * X[:, 0] / X[:, 0].max()
    middle = X[:, 1:].max(axis=0) / 2.0
    y, z = (X[:, 1:] - middle).T
    across = np.cos(turned) * y - np.sin(turned) * z, np.sin(turned) * y + np.cos(turned) * z
    return np.column_stack([X[:, 0], middle[0] + across[0], middle[1] + across[1]])


def positive(X: Floats, tets: Ints) -> Ints:
    """Tets (m, 4) with two corners exchanged where that makes the volume positive; changes them in place."""
    inverted = tet_volumes(X, tets) < 0
    tets[inverted] = tets[inverted][:, [0, 1, 3, 2]]
    return tets
