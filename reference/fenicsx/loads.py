"""Dead loads on an element's nodes: integrals of its shape functions over tets and triangles."""

from __future__ import annotations

import numpy as np

from ...lhm.mesh import Floats
from ..scene import Scene
from ..terms import Gravity, Traction
from .numbering import CELL_SHARES, FACE_SHARES, Numbering


def dead_loads(scene: Scene, order: Numbering) -> Floats:
    """Forces [mN] of Gravity and Traction, a vector (owned, 3); exact, and of degree 1 the scene's lumped ones."""
    forces = np.zeros(order.X.shape)
    for term in scene.of(Gravity):
        tets = scene.tets_of(term)
        weight = np.broadcast_to(term.density, tets.shape) * scene.volumes[tets]
        cells = order.cell[tets]
        nodes = order.cell_dofs[cells[cells >= 0]]
        shares = np.outer(weight[cells >= 0], CELL_SHARES[order.degree])
        forces += np.bincount(nodes.ravel(), shares.ravel(), minlength=len(forces))[:, None] * term.acceleration
    for term in scene.of(Traction):
        if not term.triangles.size:
            continue
        here, nodes = order.faces(term.name, term.triangles)
        a, b, c = (scene.vertices[term.triangles[here, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
        shares = np.outer(area, FACE_SHARES[order.degree])
        forces += np.bincount(nodes.ravel(), shares.ravel(), minlength=len(forces))[:, None] * term.vector
    return order.nodes.summed(forces)
