"""The PD matrix A = Σ w G Gᵀ over the unknowns, and its factorisation: the global step, and a preconditioner."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from ....lhm.base.errors import SceneError
from ....lhm.base.geometry.cholesky import factorise_definite
from ....lhm.base.mesh import Floats, Ints
from .coordinates import Body, Coordinates

Solver = Callable[[Floats], Floats]

# Relative diagonal shift of parts that nothing holds, whose matrix is singular. It changes the steps, not the answer.
SHIFT = 1e-7


@dataclass(frozen=True, eq=False)
class Group:
    """One factorisation, of the free vertices of components (of x, y, z) that are held at the same vertices.

    `loose` (n,) numbers the parts that nothing holds, -1 elsewhere. With W the affine motions of all bodies, `carried`
    is A_ff⁻¹ A_fb W, shape (free, 4 bodies), and `body` the Schur complement Wᵀ (A_bb - A_bf A_ff⁻¹ A_fb) W.
    """

    components: Ints
    solver: Solver
    loose: Ints
    carried: Floats
    body: Floats


@dataclass(frozen=True, eq=False)
class System:
    """A⁻¹ on the unknowns, one factorisation per different set of held vertices; bodies cost a small dense solve."""

    coordinates: Coordinates
    groups: tuple[Group, ...]

    @classmethod
    def from_matrix(cls, matrix: csr_matrix, anchored: np.ndarray, coordinates: Coordinates) -> System:
        """Factor the matrix (n, n) [mN/mm], given the vertices that a Target holds (n,)."""
        _, part = connected_components(_join(matrix, coordinates.bodies), directed=False)
        groups = []
        for components, free in coordinates.groups:
            is_tied = np.zeros(part.max() + 1, dtype=bool)
            is_tied[part[anchored | coordinates.held[:, components[0]]]] = True
            loose = np.where(is_tied[part], -1, part)
            rows = matrix[free]
            reduced = rows[:, free]
            diagonal = reduced.diagonal()
            shift = np.where(loose[free] >= 0, SHIFT * diagonal, 0.0)
            shift[diagonal == 0] = 1.0
            reduced.setdiag(diagonal + shift)
            solver: Solver = np.copy
            if len(free):
                solver = factorise_definite(reduced.tocsc())
            groups.append(Group(components, solver, loose, *_schur(matrix, rows, solver, coordinates.bodies)))
        return cls(coordinates, tuple(groups))

    def check_loads(self, loads: Floats):
        """Raise SceneError for a part that nothing holds although forces [mN], shape (n, 3), push it somewhere."""
        for group in self.groups:
            loose = group.loose >= 0
            if not loose.any():
                continue
            for c in group.components:
                net = np.bincount(group.loose[loose], loads[loose, c])
                size = np.bincount(group.loose[loose], np.abs(loads[loose, c]))
                bad = np.flatnonzero(np.abs(net) > 1e-9 * size)
                if bad.size:
                    vertex = np.flatnonzero(group.loose == bad[0])[0]
                    raise SceneError(
                        f"nothing holds the part around vertex {vertex} along {'xyz'[c]}, where loads of "
                        f"{net[bad[0]]:.3g} mN push it: add Fixed or Target, or balance the loads"
                    )

    def solve(self, gradient: Floats, rotations: Floats) -> Floats:
        """Apply A⁻¹ to a gradient over the unknowns, shape (size,), where the bodies have these rotations."""
        step = np.empty_like(gradient)
        begin = 0
        blocks = []
        for group, (components, free) in zip(self.groups, self.coordinates.groups, strict=True):
            block = slice(begin, begin + len(free) * len(components))
            blocks.append((group, block, (len(free), len(components))))
            step[block] = group.solver(gradient[block].reshape(len(free), -1)).ravel() if len(free) else 0.0
            begin = block.stop
        if self.coordinates.bodies:
            motions = self.coordinates.affine_motions(rotations)
            right = gradient[begin:].copy()
            matrix = np.zeros((len(right), len(right)))
            for group, block, shape in blocks:
                for c, force in zip(
                    group.components, (group.carried.T @ gradient[block].reshape(shape)).T, strict=True
                ):
                    right -= motions[c].T @ force
                    matrix += motions[c].T @ group.body @ motions[c]
            step[begin:] = _solve(matrix, right)
            for group, block, shape in blocks:
                moved = np.stack([motions[c] @ step[begin:] for c in group.components], axis=1)
                step[block].reshape(shape)[:] -= group.carried @ moved
        return step


def _join(matrix: csr_matrix, bodies: tuple[Body, ...]) -> csr_matrix:
    """Add entries between the vertices of each body to the matrix, to tell what hangs together."""
    none = np.empty(0, dtype=np.int64)
    first = np.concatenate([none, *(np.repeat(body.vertices[0], len(body.vertices)) for body in bodies)])
    other = np.concatenate([none, *(body.vertices for body in bodies)])
    links = coo_matrix((np.ones(len(other)), (first, other)), shape=matrix.shape)
    joined = abs(matrix) + links.tocsr()
    joined.eliminate_zeros()
    return joined


def _schur(matrix: csr_matrix, rows: csr_matrix, solver: Solver, bodies: tuple[Body, ...]) -> tuple[Floats, Floats]:
    """Compute `Group.carried` and `Group.body`, for the rows of the matrix that belong to free vertices."""
    affine = np.zeros((matrix.shape[0], 4 * len(bodies)))
    for b, body in enumerate(bodies):
        affine[body.vertices, 4 * b : 4 * b + 4] = body.affine
    pulling = rows @ affine
    carried = solver(pulling) if pulling.size else pulling
    return carried, affine.T @ (matrix @ affine) - pulling.T @ carried


def _solve(matrix: Floats, right: Floats) -> Floats:
    """Solve the bodies' small system, shifted as what nothing holds is, and scaled to a unit diagonal."""
    diagonal = np.diag(matrix)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    scaled = matrix * scale * scale[:, None] + SHIFT * np.eye(len(matrix))
    return scale * cho_solve(cho_factor(scaled), scale * right)
