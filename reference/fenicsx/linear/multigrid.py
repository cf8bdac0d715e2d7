"""Multigrid on the displacement's matrix: PETSc's GAMG, and above it levels that the mesh itself offers.

Quadratic tets have linear ones below them, and sub-layers the layers that they divide: where flat prisms lie in
columns, coupling is strong through them, and coarsening there first leaves GAMG a problem that it likes (Trottenberg,
Oosterlee and Schüller 2001, "Multigrid", Section 5.1). A level's matrix is Pᵀ A P.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ..dolfinx_version import MPI, PETSc
from ..energy.assembly import rigid_motions
from ..mesh.numbering import Numbering
from ..mesh.parallel import anywhere

# The default estimate of the smoother's eigenvalues is too low at large strain: it turns the preconditioner indefinite,
# and Newton stalls without a word.
GAMG = {
    "pc_gamg_aggressive_coarsening": 2,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_pc_type": "jacobi",
    "mg_levels_esteig_ksp_max_it": 30,
    "mg_levels_ksp_chebyshev_esteig": "0,0.1,0,1.2",
}
# Where no level above has taken the strong couplings: aggregates leave out weak ones, and a third step relaxes down to
# a twentieth of the largest eigenvalue. A head whose jaw is opened by its bone takes half the iterations.
ALONE = GAMG | {
    "pc_gamg_threshold": 0.005,
    "mg_levels_ksp_max_it": 3,
    "mg_levels_ksp_chebyshev_esteig": "0,0.05,0,1.1",
}
# PETSc's SOR relaxes a node's three unknowns together.
_LEVELS = {
    "pc_mg_galerkin": "none",
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "sor",
    "mg_coarse_ksp_type": "preonly",
    "mg_coarse_pc_type": "gamg",
    **{f"mg_coarse_{key}": value for key, value in GAMG.items()},
}
_FORWARD = {"mg_levels_pc_sor_local_forward": None}


@dataclass(frozen=True, eq=False)
class CoarseLevel:
    """A level of multigrid; the nodes of the level above lie at its own nodes or between two of them.

    `parents` (n, 2) are those two, by numbers over all ranks, of each node above that this rank owns, and `weights`
    (n, 2) their shares; `kept` (k,) are the nodes above that are nodes here too, and `X` [mm], shape (k, 3), lie there.
    """

    parents: Ints
    weights: Floats
    kept: Ints
    X: Floats

    def prolongation(self, comm: MPI.Intracomm) -> PETSc.Mat:
        """Make the matrix that takes displacements from this level to the one above, where nothing is held."""
        n, coarse = len(self.parents), comm.allreduce(len(self.kept))
        component = np.arange(3)
        columns = (3 * self.parents[:, None, :] + component[:, None]).ravel()
        values = np.repeat(self.weights[:, None, :], 3, axis=1).ravel()
        P = csr_matrix((values, columns, np.arange(0, 6 * n + 1, 2)), shape=(3 * n, 3 * coarse))
        P.sum_duplicates()
        parts = P.indptr.astype(PETSc.IntType), P.indices.astype(PETSc.IntType), P.data
        sizes = (3 * n, PETSc.DETERMINE), (3 * len(self.kept), 3 * coarse)
        matrix = PETSc.Mat().createAIJ(sizes, bsize=3, csr=parts, comm=comm)
        matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        return matrix


def find_levels(numbering: Numbering, scene: Scene) -> list[CoarseLevel]:
    """Find the levels below a numbering's nodes, finest first: vertices below edges, ends of the scene's columns."""
    levels = []
    if numbering.degree == 2:
        levels.append(_keep_vertices(numbering))
    if scene.columns:
        check_columns(scene)
        levels.append(_keep_ends(numbering, scene))
    return levels


def _keep_vertices(numbering: Numbering) -> CoarseLevel:
    """Linear tets below quadratic ones."""
    nodes = numbering.nodes
    kept = numbering.own_corners
    number = np.zeros((nodes.owned, 3))
    before = sum(nodes.comm.allgather(len(kept))[: nodes.comm.rank])
    number[kept] = before + np.arange(len(kept))[:, None]
    number = nodes.spread(number)[:, 0].astype(np.int64)
    parents = number[numbering.dof[numbering.ends[: nodes.owned]]]
    return CoarseLevel(parents, np.full(parents.shape, 0.5), kept, numbering.X[kept])


def _keep_ends(numbering: Numbering, scene: Scene) -> CoarseLevel:
    """Tets from end to end of columns below their sub-layers; displacements inside are linear by length."""
    ends = np.tile(np.arange(len(scene.vertices))[:, None], 2)
    weights = np.full(ends.shape, 0.5)
    for column in scene.columns:
        steps = np.linalg.norm(np.diff(scene.vertices[column], axis=1), axis=2)
        share = np.cumsum(steps, axis=1)[:, :-1] / steps.sum(axis=1, keepdims=True)
        inside = column[:, 1:-1]
        ends[inside] = column[:, None, [0, -1]]
        weights[inside] = np.stack([1.0 - share, share], axis=2)
    is_kept = ends[:, 0] == ends[:, 1]
    number = np.full(len(ends), -1, dtype=np.int64)
    everywhere = numbering.all_vertices[is_kept[numbering.all_vertices]]
    number[everywhere] = np.arange(len(everywhere))
    mine = numbering.own_vertices
    kept = np.flatnonzero(is_kept[mine])
    return CoarseLevel(number[ends[mine]], weights[mine], kept, scene.vertices[mine[kept]])


def check_columns(scene: Scene):
    """Raise SceneError for a column with two neighbours, by index, that are no edge of a tet."""
    n = len(scene.vertices)
    pairs = np.sort(scene.tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]], axis=2)
    edges = np.unique(pairs @ [n, 1])
    for position, column in enumerate(scene.columns):
        steps = np.sort(np.stack([column[:, :-1], column[:, 1:]], axis=2), axis=2) @ [n, 1]
        wrong = np.argwhere(~np.isin(steps, edges))
        if len(wrong):
            row, at = wrong[0]
            raise SceneError(
                f"columns {position}: row {row}: vertices {column[row, at]} and {column[row, at + 1]}, which follow "
                "each other, are no edge of a tet"
            )


class _Transfer:
    """The step from a matrix to that of a level below it, both with room for other values."""

    def __init__(self, level: CoarseLevel, comm: MPI.Intracomm):
        self._level, self._comm = level, comm
        self._unheld = level.prolongation(comm)
        self.P = self._unheld.duplicate(copy=True)
        self._held = np.zeros(3 * len(level.parents), dtype=bool)
        self.coarse: PETSc.Mat | None = None

    def project(self, fine: PETSc.Mat) -> PETSc.Mat:
        """Give Pᵀ A P of a matrix, whose held dofs neither follow others nor move them."""
        held = find_decoupled(fine)
        if anywhere(self._comm, held != self._held):
            self._hold(held)
        if self.coarse is None:
            self.coarse = fine.ptap(self.P)
            self.coarse.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.coarse.setNearNullSpace(rigid_motions(self._level.X, self._comm))
        else:
            fine.ptap(self.P, result=self.coarse)
        return self.coarse

    def _hold(self, held: np.ndarray):
        """Make P for held dofs (n,): each keeps its own entry alone."""
        self._held, kept = held, self._level.kept
        below = held.reshape(-1, 3)[kept].ravel()
        self._unheld.copy(self.P, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        rows, columns = self.P.createVecs(side="left"), self.P.createVecs(side="right")
        rows.array[:], columns.array[:] = ~held, ~below
        self.P.diagonalScale(rows, columns)
        own = np.flatnonzero(below)
        above = (3 * kept[:, None] + np.arange(3)).ravel()[own]
        first_row, first_column = self.P.getOwnershipRange()[0], self.P.getOwnershipRangeColumn()[0]
        starts, rows_kept, columns_kept = np.arange(len(own) + 1), first_row + above, first_column + own
        indices = (each.astype(PETSc.IntType) for each in (starts, columns_kept))
        self.P.setValuesIJV(*indices, np.ones(len(own)), rowmap=rows_kept.astype(PETSc.IntType))
        self.P.assemble()


def find_decoupled(matrix: PETSc.Mat) -> np.ndarray:
    """Find the rows of this rank, shape (k,), in which nothing but the diagonal differs from zero, as where held."""
    x, y = matrix.createVecs()
    first, last = matrix.getOwnershipRange()
    x.array[:] = np.cos(np.arange(first, last))  # of no regularity: no sum of others vanishes
    matrix.mult(x, y)
    return y.array_r == matrix.getDiagonal().array_r * x.array_r


class Multigrid:
    """Sets up a preconditioner for a matrix, whose values change, on levels below it.

    CG needs one that is `symmetric`. Without, levels relax forwards alone: GMRES takes a sixth more iterations, each
    in three quarters of the time.
    """

    def __init__(self, matrix: PETSc.Mat, levels: Sequence[CoarseLevel] = (), *, symmetric: bool = True):
        self._matrix, self._options = matrix, _LEVELS if symmetric else _LEVELS | _FORWARD
        self._transfers = [_Transfer(level, matrix.comm.tompi4py()) for level in levels]

    def set_up(self, pc: PETSc.PC):
        """Take the matrix' present values; PETSc does what follows at the next solve by `pc`, a new one or the same."""
        matrices = [self._matrix]
        for transfer in self._transfers:
            matrices.append(transfer.project(matrices[-1]))
        if pc.getType() not in (PETSc.PC.Type.MG, PETSc.PC.Type.GAMG):
            self._configure(pc, matrices)

    def _configure(self, pc: PETSc.PC, matrices: list[PETSc.Mat]):
        coarsest = len(matrices) - 1
        kind = PETSc.PC.Type.MG if coarsest else PETSc.PC.Type.GAMG
        set_options(pc.getOptionsPrefix(), {"pc_type": kind, **(self._options if coarsest else ALONE)})
        pc.setType(kind)
        if coarsest:
            pc.setMGLevels(len(matrices))
            for step, transfer in enumerate(self._transfers):
                pc.setMGInterpolation(coarsest - step, transfer.P)
            for step, matrix in enumerate(matrices):
                pc.getMGSmoother(coarsest - step).setOperators(matrix)
        pc.setFromOptions()


def set_options(prefix: str, values: Mapping[str, object]):
    """Put options into PETSc's database, each marked as used: PETSc warns of unused ones at its end."""
    options = PETSc.Options()
    for key, value in values.items():
        options[prefix + key] = value
        options.hasName(prefix + key)
