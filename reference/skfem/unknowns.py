"""The unknowns of Newton's method: free degrees of freedom, and each rigid body as a whole.

A body's six unknowns are a translation t and a turn w, both [mm]: with y the places of its vertices about their mean
and ρ their RMS, the vertices move by t and y turns to C y, C = (I - W)⁻¹ (I + W) with W = [w/2ρ]ₓ (Cayley). That is
y + w x y/ρ + w x (w x y)/2ρ² to second order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import block_diag, csc_matrix, csr_matrix, hstack
from scipy.sparse import identity as sparse_identity
from scipy.spatial.transform import Rotation

from ...lhm.base.mesh import Floats, Ints
from .. import terms
from ..scene import Scene
from .discretisation import Discretisation


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body by its degrees of freedom (k, 3) and its shape [mm], (k, 3), in place of the rest.

    The first `vertices` nodes are at its vertices, whose mean and RMS distance from it are the body's; others on edges.
    """

    dofs: Ints
    rest: Floats
    vertices: int

    @classmethod
    def from_scene(cls, scene: Scene, discretisation: Discretisation) -> list[Body]:
        """A scene's bodies."""
        bodies = []
        for term in scene.of(terms.RigidBody):
            places, member = np.array(scene.vertices), np.zeros(scene.vertices.shape, dtype=bool)
            places[term.vertices], member[term.vertices] = scene.body_rest(term), True
            held = discretisation.held_dofs(member)[discretisation.dofs[:, 0]]
            held[: len(places)] = False
            dofs = np.concatenate([discretisation.dofs[term.vertices], discretisation.dofs[held]])
            bodies.append(cls(dofs, discretisation.by_dof(places)[dofs], len(term.vertices)))
        return bodies

    @property
    def radius(self) -> float:
        """The RMS distance [mm] of vertices from their mean."""
        shape = self.rest[: self.vertices]
        return float(np.sqrt(np.sum((shape - shape.mean(axis=0)) ** 2) / len(shape)))

    def nearest(self, x: Floats) -> Floats:
        """The shape moved rigidly to fit positions by degree of freedom best, shape (k, 3)."""
        goal, centre = x[self.dofs].mean(axis=0), self.rest.mean(axis=0)
        turn, _ = Rotation.align_vectors(x[self.dofs] - goal, self.rest - centre)
        return goal + turn.apply(self.rest - centre)

    def levers(self, x: Floats) -> Floats:
        """Places about the vertices' mean [mm], shape (k, 3)."""
        return x[self.dofs] - x[self.dofs[: self.vertices]].mean(axis=0)


class Unknowns:
    """The free degrees of freedom (k,) of `size`, then six numbers for each body; `count` in all."""

    def __init__(self, free: Ints, size: int, bodies: list[Body]):
        self._free = free
        self._size = size
        self._bodies = bodies
        self.count = len(free) + 6 * len(bodies)
        self._select = sparse_identity(size, format="csc")[:, free]

    def move(self, x: Floats, step: Floats) -> Floats:
        """Positions after a step [mm], shape (count,)."""
        x = x.copy()
        x[self._free] += step[: len(self._free)]
        for body, (t, w) in zip(self._bodies, step[len(self._free) :].reshape(-1, 2, 3), strict=True):
            W = _skew(w / (2 * body.radius))
            turn = np.linalg.solve(np.eye(3) - W, np.eye(3) + W)
            y = body.levers(x)
            x[body.dofs] += t + y @ turn.T - y
        return x

    def gradient(self, x: Floats, forces: Floats) -> Floats:
        """The gradient [mN], shape (count,), from the one by degree of freedom: sums of forces, torques over ρ."""
        return self._dependence(x).T @ forces

    def hessian(self, x: Floats, forces: Floats, matrix: csc_matrix) -> csc_matrix:
        """The exact Hessian [mN/mm] from the one by degree of freedom."""
        return self._reduce(x, matrix, [self._differentiate_turn(body, x, forces) for body in self._bodies])

    def projected_hessian(self, x: Floats, forces: Floats, matrix: csc_matrix) -> csc_matrix:
        """The same from a positive semi-definite one, with the curvature by turning made so too."""
        turning = []
        for body in self._bodies:
            values, vectors = np.linalg.eigh(self._differentiate_turn(body, x, forces))
            turning.append((vectors * np.maximum(values, 0)) @ vectors.T)
        return self._reduce(x, matrix, turning)

    def _reduce(self, x: Floats, matrix: csc_matrix, turning: list[Floats]) -> csc_matrix:
        dependence = self._dependence(x)
        reduced = dependence.T @ matrix @ dependence
        if turning:
            none = csr_matrix((len(self._free), len(self._free)))
            reduced += block_diag([none, *(block_diag([np.zeros((3, 3)), turn]) for turn in turning)])
        return reduced.tocsc()

    def _differentiate_turn(self, body: Body, x: Floats, forces: Floats) -> Floats:
        """Half the second derivative of Σ g · (w x (w x y)) by w over ρ²: sym(Σ y gᵀ) - Σ y·g I, shape (3, 3)."""
        moment = body.levers(x).T @ forces[body.dofs] / body.radius**2
        return (moment + moment.T) / 2 - np.trace(moment) * np.eye(3)

    def _dependence(self, x: Floats) -> csc_matrix:
        """How degrees of freedom follow the unknowns, shape (size, count)."""
        columns = [self._select]
        for body in self._bodies:
            y = body.levers(x) / body.radius
            moves = np.concatenate([np.broadcast_to(np.eye(3), (len(y), 3, 3)), _skew(y).transpose(0, 2, 1)], axis=2)
            rows = np.repeat(body.dofs.ravel(), 6)
            unknown = np.tile(np.arange(6), body.dofs.size)
            columns.append(csc_matrix((moves.ravel(), (rows, unknown)), shape=(self._size, 6)))
        return hstack(columns, format="csc")


def _skew(v: Floats) -> Floats:
    """[v]ₓ, shape (..., 3, 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*v.shape, 3)
