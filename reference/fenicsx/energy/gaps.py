"""Contact of known pairs: the distance of their nearest points, its gradient and Hessian, all exact.

The gap g(θ) = Σ w_j(θ) x_j of points on both sides is least at θ, the free parameters of the corner, edge or face that
the nearest point lies on. With f = ½ |g|², whose w_j are linear in each parameter, the Hessian of least f is

    f_xx - f_xθ f_θθ⁻¹ f_θx,  f_xj xk = w_j w_k I,  f_θθ = G Gᵀ,  f_xj θi = w_j,i g + w_j G_i,  G_i = Σ w_j,i x_j,

and the distance's, d = √(2 f), follows from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....lhm.base.errors import SceneError
from ....lhm.base.mesh import Floats, Ints
from ...scene import Scene
from ...terms import Gaps
from ..mesh.numbering import Numbering
from .assembly import add_forces
from .nodal import NodalEnergy

INSIDE = 1e-9
"""A parameter nearer to the end of its range is held there."""


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
        if (nodes[own] < 0).any():
            raise SceneError("Gaps: a pair lies on two processes; solve it on one")
        stiffness, offset = (np.broadcast_to(amount, len(nodes))[own] for amount in (term.stiffness, term.offset))
        shares, places = (None if values is None else values[own] for values in (term.shares, term.places))
        gaps = Gaps(term.pairs[own], term.between_edges[own], stiffness, offset, shares, places)
        return cls(nodes[own], gaps, stiffness, offset)

    def energy(self, x: Floats) -> float:
        """See NodalEnergy."""
        return 0.5 * float(self.stiffness @ np.maximum(self.offset - self._measure(x)[1], 0.0) ** 2)

    def add_gradient(self, x: Floats, into: Floats):
        """See NodalEnergy."""
        _, distance, weights, gap, _ = self._measure(x)
        push = -self.stiffness * np.maximum(self.offset - distance, 0.0) / distance
        forces = push[:, None, None] * weights[:, :, None] * gap[:, None, :]
        add_forces(self.nodes, self.gaps.spread_forces(forces), into)

    def hessian(self, x: Floats, kept: float) -> Floats:
        """See NodalEnergy."""
        corners, distance, weights, gap, slopes = self._measure(x)
        m = len(distance)
        along = np.einsum("mij,mjc->mic", slopes, corners)  # G
        mixed = slopes[..., None] * gap[:, None, None, :] + weights[:, None, :, None] * along[:, :, None, :]
        mixed = mixed.reshape(m, slopes.shape[1], 12)
        inverse = np.linalg.pinv(along @ along.transpose(0, 2, 1), hermitian=True)
        squares = np.einsum("mj,mk,ab->mjakb", weights, weights, np.eye(3)).reshape(m, 12, 12)
        of_half_square = squares - mixed.transpose(0, 2, 1) @ inverse @ mixed
        slope = (weights[:, :, None] * gap[:, None, :]).reshape(m, 12) / distance[:, None]
        outer = slope[:, :, None] * slope[:, None, :]
        of_distance = (of_half_square - outer) / distance[:, None, None]
        depth = np.maximum(self.offset - distance, 0.0)[:, None, None]
        local = self.stiffness[:, None, None] * ((depth > 0.0) * outer - depth * of_distance)
        if kept < 1.0:
            values, vectors = np.linalg.eigh(local)
            local = (vectors * np.maximum(values, kept * values)[:, None, :]) @ vectors.transpose(0, 2, 1)
        k = self.nodes.shape[1]
        return self.gaps.spread_hessians(local).reshape(m, k, 3, k, 3).transpose(0, 1, 3, 2, 4)

    def _measure(self, x: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Return corners (m, 4, 3), distances (m,), weights (m, 4), gaps (m, 3) and slopes (m, 2, 4).

        The slopes are the weights' by the free parameters.
        """
        corners = self.gaps.find_corners(x[self.nodes])
        weights, slopes = np.zeros((len(corners), 4)), np.zeros((len(corners), 2, 4))
        between = self.gaps.between_edges
        for mask, find in ((between, _between_edges), (~between, _on_triangle)):
            weights[mask], slopes[mask] = find(corners[mask])
        gap = np.einsum("mj,mjc->mc", weights, corners)
        return corners, np.linalg.norm(gap, axis=1), weights, gap, slopes


def _choose_least(corners: Floats, weights: Floats, slopes: Floats) -> tuple[Floats, Floats]:
    """Choose of several points (ways, m, 4), each with its slopes (ways, m, 2, 4), the nearest one."""
    squares = np.sum(np.einsum("pmj,mjc->pmc", weights, corners) ** 2, axis=2)
    best = squares.argmin(axis=0), np.arange(len(corners))
    return weights[best], slopes[best]


def _between_edges(corners: Floats) -> tuple[Floats, Floats]:
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
    weights = np.stack([1 - s, s, t - 1, -t], axis=-1)
    slopes = np.zeros((*s.shape, 2, 4))
    slopes[..., 0, :2] = np.where(_is_free(s)[..., None], [-1.0, 1.0], 0.0)
    slopes[..., 1, 2:] = np.where(_is_free(t)[..., None], [1.0, -1.0], 0.0)
    return _choose_least(corners, weights, slopes)


def _on_triangle(corners: Floats) -> tuple[Floats, Floats]:
    """Find a triangle's point nearest to a vertex: inside, or on one of its sides."""
    p, (a, b, c) = corners[:, 0], corners[:, 1:].transpose(1, 0, 2)
    u, v, r = b - a, c - a, p - a
    uu, vv, uv, ur, vr = (np.einsum("mc,mc->m", i, j) for i, j in ((u, u), (v, v), (u, v), (u, r), (v, r)))
    det = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (vv * ur - uv * vr) / det, (uu * vr - uv * ur) / det
    inside = (det > 0) & (s >= 0) & (t >= 0) & (s + t <= 1)
    shares = [np.stack([1 - s - t, s, t], axis=1)]
    slopes = [np.array([[0.0, 1.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        begin, way = corners[:, 1 + i], corners[:, 1 + j] - corners[:, 1 + i]
        along = np.clip(np.einsum("mc,mc->m", p - begin, way) / np.einsum("mc,mc->m", way, way), 0.0, 1.0)
        on_side = np.zeros((len(p), 3))
        on_side[:, i], on_side[:, j] = 1 - along, along
        slope = np.zeros((2, 4))
        slope[0, 1 + i], slope[0, 1 + j] = 1.0, -1.0
        shares.append(on_side)
        slopes.append(slope)
    shares[0] = np.where(inside[:, None], shares[0], shares[1])
    weights = np.concatenate([np.ones((4, len(p), 1)), -np.array(shares)], axis=2)
    of_ways = np.repeat(np.array(slopes)[:, None], len(p), axis=1)
    of_ways[0, ~inside] = of_ways[1, ~inside]
    at_end = (np.array(shares) > 1.0 - INSIDE).any(axis=2)
    of_ways[at_end] = 0.0
    return _choose_least(corners, weights, of_ways)


def _is_free(parameter: Floats) -> np.ndarray:
    """Whether parameters lie inside their range, from 0 to 1."""
    return (parameter > INSIDE) & (parameter < 1.0 - INSIDE)
