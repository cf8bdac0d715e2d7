"""The scene's stiffness matrix: its pattern over vertices, and blocks that are added to it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats, Ints
from ..dolfinx_version import ALONE, MPI, PETSc
from ..mesh.parallel import IndexMap


class Stiffness:
    """A matrix (3n, 3n) in 3x3 blocks with room for the coupling of every element's nodes, zero at first.

    `local` is what this rank's elements add up to, over all nodes that it knows of. Its memory is `values`, so
    element blocks are summed where they belong, at the speed of memory. `matrix` is the sum of all ranks', each
    with the rows that it owns; alone it is the same as `local`.
    """

    def __init__(self, elements: list[Ints], nodes: IndexMap):
        self.nodes = nodes
        n = nodes.count
        rows = np.concatenate([np.arange(n), *(np.repeat(e, e.shape[1], axis=1).ravel() for e in elements)])
        columns = np.concatenate([np.arange(n), *(np.tile(e, (1, e.shape[1])).ravel() for e in elements)])
        pattern = csr_matrix((np.ones(len(rows), dtype=np.int8), (rows, columns)), shape=(n, n))
        pattern.sort_indices()
        count = np.diff(pattern.indptr)
        self.starts = pattern.indptr.astype(np.int64)
        self.columns = pattern.indices
        indptr = np.concatenate([[0], np.cumsum(np.repeat(3 * count, 3))]).astype(PETSc.IntType)
        indices = _three_rows(self.starts, self.columns).astype(PETSc.IntType)
        self.values: Floats = np.zeros(len(indices))
        self.local = PETSc.Mat().createAIJWithArrays((3 * nodes.count,) * 2, (indptr, indices, self.values), comm=ALONE)
        self.local.setBlockSize(3)
        blocks = PETSc.LGMap().create(np.arange(nodes.count, dtype=PETSc.IntType), bsize=3, comm=ALONE)
        self.local.setLGMap(blocks, blocks)
        self.matrix = self.local if nodes.comm.size == 1 else self._distribute()
        for matrix in (self.local, self.matrix):
            matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
            matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_LOCATION_ERR, True)
            matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    def _distribute(self) -> PETSc.Mat:
        """The sum of all ranks' `local`, which PETSc keeps as one matrix of parts."""
        nodes, order = self.nodes, self.nodes.local_map()
        sizes = ((3 * nodes.owned, 3 * nodes.total),) * 2
        self._parts = PETSc.Mat().create(comm=nodes.comm)
        self._parts.setSizes(sizes, bsize=3)
        self._parts.setType(PETSc.Mat.Type.IS)
        self._parts.setLGMap(order, order)
        self._parts.setISLocalMat(self.local)
        self._parts.assemble()
        return self._parts.convert("aij", PETSc.Mat())

    def assemble(self) -> PETSc.Mat:
        """The matrix of all ranks, from what each has added since `clear`."""
        self.local.assemble()
        if self.matrix is not self.local:
            self._parts.assemble()
            self._parts.convert("aij", self.matrix)
        return self.matrix

    def slots(self, elements: Ints) -> Ints:
        """Where the blocks of elements (m, k) are among those of the matrix, row by row, shape (m, k, k)."""
        return _find_slots(self.starts, self.columns, elements)

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
        self.local.stateIncrease()


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
def _find_slots(starts, columns, elements):
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


def add_forces(nodes: Ints, forces: Floats, into: Floats):
    """Add forces [mN], shape (m, k, 3), at elements' nodes (m, k) to an array by node (n, 3)."""
    for c in range(3):
        into[:, c] += np.bincount(nodes.ravel(), forces[:, :, c].ravel(), minlength=len(into))


def skew(v: Floats) -> Floats:
    """The matrices of w -> v × w, shape (..., 3, 3), of vectors (..., 3)."""
    matrices = np.zeros((*v.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrices[..., k, j], matrices[..., j, k] = v[..., i], -v[..., i]
    return matrices


def rigid_motions(X: Floats, comm: MPI.Intracomm) -> PETSc.NullSpace:
    """Three translations and three rotations of nodes X (n, 3), orthonormal: what multigrid has to keep."""
    n = len(X)
    basis = np.zeros((6, n, 3))
    centred = X - comm.allreduce(X.sum(axis=0)) / comm.allreduce(n)
    for c in range(3):
        basis[c, :, c] = 1.0
        a, b = (c + 1) % 3, (c + 2) % 3
        basis[3 + c, :, a], basis[3 + c, :, b] = -centred[:, b], centred[:, a]
    return null_space(basis, comm)


def null_space(basis: Floats, comm: MPI.Intracomm) -> PETSc.NullSpace:
    """Make the null space of vectors (6, n, 3), orthonormal by Cholesky's factor of their products, twice."""
    vectors = basis.reshape(len(basis), -1)
    for _ in range(2):
        vectors = np.linalg.solve(np.linalg.cholesky(comm.allreduce(vectors @ vectors.T)), vectors)
    made = [PETSc.Vec().createWithArray(np.ascontiguousarray(row), bsize=3, comm=comm) for row in vectors]
    return PETSc.NullSpace().create(vectors=made, comm=comm)
