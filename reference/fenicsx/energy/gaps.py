"""Contact of known pairs: the distance of their nearest points and its gradient, exact; the Hessian by differences.

The gap is Σ w_j x_j of points on both sides. Where it is least, the distance's derivative by x_j is w_j times the
gap's direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Gaps
from ..mesh.numbering import Numbering
from ..mesh.parallel import anywhere
from .assembly import add_forces
from .nodal import NodalEnergy

INSIDE = 1e-9
"""Edges whose squared sine is below it count as parallel."""
DIFFERENCE, NEARER = 1e-6, 1e-3
"""Step of a corner in finite differences: [mm], and share of a pair's distance, at most."""
PARALLEL = 1e-3
"""Edges whose squared sine is below it push by a share of their energy, by none where they are parallel."""
TINY = 1e-12
"""A distance [mm] below which the way between two points is none."""


@dataclass(frozen=True, eq=False)
class Distances(NodalEnergy):
    """The pairs of a Gaps term on this rank, their nodes (m, k), stiffness [mN/mm] and offset [mm], both (m,)."""

    nodes: Ints
    gaps: Gaps
    stiffness: Floats
    offset: Floats

    @classmethod
    def from_scene(cls, scene: Scene, numbering: Numbering) -> list[Distances]:
        """See NodalEnergy; a pair is of the rank that owns its first vertex."""
        return [cls._from_term(term, numbering) for term in scene.of(Gaps)]

    @classmethod
    def _from_term(cls, term: Gaps, numbering: Numbering) -> Distances:
        nodes = numbering.dofs_of(term.name, term.pairs)
        own = (nodes[:, 0] >= 0) & (nodes[:, 0] < numbering.nodes.owned)
        if anywhere(numbering.comm, nodes[own] < 0):  # so that all ranks raise
            raise SceneError("Gaps: a pair lies on two processes; solve it on one")
        stiffness, offset = (np.broadcast_to(amount, len(nodes))[own] for amount in (term.stiffness, term.offset))
        shares, places = (None if values is None else values[own] for values in (term.shares, term.places))
        gaps = Gaps(term.pairs[own], term.between_edges[own], stiffness, offset, shares, places)
        return cls(nodes[own], gaps, stiffness, offset)

    def energy(self, x: Floats) -> float:
        """See NodalEnergy."""
        corners = self.gaps.find_corners(x[self.nodes])
        distance, (share, _) = self._measure(corners)[0], _share_of_parallel(corners, self.gaps.between_edges)
        if np.any((distance == 0.0) & (self.offset > 0.0)):
            return np.inf
        return float(share @ self._full_energies(distance))

    def add_gradient(self, x: Floats, into: Floats):
        """See NodalEnergy."""
        forces = self._push(self.gaps.find_corners(x[self.nodes]))
        add_forces(self.nodes, self.gaps.spread_forces(forces), into)

    def hessian(self, x: Floats, kept: float) -> Floats:
        """See NodalEnergy; by central differences of the forces."""
        corners = self.gaps.find_corners(x[self.nodes])
        local = np.empty((len(corners), 12, 12))
        size = np.clip(NEARER * self._measure(corners)[0], TINY, DIFFERENCE)[:, None, None]
        for column, direction in enumerate(np.eye(12).reshape(12, 4, 3)):
            change = self._push(corners + size * direction) - self._push(corners - size * direction)
            local[:, :, column] = (change / (2.0 * size)).reshape(-1, 12)
        local = 0.5 * (local + local.transpose(0, 2, 1))
        if kept < 1.0:
            values, vectors = np.linalg.eigh(local)
            local = (vectors * np.maximum(values, kept * values)[:, None, :]) @ vectors.transpose(0, 2, 1)
        k = self.nodes.shape[1]
        return self.gaps.spread_hessians(local).reshape(len(local), k, 3, k, 3).transpose(0, 1, 3, 2, 4)

    def _push(self, corners: Floats) -> Floats:
        """Return the energy's gradient [mN] by corners, both (m, 4, 3)."""
        distance, slope = self._measure(corners)
        share, turned = _share_of_parallel(corners, self.gaps.between_edges)
        ratio = self.offset / np.clip(distance, TINY, np.maximum(self.offset, TINY))
        forces = -0.5 * share * self.stiffness * self.offset * (ratio**2 - 1.0)
        return forces[:, None, None] * slope + self._full_energies(distance)[:, None, None] * turned

    def _full_energies(self, distance: Floats) -> Floats:
        """Return the energies [µJ] of pairs at distances (m,) above 0 whose edges are not parallel."""
        below = np.maximum(self.offset - distance, 0.0)
        return 0.5 * self.stiffness * below**2 * self.offset / np.clip(distance, TINY, np.maximum(self.offset, TINY))

    def _measure(self, corners: Floats) -> tuple[Floats, Floats]:
        """Return distances (m,) of corners (m, 4, 3), and their derivatives by these (m, 4, 3)."""
        weights = np.zeros((len(corners), 4))
        between = self.gaps.between_edges
        for mask, find in ((between, _between_edges), (~between, _on_triangle)):
            weights[mask] = find(corners[mask])
        gap = np.einsum("mj,mjc->mc", weights, corners)
        distance = np.linalg.norm(gap, axis=1)
        normal = gap / np.maximum(distance, TINY)[:, None]
        return distance, weights[:, :, None] * normal[:, None, :]


def _share_of_parallel(corners: Floats, between: np.ndarray) -> tuple[Floats, Floats]:
    """Return the share of its energy that each pair has, (m,), and its derivative by corners (m, 4, 3)."""
    u, v = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 2]
    a, b = (np.maximum(np.linalg.norm(each, axis=1), TINY)[:, None] for each in (u, v))
    cosine = np.sum(u / a * v / b, axis=1)[:, None]
    square = np.where(between[:, None], np.clip(1.0 - cosine**2, 0.0, PARALLEL), PARALLEL) / PARALLEL
    slope = (2.0 - 2.0 * square) * -2.0 * cosine / PARALLEL
    by_u, by_v = slope * (v / b - cosine * u / a) / a, slope * (u / a - cosine * v / b) / b
    return (square * (2.0 - square))[:, 0], np.stack([-by_u, by_u, -by_v, by_v], axis=1)


def _choose_least(corners: Floats, weights: Floats) -> Floats:
    """Choose of several points (ways, m, 4) the nearest one."""
    squares = np.sum(np.einsum("pmj,mjc->pmc", weights, corners) ** 2, axis=2)
    return weights[squares.argmin(axis=0), np.arange(len(corners))]


def _between_edges(corners: Floats) -> Floats:
    """Find the nearest points of edges: inside both, or with one parameter at an end and the other where it is best."""
    p, u = corners[:, 0], corners[:, 1] - corners[:, 0]
    q, v = corners[:, 2], corners[:, 3] - corners[:, 2]
    r = p - q
    uu, vv, uv, ur, vr = (np.einsum("mc,mc->m", a, b) for a, b in ((u, u), (v, v), (u, v), (u, r), (v, r)))
    det = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (uv * vr - vv * ur) / det, (uu * vr - uv * ur) / det
    inside = (det > INSIDE * uu * vv) & (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
    places = [(np.where(inside, s, 0.0), np.where(inside, t, np.clip(vr / vv, 0.0, 1.0)))]
    for end in (0.0, 1.0):
        places.append((np.full(len(p), end), np.clip((vr + end * uv) / vv, 0.0, 1.0)))
        places.append((np.clip((end * uv - ur) / uu, 0.0, 1.0), np.full(len(p), end)))
    s, t = np.moveaxis(np.array(places), 0, 1)
    return _choose_least(corners, np.stack([1 - s, s, t - 1, -t], axis=-1))


def _on_triangle(corners: Floats) -> Floats:
    """Find a triangle's point nearest to a vertex: inside, or on one of its sides."""
    p, (a, b, c) = corners[:, 0], corners[:, 1:].transpose(1, 0, 2)
    u, v, r = b - a, c - a, p - a
    uu, vv, uv, ur, vr = (np.einsum("mc,mc->m", i, j) for i, j in ((u, u), (v, v), (u, v), (u, r), (v, r)))
    det = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (vv * ur - uv * vr) / det, (uu * vr - uv * ur) / det
    inside = (det > 0) & (s >= 0) & (t >= 0) & (s + t <= 1)
    shares = [np.stack([1 - s - t, s, t], axis=1)]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        begin, way = corners[:, 1 + i], corners[:, 1 + j] - corners[:, 1 + i]
        along = np.clip(np.einsum("mc,mc->m", p - begin, way) / np.einsum("mc,mc->m", way, way), 0.0, 1.0)
        on_side = np.zeros((len(p), 3))
        on_side[:, i], on_side[:, j] = 1 - along, along
        shares.append(on_side)
    shares[0] = np.where(inside[:, None], shares[0], shares[1])
    return _choose_least(corners, np.concatenate([np.ones((4, len(p), 1)), -np.array(shares)], axis=2))
