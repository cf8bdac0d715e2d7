"""Linear solvers whose matrix is spread over the processes that mpirun has started, in runs of rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...lhm.mesh import Floats, Ints
from ..ranks import Remote, Team, team
from .dolfinx_version import MPI, PETSc
from .linear import LINEAR_SOLVERS, LinearAnswer, LinearSolver

FEW = 3000  # rows, below which spreading them costs more than it saves


def solver_of(kind: str, matrix: PETSc.Mat) -> LinearSolver:
    """The linear solver of a name for a matrix of this process, spread over those that mpirun has started, if any."""
    others = team()
    if others is None or matrix.getSize()[0] < max(FEW, 3 * others.size):
        return LINEAR_SOLVERS[kind](matrix)
    return SpreadSolver(kind, matrix, others)


class SpreadSolver:
    """A linear solver that sends every process its run of rows of the matrix, and collects its run of the answer."""

    def __init__(self, kind: str, matrix: PETSc.Mat, team: Team):
        self._kind, self._matrix, self._team = kind, matrix, team
        self._cuts: list[tuple[slice, slice]] | None = None

    def solve(self, b: Floats, *, relative: float) -> LinearAnswer:
        """See LinearSolver."""
        indptr, indices, values = self._matrix.getValuesCSR()
        if not (np.isfinite(values).all() and np.isfinite(b).all()):
            return LinearAnswer(np.zeros_like(b), False, 0, "not finite")
        if self._cuts is None:
            self._spread(indptr, indices)
        assert self._cuts is not None
        (mine, entries), *others = [(rows, entries) for rows, entries in self._cuts]
        with self._remote.together("solve", [(values[e], b[r], relative) for r, e in others]) as answers:
            first = self._part.solve(values[entries], b[mine], relative)
        return replace(first, x=np.concatenate([first.x, *(answer.x for answer in answers)]))

    def _spread(self, indptr: Ints, indices: Ints):
        rows = len(indptr) - 1
        nearest = np.searchsorted(indptr, np.linspace(0, indptr[-1], self._team.size + 1))
        bounds = 3 * np.round(nearest / 3).astype(int)
        bounds[-1] = rows
        motions = np.stack([vector.array_r for vector in self._matrix.getNearNullSpace().getVecs()] or [np.empty(rows)])
        parts, cuts = [], []
        for a, b in zip(bounds[:-1], bounds[1:], strict=True):
            entries = slice(indptr[a], indptr[b])
            parts.append((self._kind, rows, indptr[a : b + 1] - indptr[a], indices[entries], motions[:, a:b]))
            cuts.append((slice(a, b), entries))
        with self._team.making(Rows, parts[1:]) as remote:
            self._part = Rows(*parts[0])
        self._remote: Remote = remote
        self._cuts = cuts


class Rows:
    """One process' run of rows of a symmetric matrix that all of them hold, and the solver that they share.

    `indptr` counts from the run's first row; `motions` (k, rows of the run) span the near-null space.
    """

    def __init__(self, kind: str, total: int, indptr: Ints, indices: Ints, motions: Floats):
        comm = MPI.COMM_WORLD
        self._indptr, self._indices = indptr, indices
        size = (len(indptr) - 1, total)
        self._matrix = PETSc.Mat().createAIJ(
            (size, size), bsize=3, csr=(indptr, indices, np.zeros(len(indices))), comm=comm
        )
        self._matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        if motions.shape[0] == 6:
            vectors = [PETSc.Vec().createWithArray(np.ascontiguousarray(m), bsize=3, comm=comm) for m in motions]
            self._matrix.setNearNullSpace(PETSc.NullSpace().create(vectors=vectors, comm=comm))
        self._solver = LINEAR_SOLVERS[kind](self._matrix)

    def solve(self, values: Floats, b: Floats, relative: float) -> LinearAnswer:
        """Solve with the matrix' values of the run and b's; the answer's x is the run's."""
        self._matrix.setValuesCSR(self._indptr, self._indices, values)
        self._matrix.assemble()
        return self._solver.solve(np.ascontiguousarray(b), relative=relative)
