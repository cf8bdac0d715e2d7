"""The scene's stiffness matrix: its pattern over vertices, and blocks that are added to it."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.sparse import csr_matrix

from ...lhm.mesh import Floats, Ints
from .dolfinx_version import COMM, PETSc


class Stiffness:
    """A matrix (3n, 3n) in 3x3 blocks with room for the coupling of every element's vertices, zero at first.

    PETSc's `matrix` and `values` are the same memory, so element blocks are summed where they belong, at the speed of
    memory.
    """

    def __init__(self, elements: list[Ints], n: int):
        pattern = _pattern(elements, n)
        count = np.diff(pattern.indptr)
        self.starts = pattern.indptr.astype(np.int64)
        self.columns = pattern.indices
        indptr = np.concatenate([[0], np.cumsum(np.repeat(3 * count, 3))]).astype(PETSc.IntType)
        indices = _three_rows(self.starts, self.columns).astype(PETSc.IntType)
        self.values: Floats = np.zeros(len(indices))
        self.matrix = PETSc.Mat().createAIJWithArrays((3 * n, 3 * n), (indptr, indices, self.values), comm=COMM)
        self.matrix.setBlockSize(3)
        blocks = PETSc.LGMap().create(np.arange(n, dtype=PETSc.IntType), bsize=3, comm=COMM)
        self.matrix.setLGMap(blocks, blocks)
        self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR, True)
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    def slots(self, elements: Ints) -> Ints:
        """Where the blocks of elements (m, k) are among those of the matrix, row by row, shape (m, k, k)."""
        return _found(self.starts, self.columns, elements)

    def places(self, nodes: Ints, starts: Ints, columns: Ints) -> Ints:
        """Where the values of a matrix over some of the vertices (k,) are among this one's, from its blocks' rows.

        Its rows of blocks start at `starts` (k + 1,), and have `columns`.
        """
        rows = np.repeat(np.arange(len(nodes)), np.diff(starts))
        pairs = np.column_stack([nodes[rows], nodes[columns]])
        slots = _found(self.starts, self.columns, pairs)[:, 0, 1]
        result = np.empty(9 * len(columns), dtype=np.int64)
        result[_nine(starts, rows, np.arange(len(rows)))] = _nine(self.starts, pairs[:, 0], slots)
        return result

    def clear(self):
        """Set all values to zero."""
        self.values[:] = 0.0
        self.touch()

    def add(self, elements: Ints, slots: Ints, blocks: Floats):
        """Add blocks [mN/mm], shape (m, k, k, 3, 3), of elements (m, k) with their slots."""
        _add_blocks(self.starts, elements, slots, blocks, self.values)
        self.touch()

    def touch(self):
        """Tell PETSc that `values` have changed."""
        self.matrix.stateIncrease()


def _nine(starts: Ints, rows: Ints, slots: Ints) -> Ints:
    """Where the nine values of blocks (k,) in slots of rows are, shape (k, 9)."""
    first = starts[rows]
    corner, width = 9 * first + 3 * (slots - first), 3 * (starts[rows + 1] - first)
    along = np.arange(9)
    return corner[:, None] + width[:, None] * (along // 3) + along % 3


def _pattern(elements: list[Ints], n: int) -> csr_matrix:
    """Which of n vertices share an element, the diagonal included; sorted, shape (n, n)."""
    rows = [np.arange(n)] + [np.repeat(e, e.shape[1], axis=1).ravel() for e in elements]
    cols = [np.arange(n)] + [np.tile(e, (1, e.shape[1])).ravel() for e in elements]
    i, j = np.concatenate(rows), np.concatenate(cols)
    pattern = csr_matrix((np.ones(len(i), dtype=np.int8), (i, j)), shape=(n, n))
    pattern.sort_indices()
    return pattern


@njit(cache=True)
def _three_rows(starts, columns):
    """The columns of the rows of numbers that rows of blocks are."""
    indices = np.empty(9 * len(columns), dtype=np.int64)
    for i in range(len(starts) - 1):
        width = 3 * (starts[i + 1] - starts[i])
        for s in range(starts[i], starts[i + 1]):
            for r in range(3):
                for c in range(3):
                    indices[9 * starts[i] + r * width + 3 * (s - starts[i]) + c] = 3 * columns[s] + c
    return indices


@njit(cache=True)
def _found(starts, columns, elements):
    m, k = elements.shape
    slots = np.empty((m, k, k), dtype=np.int32)
    for e in range(m):
        for a in range(k):
            i = elements[e, a]
            row = columns[starts[i] : starts[i + 1]]
            for b in range(k):
                slots[e, a, b] = starts[i] + np.searchsorted(row, elements[e, b])
    return slots


@njit(inline="always")
def place_of(starts, i, slot):
    """Where a slot of row i of the blocks begins in `values`, and how far one row of numbers is from the next."""
    first = starts[i]
    return 9 * first + 3 * (slot - first), 3 * (starts[i + 1] - first)


@njit(cache=True)
def _add_blocks(starts, elements, slots, blocks, values):
    m, k = elements.shape
    for e in range(m):
        for a in range(k):
            for b in range(k):
                at, width = place_of(starts, elements[e, a], slots[e, a, b])
                for r in range(3):
                    for c in range(3):
                        values[at + r * width + c] += blocks[e, a, b, r, c]


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
