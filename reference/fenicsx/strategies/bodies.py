"""Rigid bodies: the problem over free nodes and, per body, a translation and a rotation.

A body's nodes are at c + Q r. A step moves c by t and turns Q to exp([ω]) Q; its unknowns are t and ρω [mm], with ρ the
body's RMS radius, so that all unknowns are lengths and all gradients forces. With y = Q r a node moves by
t + ω x y + ω x (ω x y)/2, so nodal forces g curve the energy by sym(y gᵀ) - (y·g) I along ω beyond what Pᵀ H P does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import RigidBody
from ..dolfinx_version import PETSc
from ..energy.assembly import null_space
from ..linear.problem import DiscreteProblem, Evaluation
from ..mesh.numbering import Numbering
from ..mesh.parallel import anywhere


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body: its nodes here (k,), their places r about its centre [mm], (k, 3), and its RMS radius [mm]."""

    nodes: Ints
    r: Floats
    radius: float


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a body is: its centre c [mm], shape (3,), and rotation Q."""

    centre: Floats
    turn: Rotation

    def of(self, body: Body) -> Floats:
        """The body's nodes [mm], shape (k, 3)."""
        return self.centre + rotate(self.turn, body.r)

    def moved(self, translation: Floats, rotation: Floats) -> Pose:
        """The pose after a translation [mm] and a turn by exp([rotation])."""
        return Pose(self.centre + translation, Rotation.from_rotvec(rotation) * self.turn)


def rotate(turn: Rotation, r: Floats) -> Floats:
    """Places r (k, 3) after a turn; of a rank without nodes of a body there are none."""
    return turn.apply(r) if len(r) else np.zeros((0, 3))


class RigidProblem:
    """A discrete problem with rigid bodies; unknowns come in blocks of three, bodies' translation and rotation last.

    Each rank has those of the nodes that it owns, and the last one those of the bodies. All know all poses.
    """

    def __init__(self, scene: Scene, numbering: Numbering, problem: DiscreteProblem):
        self.problem, self.comm = problem, problem.comm
        self._numbering = numbering
        self._n = numbering.nodes.owned
        self.set(scene)
        self.nodes: Ints = np.concatenate([body.nodes for body in self._bodies])
        self.free: Ints = np.setdiff1d(np.arange(self._n), self.nodes)
        self._has_bodies = self.comm.rank == self.comm.size - 1
        self.count = len(self.free) + (2 * len(self._bodies) if self._has_bodies else 0)
        counts = self.comm.allgather(self.count)
        self._first, self._total = sum(counts[: self.comm.rank]), sum(counts)
        rest = [Pose(centre, Rotation.identity()) for centre in self._centres]
        P = self._projection(rest)
        indptr, indices = (part.astype(PETSc.IntType) for part in (P.indptr, P.indices))
        sizes = (3 * self._n, 3 * numbering.nodes.total), (3 * self.count, 3 * self._total)
        self._P = PETSc.Mat().createAIJ(sizes, bsize=3, csr=(indptr, indices, P.data), comm=self.comm)
        self.matrix = problem.matrix.ptap(self._P)
        self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.matrix.setNearNullSpace(self._rigid_motions())

    def set(self, scene: Scene):
        """Take a scene's bodies, of the same vertices."""
        numbering = self._numbering
        self._bodies, self._centres = [], []
        for term in scene.of(RigidBody):
            numbering.dofs_of(term.name, term.vertices)
            places, member = np.array(scene.vertices), np.zeros(scene.vertices.shape, dtype=bool)
            places[term.vertices] = scene.body_rest(term)
            member[term.vertices] = True
            nodes = np.flatnonzero(numbering.held(member)[: self._n].all(axis=1))
            centre = places[term.vertices].mean(axis=0)
            radius = float(np.sqrt(np.mean(np.sum((places[term.vertices] - centre) ** 2, axis=1))))
            self._bodies.append(Body(nodes, numbering.to_dofs(places)[nodes] - centre, radius))
            self._centres.append(centre)

    @property
    def energy_scale(self) -> float:
        """See DiscreteProblem."""
        return self.problem.energy_scale

    def rest(self) -> list[Pose]:
        """The bodies at the places of their rest shapes."""
        return [Pose(centre, Rotation.identity()) for centre in self._centres]

    def nearest(self, x: Floats) -> list[Pose]:
        """The poses that fit positions by node [mm], shape (n, 3), best."""
        poses = []
        for body in self._bodies:
            count = self._sum(len(body.nodes))
            inner = self._sum(body.r.sum(axis=0)) / count  # of quadratic elements the nodes' mean is not the vertices'
            centre = self._sum(x[body.nodes].sum(axis=0)) / count
            U, _, Vt = np.linalg.svd(self._sum((x[body.nodes] - centre).T @ (body.r - inner)))
            U[:, 2] *= np.sign(np.linalg.det(U) * np.linalg.det(Vt))
            poses.append(Pose(centre - U @ Vt @ inner, Rotation.from_matrix(U @ Vt)))
        return poses

    def _sum(self, values):
        """The sum over ranks."""
        return self.comm.allreduce(values)

    def place(self, poses: list[Pose], x: Floats):
        """Put the bodies' nodes into positions by node [mm], shape (owned or more, 3)."""
        for body, pose in zip(self._bodies, poses, strict=True):
            x[body.nodes] = pose.of(body)

    def held(self, held: np.ndarray) -> Ints:
        """The flat unknowns held where a mask (n, 3) holds nodes; a body is, if nothing supports any of its nodes."""
        blocks = np.zeros((self.count, 3), dtype=bool)
        blocks[: len(self.free)] = held[self.free]
        for b, body in enumerate(self._bodies):
            unsupported = not anywhere(self.comm, ~self.problem.unsupported[body.nodes])
            blocks[len(self.free) + 2 * b :][:2] = unsupported
        return np.flatnonzero(blocks)

    def at(self, u: Floats, poses: list[Pose]) -> RigidState:
        """The problem at a displacement [mm], shape (owned or more, 3), of the free nodes, and poses of the bodies."""
        u = np.array(u[: self._n])
        x = self._numbering.X[: self._n] + u
        self.place(poses, x)
        u[self.nodes] = (x - self._numbering.X[: self._n])[self.nodes]
        return RigidState(self, self.problem.at(self._numbering.nodes.spread(u)), poses)

    def moved(self, state: RigidState, step: Floats) -> RigidState:
        """The problem after a step of the unknowns [mm], a vector (3 count,)."""
        blocks = step.reshape(-1, 3)
        u = np.array(state.u[: self._n])
        u[self.free] += blocks[: len(self.free)]
        motions = self.comm.bcast(blocks[len(self.free) :], root=self.comm.size - 1).reshape(-1, 2, 3)
        moved = zip(state.poses, motions, self._bodies, strict=True)
        return self.at(u, [pose.moved(t, turn / body.radius) for pose, (t, turn), body in moved])

    def reduce(self, forces: Floats, poses: list[Pose]) -> Floats:
        """Forces [mN], a vector (owned, 3), on the unknowns, shape (count, 3): torques over the RMS radius."""
        result = [forces[self.free]]
        for body, pose in zip(self._bodies, poses, strict=True):
            g = forces[body.nodes]
            torque = np.cross(rotate(pose.turn, body.r), g).sum(axis=0)
            on_body = self._sum(np.stack([g.sum(axis=0), torque / body.radius]))
            if self._has_bodies:
                result.append(on_body)
        return np.concatenate(result)

    def project(self, hessian: PETSc.Mat, forces: Floats, poses: list[Pose], kept: float) -> PETSc.Mat:
        """Pᵀ H P and the bodies' turning under forces [mN], its negative curvature times `kept`, in `matrix`."""
        P = self._projection(poses)
        indptr, indices = (part.astype(PETSc.IntType) for part in (P.indptr, P.indices))
        self._P.setValuesCSR(indptr, indices, P.data)
        self._P.assemble()
        hessian.ptap(self._P, result=self.matrix)
        for b, (body, pose) in enumerate(zip(self._bodies, poses, strict=True)):
            y, g = rotate(pose.turn, body.r), forces[body.nodes]
            curvature = self._sum(0.5 * (y.T @ g + g.T @ y) - np.sum(y * g) * np.eye(3))
            if not self._has_bodies:
                continue
            values, vectors = np.linalg.eigh(curvature / body.radius**2)
            curvature = (vectors * np.maximum(values, kept * values)) @ vectors.T
            block = np.arange(3, dtype=PETSc.IntType) + 3 * (self._first + len(self.free) + 2 * b + 1)
            self.matrix.setValues(block, block, curvature, addv=PETSc.InsertMode.ADD_VALUES)
        self.matrix.assemble()
        return self.matrix

    def _projection(self, poses: list[Pose]) -> csr_matrix:
        """P: how the owned nodes (3n) follow the unknowns of all, its pattern the same whatever the poses."""
        bodies = self._total - 2 * len(self._bodies)
        rows, values = [self.free], [np.tile(np.eye(3), (len(self.free), 1, 1))]
        columns = [self._first + np.arange(len(self.free))]
        for b, (body, pose) in enumerate(zip(self._bodies, poses, strict=True)):
            y = rotate(pose.turn, body.r) / body.radius
            turning = np.cross(np.eye(3), y[:, None, :]).transpose(0, 2, 1)
            for block, entries in enumerate((np.tile(np.eye(3), (len(y), 1, 1)), turning)):
                rows.append(body.nodes)
                columns.append(np.full(len(y), bodies + 2 * b + block))
                values.append(entries)
        i, j, v = np.concatenate(rows), np.concatenate(columns), np.concatenate(values)
        component = np.arange(3)
        i, j = (3 * i[:, None] + component)[:, :, None], (3 * j[:, None] + component)[:, None, :]
        i, j = np.broadcast_to(i, v.shape), np.broadcast_to(j, v.shape)
        P = csr_matrix((v.ravel(), (i.ravel(), j.ravel())), shape=(3 * self._n, 3 * self._total))
        P.sort_indices()
        return P

    def _rigid_motions(self) -> PETSc.NullSpace:
        """Rigid motions of everything, in the unknowns at rest."""
        free = self._numbering.X[self.free]
        basis = np.zeros((6, self.count, 3))
        for c, axis in enumerate(np.eye(3)):
            basis[c, : len(free), c] = 1.0
            basis[3 + c, : len(free)] = np.cross(axis, free)
            if self._has_bodies:
                basis[c, len(free) :: 2, c] = 1.0
                basis[3 + c, len(free) :: 2] = np.cross(axis, np.array(self._centres))
                basis[3 + c, len(free) + 1 :: 2] = np.outer([body.radius for body in self._bodies], axis)
        return null_space(basis, self.comm)


class RigidState:
    """Energy, gradient and Hessian over the unknowns, at one displacement `u` (n, 3) and poses of the bodies."""

    def __init__(self, owner: RigidProblem, state: Evaluation, poses: list[Pose]):
        self._owner, self._state = owner, state
        self.poses, self.u, self.energy = poses, state.u, state.energy

    def gradient(self) -> Floats:
        """The energy's gradient [mN], shape (count, 3), held components included."""
        return self._owner.reduce(self._state.gradient(), self.poses)

    def hessian(self, kept: float = 1.0) -> PETSc.Mat:
        """The Hessian [mN/mm], in the owner's matrix; negative eigenvalues, of turning too, are times `kept`."""
        return self._owner.project(self._state.hessian(kept), self._state.gradient(), self.poses, kept)
