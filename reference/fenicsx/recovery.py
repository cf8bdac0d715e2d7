"""Stresses and reactions of an answer on finite elements: P at the points of the rule, and the gradient where held.

Any process may ask for them, alone: it integrates over the whole mesh once. For a scene in parts all ask together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..scene import Scene
from ..solution import Stresses
from .dolfinx_version import ALONE
from .numbering import Numbering
from .problem import Problem
from .scope import processes_for


@dataclass(frozen=True, eq=False)
class Nodal:
    """An answer by node, of all processes.

    Ends (n, 2) of nodes, displacement [mm] (n, 3), a force beside loads [mN] with the ends of its nodes, and a mixed
    element's pressure [kPa] by scene vertex.
    """

    ends: Ints
    u: Floats
    force: tuple[Ints, Floats] | None
    pressure: Floats | None


def recover(scene: Scene, degree: int, answer: Nodal) -> Stresses:
    """The stresses and reactions of an answer to a scene, by elements of a degree."""
    numbering = Numbering(scene, degree, comm=processes_for(scene) if scene.in_parts else ALONE)
    node, pressure = numbering.nodes_between(answer.ends), answer.pressure
    problem = Problem(scene, numbering, mixed=pressure is not None)
    if answer.force is not None:
        problem.loads[numbering.nodes_between(answer.force[0])] += answer.force[1]
    u = np.empty_like(numbering.X)
    u[node] = answer.u
    state = problem.at(u, None if pressure is None else pressure[problem.pressure_vertex])
    F, P, points = state.stresses()
    m, q = len(scene.tets), points.per_cell
    P_of, F_of, volume = np.zeros((m, q, 3, 3)), np.tile(np.eye(3), (m, q, 1, 1)), np.ones((m, q))
    tets = numbering.tet[points.cells]
    P_of[tets], F_of[tets] = P.reshape(-1, q, 3, 3), F.reshape(-1, q, 3, 3)
    volume[tets] = points.volume.reshape(-1, q)
    return Stresses.from_points(P_of, F_of, volume, _reactions(scene, numbering, state.gradient()))


def _reactions(scene: Scene, numbering: Numbering, gradient: Floats) -> Floats:
    """The gradient [mN] at held components by vertex, shape (n, 3); an edge's node gives half to each of its ends."""
    nodes = numbering.nodes
    forces = np.where(numbering.held(scene.dirichlet()[0])[: nodes.owned], gradient, 0.0)
    shares = np.zeros(numbering.X.shape)
    for end in numbering.ends[: nodes.owned].T:
        np.add.at(shares, numbering.dof[end], 0.5 * forces)
    return numbering.to_scene(nodes.spread(nodes.summed(shares)), np.zeros(scene.vertices.shape))
