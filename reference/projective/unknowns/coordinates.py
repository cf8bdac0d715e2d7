"""The unknowns: displacements of free components, and a rigid motion per body.

A step is one flat vector [mm]: the free components in the order of `Coordinates.index`, then six numbers per body, its
shift and its turn, a rotation vector times the body's radius, so that forces and torques have one unit. Rotations are
composed, x = c + exp(ω) Q r, so that no parameters of a rotation have to be kept away from a singular place.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ....lhm.base.geometry.warp import rigid_motion
from ....lhm.base.kernels import njit
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import RigidBody


@dataclass(frozen=True, eq=False)
class Place:
    """A displacement u [mm], shape (n, 3), and the bodies' rotations, shape (bodies, 3, 3), that belong to it."""

    u: Floats
    rotations: Floats


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body: its vertices (k,), its arms over its radius, (k, 3), its radius [mm] and its rest - X [mm], (k, 3).

    The radius is the root mean square length of the arms, which go from the mean of the body's rest to its vertices.
    """

    vertices: Ints
    arms: Floats
    radius: float
    offset: Floats

    @classmethod
    def from_scene(cls, scene: Scene, term: RigidBody) -> Body:
        """Make a body of a scene."""
        rest = scene.body_rest(term)
        arms = rest - rest.mean(axis=0)
        radius = float(np.sqrt(np.mean(np.sum(arms**2, axis=1))))
        return cls(term.vertices, arms / radius, radius, rest - scene.vertices[term.vertices])

    @property
    def affine(self) -> Floats:
        """[1, arms], shape (k, 4): what the body's displacements are combinations of, however it is turned."""
        return np.column_stack([np.ones(len(self.arms)), self.arms])

    def put(self, u: Floats, shift: Floats, rotation: Floats):
        """Write the body's displacements into u for a shift [mm] of its mean and a rotation."""
        u[self.vertices] = shift + self.radius * (self.arms @ (rotation - np.eye(3)).T) + self.offset

    def shift(self, u: Floats) -> Floats:
        """Return the shift [mm], shape (3,), of the body's mean at displacements u that are rigid."""
        return (u[self.vertices] - self.offset).mean(axis=0)


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Maps steps to displacements and gradients over vertices to gradients over the unknowns.

    `held` (n, 3) are the components that are no unknowns; `groups` pairs components (of x, y, z) that are held at the
    same vertices with their free vertices; `index` (f,) are the free components' places in a flat u.
    """

    held: np.ndarray
    groups: tuple[tuple[Ints, Ints], ...]
    index: Ints
    bodies: tuple[Body, ...]

    @classmethod
    def from_scene(cls, scene: Scene) -> Coordinates:
        """Find the unknowns of a scene, after its Fixed and RigidBody terms."""
        held, _ = scene.dirichlet()
        bodies = tuple(Body.from_scene(scene, term) for term in scene.of(RigidBody))
        taken = held.copy()
        for body in bodies:
            taken[body.vertices] = True
        alike: dict[bytes, list[int]] = {}
        for c in range(3):
            alike.setdefault(held[:, c].tobytes(), []).append(c)
        groups = []
        for components in map(np.array, alike.values()):
            free = np.flatnonzero(~taken[:, components[0]])
            if len(free) or bodies:
                groups.append((components, free))
        parts = [(3 * free[:, None] + components).ravel() for components, free in groups]
        return cls(held, tuple(groups), np.concatenate([*parts, np.zeros(0, dtype=np.int64)]), bodies)

    @property
    def size(self) -> int:
        """The number of unknowns."""
        return len(self.index) + 6 * len(self.bodies)

    def start(self, u: Floats) -> Place:
        """Return the place nearest to displacements u [mm], shape (n, 3): bodies move by the best rigid motion."""
        u = np.array(u, dtype=np.float64)
        rotations = np.empty((len(self.bodies), 3, 3))
        for body, rotation in zip(self.bodies, rotations, strict=True):
            arms = body.radius * body.arms
            rotation[:], shift = rigid_motion(arms, arms + u[body.vertices] - body.offset)
            body.put(u, shift, rotation)
        return Place(u, rotations)

    def _split(self, vector: Floats) -> Iterator[tuple[Ints, Ints, Floats]]:
        """Give each group's components and free vertices, and the part of a vector over the unknowns that is theirs."""
        begin = 0
        for components, free in self.groups:
            end = begin + len(components) * len(free)
            yield components, free, vector[begin:end]
            begin = end

    def move(self, place: Place, step: Floats) -> Place:
        """Return the place after a step [mm], shape (size,)."""
        u = place.u.copy()
        for components, free, part in self._split(step):
            _add_rows(u, free, components, part)
        rotations = np.empty_like(place.rotations)
        for b, (body, motion) in enumerate(zip(self.bodies, step[len(self.index) :].reshape(-1, 6), strict=True)):
            turned = _rotation(motion[3:] / body.radius) @ place.rotations[b]
            rotations[b] = 1.5 * turned - 0.5 * turned @ turned.T @ turned  # rounding would add up over many steps
            body.put(u, body.shift(place.u) + motion[:3], rotations[b])
        return Place(u, rotations)

    def push(self, step: Floats, place: Place) -> Floats:
        """Return the displacement [mm], shape (n, 3), of a small step, shape (size,): the transpose of `pull`."""
        moved = np.zeros_like(place.u)
        moved.reshape(-1)[self.index] = step[: len(self.index)]
        motions = step[len(self.index) :].reshape(-1, 6)
        for body, rotation, motion in zip(self.bodies, place.rotations, motions, strict=True):
            moved[body.vertices] = motion[:3] + np.cross(motion[3:], body.arms @ rotation.T)
        return moved

    def pull(self, gradient: Floats, place: Place) -> Floats:
        """Turn the derivative of an energy by x, shape (n, 3), into that by a step, shape (size,); exact at each place.

        A body's share is the force on it, and the torque about its mean over its radius [mN].
        """
        pulled = np.empty(self.size)
        for components, free, part in self._split(pulled):
            _take_rows(gradient, free, components, part)
        for b, motion in enumerate(pulled[len(self.index) :].reshape(-1, 6)):
            body = self.bodies[b]
            forces = gradient[body.vertices]
            moment = place.rotations[b] @ (body.arms.T @ forces)
            motion[:3] = forces.sum(axis=0)
            motion[3:] = [moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], moment[0, 1] - moment[1, 0]]
        return pulled

    def affine_motions(self, rotations: Floats) -> Floats:
        """Map the bodies' unknowns to coefficients of `Body.affine`, shape (3, 4 bodies, 6 bodies), per x, y, z.

        With r = Q a, the displacement (θ × r)_i is Σ_a ([θ]ₓ Q)_ia a_a.
        """
        count = len(self.bodies)
        motions = np.zeros((3, count, 4, count, 6))
        for b, rotation in enumerate(rotations):
            motions[:, b, 0, b, :3] = np.eye(3)
            motions[:, b, 1:, b, 3:] = np.einsum("imj,ma->iaj", CROSS, rotation)
        return motions.reshape(3, 4 * count, 6 * count)


# CROSS[i, m, j] is the entry (i, m) of [e_j]ₓ.
CROSS = np.stack([np.cross(axis, np.eye(3)).T for axis in np.eye(3)], axis=2)


@njit(cache=True)
def _add_rows(u, free, components, step):
    """Add a step of some components, in rising order, of free vertices."""
    if len(components) == 3:
        for i in range(len(free)):
            for c in range(3):
                u[free[i], c] += step[3 * i + c]
        return
    for i in range(len(free)):
        for c in range(len(components)):
            u[free[i], components[c]] += step[len(components) * i + c]


@njit(cache=True)
def _take_rows(gradient, free, components, pulled):
    """Take some components, in rising order, of free vertices."""
    if len(components) == 3:
        for i in range(len(free)):
            for c in range(3):
                pulled[3 * i + c] = gradient[free[i], c]
        return
    for i in range(len(free)):
        for c in range(len(components)):
            pulled[len(components) * i + c] = gradient[free[i], components[c]]


def _rotation(vector: Floats) -> Floats:
    """Return the rotation exp([ω]ₓ) of a rotation vector [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    cross = CROSS @ vector
    sine, versine = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    return np.eye(3) + sine * cross + versine * cross @ cross
