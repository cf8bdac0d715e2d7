"""The points of surfaces in contact: vertices of the scene, and points of obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Contact, Gaps, Obstacle, RigidBody
from ..unknowns.coordinates import CROSS, Coordinates
from .rows import Rows


@dataclass(frozen=True, eq=False)
class ContactPoints:
    """Contact points, k of the scene's `vertices` (k,) and o of obstacles.

    An obstacle's point is at its place (o, 3) [mm] plus the sum of shares (o, 4) times the positions of its carriers
    (o, 4), which are the scene's vertices. One that stands still has shares of nothing, one that is carried is at 0.
    Vertices are met where they are plus `shift` (k, 3) [mm].
    """

    vertices: Ints
    places: Floats
    carriers: Ints
    shares: Floats
    shift: Floats

    @classmethod
    def from_scene(cls, scene: Scene) -> ContactPoints:
        """Number the points of all Contact terms; SceneError for an obstacle whose carriers are free to deform."""
        contacts = scene.of(Contact)
        vertices = np.unique(np.concatenate([term.triangles.ravel() for term in contacts]))
        obstacles = [obstacle for term in contacts for obstacle in term.obstacles]
        held, _ = scene.dirichlet()
        bodies = [np.flatnonzero(held.all(axis=1)), *(body.vertices for body in scene.of(RigidBody))]
        parts = [(np.zeros((0, 3)), np.zeros((0, 4), dtype=np.int64), np.zeros((0, 4)))]
        for obstacle in obstacles:
            parts.append(_hang(obstacle, scene, bodies))
        places, carriers, shares = (np.concatenate(column) for column in zip(*parts, strict=True))
        return cls(vertices, places, carriers, shares, np.zeros((len(vertices), 3)))

    def drawn_back(self, scene: Scene, points: Ints, way: float) -> ContactPoints:
        """Return the same, but some points (any) of vertices met `way` [mm] further within their tets at rest."""
        place = np.full(len(scene.vertices), -1)
        place[self.vertices[points]] = points
        inward = scene.vertices[scene.tets].mean(axis=1)[:, None] - scene.vertices[scene.tets]
        some = place[scene.tets] >= 0
        summed = np.zeros_like(self.shift)
        np.add.at(summed, place[scene.tets][some], inward[some])
        length = np.linalg.norm(summed, axis=1, keepdims=True)
        return replace(self, shift=way * summed / np.where(length > 0.0, length, 1.0))

    def __len__(self) -> int:
        """The number of points, k + o."""
        return len(self.vertices) + len(self.places)

    def find_places(self, positions: Floats) -> Floats:
        """Return the points' positions [mm], shape (k + o, 3), with the scene's vertices at positions (n, 3)."""
        own = positions[self.vertices] + self.shift
        if not len(self.places):
            return own
        carried = np.einsum("oj,ojc->oc", self.shares, positions[self.carriers])
        return np.vstack([own, self.places + carried])

    def spread(self, forces: Floats, count: int) -> Floats:
        """Spread forces [mN] on the points (k + o, 3) over so many vertices of the scene, shape (count, 3)."""
        spread = np.zeros((count, 3))
        spread[self.vertices] = forces[: len(self.vertices)]
        np.add.at(spread, self.carriers, self.shares[:, :, None] * forces[len(self.vertices) :, None, :])
        return spread

    def carry(self, coordinates: Coordinates, rotations: Floats) -> Floats:
        """Return how obstacles' points move with bodies of these rotations, by a small step's part that is theirs.

        Shape (3 o, 6 bodies).
        """
        used, carriers = np.unique(self.carriers, return_inverse=True)
        motion = restrict(coordinates, used, rotations)[:, len(coordinates.index) :].toarray()
        of_carriers = motion.reshape(len(used), 3, motion.shape[1])[carriers.reshape(self.carriers.shape)]
        carried = np.einsum("oj,ojcb->ocb", self.shares, of_carriers)
        return carried.reshape(3 * len(self.places), motion.shape[1])

    def freeze(self, rows: Rows) -> Gaps:
        """Return pairs as a term on the scene's vertices: a pair hangs on its own ones, and on an obstacle's carriers.

        A vertex of its own fills the places that are left, and has no share by them.
        """
        first = len(self.vertices)
        is_own = rows.ids < first
        place = np.where(is_own, rows.ids, 0)
        own = self.vertices[place]
        if is_own.all() and not self.shift.any():
            return Gaps(own, rows.between_edges, rows.stiffness, rows.offset)
        every = np.arange(len(rows.ids))
        if is_own.all():
            shares = np.broadcast_to(np.eye(4), (len(every), 4, 4))
            return Gaps(own, rows.between_edges, rows.stiffness, rows.offset, shares, self.shift[place])
        spare = own[every, is_own.argmax(axis=1)][:, None]
        point = np.where(is_own, 0, rows.ids - first)
        met = point[every, is_own.argmin(axis=1)]
        is_carried = ~is_own.all(axis=1) & self.shares[met].any(axis=1)
        pairs = np.hstack([np.where(is_own, own, spare), np.where(is_carried[:, None], self.carriers[met], spare)])
        shares = np.zeros((len(every), 4, 8))
        shares[:, range(4), range(4)] = is_own
        shares[:, :, 4:] = np.where(is_own[..., None], 0.0, self.shares[point])
        places = np.where(is_own[..., None], self.shift[place], self.places[point])
        return Gaps(pairs, rows.between_edges, rows.stiffness, rows.offset, shares, places)


def _hang(obstacle: Obstacle, scene: Scene, rigid: Sequence[Ints]) -> tuple[Floats, Ints, Floats]:
    """Return places, carriers and shares of an obstacle's points; rigid: vertices that move together, of each body."""
    points = obstacle.surface.vertices
    if obstacle.carriers is None:
        return points, np.zeros((len(points), 4), dtype=np.int64), np.zeros((len(points), 4))
    if not any(np.isin(obstacle.carriers, body).all() for body in rigid):
        raise SceneError("Obstacle.carriers: expected vertices of one RigidBody, or that are Fixed")
    carriers = np.broadcast_to(obstacle.carriers, (len(points), 4))
    return np.zeros_like(points), carriers, obstacle.find_shares(scene)


def restrict(coordinates: Coordinates, vertices: Ints, rotations: Floats) -> csr_matrix:
    """Return P, shape (3 k, size): the motion of vertices (k,) by a small step, where bodies have these rotations."""
    parts = 3 * vertices[:, None] + np.arange(3)
    unknown = np.full(3 * len(coordinates.held), -1)
    unknown[coordinates.index] = np.arange(len(coordinates.index))
    column = unknown[parts.ravel()]
    rows = np.flatnonzero(column >= 0)
    columns, values = [column[rows]], [np.ones(len(rows))]
    at = [rows]
    for b, (body, rotation) in enumerate(zip(coordinates.bodies, rotations, strict=True)):
        place = np.full(len(coordinates.held), -1)
        place[body.vertices] = np.arange(len(body.vertices))
        of_body = np.flatnonzero(place[vertices] >= 0)
        arms = body.arms[place[vertices[of_body]]] @ rotation.T
        motion = np.concatenate([np.tile(np.eye(3), (len(arms), 1, 1)), np.einsum("imj,km->kij", CROSS, arms)], axis=2)
        first = len(coordinates.index) + 6 * b
        rows, places = np.broadcast_arrays((3 * of_body[:, None] + np.arange(3))[:, :, None], first + np.arange(6))
        at.append(rows.ravel())
        columns.append(places.ravel())
        values.append(motion.ravel())
    entries = np.concatenate(values), (np.concatenate(at), np.concatenate(columns))
    return csr_matrix(entries, shape=(3 * len(vertices), coordinates.size))
