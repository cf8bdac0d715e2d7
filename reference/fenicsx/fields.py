"""An answer inside the tets: its functions at quadrature points, its stresses, and the reactions where it is held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats, Ints
from ..scene import Scene
from ..solution import Stresses
from . import dolfinx_version as seam
from .energy.assembly import add_forces
from .energy.gaps import Distances
from .energy.quadrature import Quadrature
from .linear.problem import DiscreteProblem
from .mesh.numbering import Numbering
from .mesh.parallel import gather
from .run import Attempt


@dataclass(frozen=True, eq=False)
class Fields:
    """Values at quadrature points (q,): rest places X [mm] (q, 3), weights [mm³] (q,), u [mm] (q, 3), grad u (q, 3, 3).

    `pressure` [kPa] is (q,), or None for an element without one.
    """

    X: Floats
    weights: Floats
    u: Floats
    gradient: Floats
    pressure: Floats | None


class Sampling:
    """Shape functions of a numbering's nodes at the points of a rule, on all cells of this rank."""

    def __init__(self, numbering: Numbering, degree: int):
        points, _ = seam.quadrature_rule(degree)
        self._numbering, self._quadrature = (
            numbering,
            Quadrature(numbering, np.arange(len(numbering.cell_dofs)), degree),
        )
        self._linear, self._values = (seam.shapes(of, points)[0] for of in (1, numbering.degree))
        self.X = (self._linear @ numbering.X[numbering.dof[numbering.cell_vertices]]).reshape(-1, 3)

    def load(self, density: Floats) -> Floats:
        """Integrate a force per volume at the points here, shape (q, 3), to nodal forces, a vector (owned, 3)."""
        nodes = self._numbering.cell_dofs
        weighted = (density * self._quadrature.volume[:, None]).reshape(len(nodes), -1, 3)
        result = np.zeros(self._numbering.X.shape)
        add_forces(nodes, np.einsum("qk,mqc->mkc", self._values, weighted), result)
        return self._numbering.nodes.sum_up(result)

    def fields(self, u: Floats, pressure: Floats | None) -> Fields:
        """Evaluate nodal displacements (n, 3) and pressures, shape (cells, 4), at the points of all ranks."""
        displacement = (self._values @ u[self._numbering.cell_dofs]).reshape(-1, 3)
        gradient = self._quadrature.deformation_gradient(u) - np.eye(3)
        comm = self._numbering.comm
        return Fields(
            X=gather(comm, self.X),
            weights=gather(comm, self._quadrature.volume),
            u=gather(comm, displacement),
            gradient=gather(comm, gradient),
            pressure=None if pressure is None else gather(comm, (pressure @ self._linear.T).ravel()),
        )


@dataclass(frozen=True, eq=False)
class NodalAnswer:
    """An answer by node, of all ranks.

    Ends (n, 2) of nodes, displacement [mm] (n, 3), a force beside loads [mN] with the ends of its nodes, and a mixed
    element's pressure [kPa] by scene vertex.
    """

    ends: Ints
    u: Floats
    force: tuple[Ints, Floats] | None
    pressure: Floats | None

    @classmethod
    def collect(cls, problem: DiscreteProblem, end: Attempt, force: Floats | None) -> NodalAnswer:
        """Collect where an attempt at a problem ended, and a force beside loads [mN], a vector, if there is one."""
        numbering = problem.numbering
        pressure = None
        if end.pressure is not None:
            mine = problem.pressures.owned
            pressure = np.zeros(len(numbering.dof))
            vertices = gather(numbering.comm, problem.pressure_vertex[:mine])
            pressure[vertices] = gather(numbering.comm, end.pressure[:mine])
        return cls(*numbering.all_nodes(end.u), None if force is None else numbering.all_nodes(force), pressure)


def recover(scene: Scene, degree: int, answer: NodalAnswer) -> Stresses:
    """Compute the stresses and reactions of an answer to a scene, by elements of a degree.

    Any rank may ask for them, alone: it integrates over the whole mesh once.
    """
    numbering = Numbering(scene, degree)
    node, pressure = numbering.nodes_between(answer.ends), answer.pressure
    problem = DiscreteProblem(scene, numbering, mixed=pressure is not None)
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
    nodes = numbering.nodes
    forces = np.where(numbering.held(scene.dirichlet()[0])[: nodes.owned], state.gradient(), 0.0)
    shares = np.zeros(numbering.X.shape)
    for end in numbering.ends[: nodes.owned].T:  # an edge's node gives half to each of its ends
        np.add.at(shares, numbering.dof[end], 0.5 * forces)
    reactions = numbering.to_scene(nodes.spread(nodes.sum_up(shares)), np.zeros(scene.vertices.shape))
    pull = np.zeros_like(numbering.X)
    for gaps in Distances.from_scene(scene, numbering):
        gaps.add_gradient(numbering.X + u, pull)
    pushes = numbering.to_scene(-pull, np.zeros(scene.vertices.shape))
    return Stresses.from_points(P_of, F_of, volume, reactions, pushes)
