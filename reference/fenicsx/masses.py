"""Mass of tissue and skin on an element's nodes: consistent with the shape functions, or lumped.

Lumped masses are the consistent diagonal, scaled to each element's mass: of linear elements equal shares, of quadratic
ones all positive, which row sums are not (Hinton, Rock and Zienkiewicz 1976).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.linalg import spsolve

from ...lhm.errors import SceneError
from ...lhm.mesh import Floats, Ints
from ..march import Motion
from . import dolfinx_version as seam
from .dolfinx_version import COMM, PETSc
from .membrane import quadratic_shapes
from .numbering import EDGES, Numbering


def mass_matrix(motion: Motion, order: Numbering) -> csr_matrix:
    """The masses of a march [kg] between nodes, shape (n, n), the same for each component.

    Raises SceneError for skin on a triangle that is no face of a tet.
    """
    scene, n = motion.scene, len(order.X)
    volume_mass = (motion.density * scene.volumes)[order.tet]
    parts = [(order.cell_dofs, volume_mass[:, None, None] * _tet_shares(order.degree))]
    if motion.skin_density.any():
        a, b, c = (scene.vertices[motion.skin[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
        shares = _triangle_shares(order.degree)
        parts.append((order.face_dofs("skin", motion.skin), (motion.skin_density * area)[:, None, None] * shares))
    total = csr_matrix((n, n))
    for nodes, blocks in parts:
        if motion.mass == "lumped":
            own = np.einsum("mkk->mk", blocks)
            own = own * (blocks.sum(axis=(1, 2)) / np.maximum(own.sum(axis=1), 1e-300))[:, None]
            total = total + diags(np.bincount(nodes.ravel(), own.ravel(), minlength=n))
            continue
        k = nodes.shape[1]
        rows, columns = np.repeat(nodes, k, axis=1).ravel(), np.tile(nodes, (1, k)).ravel()
        total = total + coo_matrix((blocks.ravel(), (rows, columns)), shape=(n, n)).tocsr()
    return csr_matrix(total)


def as_blocks(mass: csr_matrix, like: PETSc.Mat) -> PETSc.Mat:
    """A mass matrix (n, n) for all three components, in a matrix of the pattern of another one (3n, 3n).

    Raises SceneError where that pattern has no room.
    """
    matrix = like.duplicate(copy=False)
    matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR, True)
    mass = mass.copy()
    mass.eliminate_zeros()
    mass.sort_indices()
    blocks = (mass.data[:, None, None] * np.eye(3)).reshape(-1, 9)
    try:
        matrix.setValuesBlockedIJV(
            mass.indptr.astype(PETSc.IntType), mass.indices.astype(PETSc.IntType), blocks.ravel()
        )
    except PETSc.Error:
        raise SceneError("skin: a triangle is no face of a tet; consistent mass needs its edges") from None
    matrix.assemble()
    return matrix


def times(matrix: PETSc.Mat, values: Floats) -> Floats:
    """The product of a matrix (3n, 3n) with values by node, shape (n, 3)."""
    result = np.empty(values.size)
    matrix.mult(
        PETSc.Vec().createWithArray(np.ascontiguousarray(values).ravel(), comm=COMM),
        PETSc.Vec().createWithArray(result, comm=COMM),
    )
    return result.reshape(values.shape)


def _tet_shares(degree: int) -> Floats:
    """The integrals of N_a N_b over a tet, per volume, shape (k, k)."""
    points, weights = seam.quadrature_rule(2 * degree)
    barycentric = np.column_stack([1.0 - points.sum(axis=1), points])
    return _shares(barycentric if degree == 1 else _quadratic_tet(barycentric), weights)


def _quadratic_tet(barycentric: Floats) -> Floats:
    edges = 4.0 * barycentric[:, EDGES[:, 0]] * barycentric[:, EDGES[:, 1]]
    return np.column_stack([barycentric * (2.0 * barycentric - 1.0), edges])


def _triangle_shares(degree: int) -> Floats:
    """The integrals of N_a N_b over a triangle, per area, shape (k, k)."""
    points, weights = seam.quadrature_rule(2 * degree, "triangle")
    barycentric = np.column_stack([1.0 - points.sum(axis=1), points])
    return _shares(barycentric if degree == 1 else quadratic_shapes(barycentric)[0], weights)


def _shares(shapes: Floats, weights: Floats) -> Floats:
    return np.einsum("q,qa,qb->ab", weights / weights.sum(), shapes, shapes)


def accelerations(mass: csr_matrix, forces: Floats, free: np.ndarray) -> Floats:
    """M⁻¹ forces [mm/s²] at the free components of nodes that have mass, zero elsewhere, shape (n, 3)."""
    result = np.zeros_like(forces)
    heavy = mass.diagonal() > 0.0
    for c in range(3):
        nodes: Ints = np.flatnonzero(heavy & free[:, c])
        if nodes.size:
            result[nodes, c] = spsolve(mass[nodes][:, nodes].tocsc(), forces[nodes, c])
    return result
