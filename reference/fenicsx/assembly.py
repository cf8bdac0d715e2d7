"""The scene's stiffness matrix: its pattern over vertices, and blocks that are added to it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from ...lhm.mesh import Floats, Ints
from .dolfinx_version import COMM, PETSc


def _pattern(elements: list[Ints], n: int) -> csr_matrix:
    """Which of n vertices share an element, the diagonal included; sorted, shape (n, n)."""
    rows = [np.arange(n)] + [np.repeat(e, e.shape[1], axis=1).ravel() for e in elements]
    cols = [np.arange(n)] + [np.tile(e, (1, e.shape[1])).ravel() for e in elements]
    i, j = np.concatenate(rows), np.concatenate(cols)
    pattern = csr_matrix((np.ones(len(i), dtype=np.int8), (i, j)), shape=(n, n))
    pattern.sort_indices()
    return pattern


class BlockMatrix:
    """Element blocks over a fixed list of elements (m, k), summed and added to a PETSc matrix in one call."""

    def __init__(self, elements: Ints, n: int):
        pattern = _pattern([elements], n)
        self._indptr = pattern.indptr.astype(PETSc.IntType)
        self._indices = pattern.indices.astype(PETSc.IntType)
        keys = np.repeat(np.arange(n), np.diff(pattern.indptr)) * n + pattern.indices
        k = elements.shape[1]
        rows, cols = np.repeat(elements, k, axis=1), np.tile(elements, (1, k))
        self._slots = np.searchsorted(keys, (rows * n + cols).ravel())

    def add(self, blocks: Floats, into: PETSc.Mat):
        """Add blocks [mN/mm], shape (m, k, k, 3, 3), to a matrix with room for them."""
        entries = blocks.reshape(-1, 9)
        total = np.empty((len(self._indices), 9))
        for c in range(9):
            total[:, c] = np.bincount(self._slots, entries[:, c], minlength=len(total))
        into.setValuesBlockedIJV(self._indptr, self._indices, total, addv=PETSc.InsertMode.ADD_VALUES)


def stiffness_matrix(elements: list[Ints], n: int) -> PETSc.Mat:
    """A zero matrix of 3n rows in blocks of 3, with room for the coupling of every element's vertices."""
    pattern = _pattern(elements, n)
    matrix = PETSc.Mat().createAIJ(
        (3 * n, 3 * n), bsize=3, nnz=np.repeat(3 * np.diff(pattern.indptr), 3).astype(PETSc.IntType), comm=COMM
    )
    blocks = PETSc.LGMap().create(np.arange(n, dtype=PETSc.IntType), bsize=3, comm=COMM)
    matrix.setLGMap(blocks, blocks)
    matrix.setValuesBlockedIJV(
        pattern.indptr.astype(PETSc.IntType), pattern.indices.astype(PETSc.IntType), np.zeros(9 * pattern.nnz)
    )
    matrix.assemble()
    matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR, True)
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    return matrix


def rigid_motions(X: Floats) -> PETSc.NullSpace:
    """Three translations and three rotations of vertices X (n, 3), orthonormal: what multigrid has to keep."""
    n = len(X)
    basis = np.zeros((6, n, 3))
    centred = X - X.mean(axis=0)
    for c in range(3):
        basis[c, :, c] = 1.0
        a, b = (c + 1) % 3, (c + 2) % 3
        basis[3 + c, :, a], basis[3 + c, :, b] = -centred[:, b], centred[:, a]
    return null_space(basis)


def null_space(basis: Floats) -> PETSc.NullSpace:
    """What vectors (6, n, 3) span, made orthonormal."""
    orthonormal = np.linalg.qr(basis.reshape(len(basis), -1).T)[0]
    vectors = [
        PETSc.Vec().createWithArray(np.ascontiguousarray(column), bsize=3, comm=COMM) for column in orthonormal.T
    ]
    return PETSc.NullSpace().create(vectors=vectors, comm=COMM)
