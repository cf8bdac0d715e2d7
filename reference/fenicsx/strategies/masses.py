"""Mass of tissue and skin on an element's nodes: consistent with the shape functions, or lumped.

Lumped masses are the consistent diagonal, scaled to each element's mass: of linear elements equal shares, of quadratic
ones all positive, which row sums are not (Hinton, Rock and Zienkiewicz 1976).
"""

from __future__ import annotations

import numpy as np

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import Floats, Ints
from ...march import Motion
from .. import dolfinx_version as seam
from ..dolfinx_version import PETSc
from ..energy.assembly import Stiffness
from ..linear.solvers import Mumps, hold, multiply
from ..mesh.numbering import Numbering
from ..mesh.parallel import anywhere


def mass_matrix(motion: Motion, numbering: Numbering, stiffness: Stiffness) -> PETSc.Mat:
    """The masses of a march [kg] between nodes, the same for each component, in the pattern of a stiffness matrix.

    Raises SceneError for skin whose consistent mass lies on a triangle that is no face of a tet.
    """
    scene = motion.scene
    volume_mass = (motion.density * scene.volumes)[numbering.tet]
    parts = [(numbering.cell_dofs, volume_mass[:, None, None] * _shares(numbering.degree, "tetrahedron"))]
    if motion.skin_density.any():
        here, nodes = numbering.faces("skin", motion.skin)
        a, b, c = (scene.vertices[motion.skin[here, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
        mass = motion.skin_density[here] * area
        parts.append((nodes, mass[:, None, None] * _shares(numbering.degree, "triangle")))
    stiffness.clear()
    for nodes, blocks in parts:
        if motion.mass == "lumped":
            own = np.einsum("mkk->mk", blocks)
            own = own * (blocks.sum(axis=(1, 2)) / np.maximum(own.sum(axis=1), 1e-300))[:, None]
            nodes, blocks = nodes.reshape(-1, 1), own.reshape(-1, 1, 1)
        elif anywhere(numbering.comm, ~stiffness.has_room(nodes)):
            raise SceneError("skin: a triangle is no face of a tet; consistent mass needs its edges")
        stiffness.add(nodes, stiffness.slots(nodes), blocks[..., None, None] * np.eye(3))
    return stiffness.assemble().copy()


def times(matrix: PETSc.Mat, values: Floats) -> Floats:
    """The product of a matrix (3n, 3n) with a vector (owned, 3)."""
    return multiply(matrix, np.ascontiguousarray(values).ravel()).reshape(values.shape)


def _shares(degree: int, cell: str) -> Floats:
    """The integrals of N_a N_b over a cell, per volume or area, shape (k, k)."""
    points, weights = seam.quadrature_rule(2 * degree, cell)
    shapes = seam.shapes(degree, points, cell)[0]
    return np.einsum("q,qa,qb->ab", weights / weights.sum(), shapes, shapes)


def accelerations(mass: PETSc.Mat, forces: Floats, free: np.ndarray) -> Floats:
    """M⁻¹ forces [mm/s²] at the free components of nodes that have mass, zero elsewhere, a vector (owned, 3)."""
    heavy = mass.getDiagonal().array_r.reshape(forces.shape) > 0.0
    still: Ints = np.flatnonzero(~(heavy & free))
    matrix, b = mass.copy(), np.array(forces).ravel()
    hold(matrix, still, np.zeros(len(still)), b)
    return Mumps(matrix).solve(b, relative=0.0).x.reshape(forces.shape)
