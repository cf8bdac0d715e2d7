"""The line between the lips of a skin, from a template's that was laid onto it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..base.geometry.bvh import TriangleTree
from ..base.geometry.rays import first_hits
from ..base.geometry.topology import find_openings
from ..base.mesh import Floats, Ints, Surface
from ..identities.space import MOUTH

SAMPLES = 61
REACH, STEP = 4.0, 0.2
"""[mm] How far from the template's line the furrow between the lips is looked for, and in which steps."""
SMOOTH, STAY, CORNER = 4.0, 0.004, 0.1
"""What a sideways step of the line costs, and its distance from the template's, in depth [mm]; the latter at the
corners too, where the furrow ends."""


@dataclass(frozen=True, eq=False)
class LipLine:
    """A line from corner to corner: `height` [mm], shape (k,), over even steps of `along`, in the mouth's own axes.

    Rows of `axes`: from the subject's right to the left, up, and forward; `origin` [mm], the middle between the
    corners. `upper` and `lower`: the template's vertices along the lips' rims, both from right to left, corners
    included.
    """

    origin: Floats
    axes: Floats
    along: Floats
    height: Floats
    upper: Ints = field(repr=False)
    lower: Ints = field(repr=False)

    def local(self, points: Floats) -> Floats:
        """Points (n, 3) [mm] in the mouth's axes."""
        return (points - self.origin) @ self.axes.T

    def above(self, points: Floats) -> Floats:
        """How far (n,) [mm] points (n, 3) are above the line; beyond the corners, above its ends."""
        there = self.local(points)
        return there[:, 1] - np.interp(there[:, 0], self.along, self.height)


def rims(triangles: Ints, vertices: Floats, parts: Ints) -> tuple[Ints, Ints]:
    """The template's rim of the mouth's lining, upper and lower half, each from right to left, corners included."""
    loop = find_openings(triangles[(parts[triangles] == MOUTH).any(axis=1)])[0]
    x = vertices[loop]
    loop = np.roll(loop, -int(x[:, 0].argmin()))
    left = int(vertices[loop, 0].argmax())
    one, other = loop[: left + 1], np.append(loop[left:], loop[0])[::-1]
    return (one, other) if vertices[one, 1].mean() > vertices[other, 1].mean() else (other, one)


def lip_line(template: Surface, parts: Ints, registered: Surface, skin: Surface, *, share: float = 1.0) -> LipLine:
    """The line between the lips of `skin` [mm]: the rim of the registered template's mouth, moved into the furrow.

    Of all lines within 4 mm of the template's it is the one that lies deepest, but for what its curves cost; `share` of
    the way there.
    """
    upper, lower = rims(template.triangles, template.vertices, parts)
    right, left = registered.vertices[upper[0]], registered.vertices[upper[-1]]
    s = _unit(left - right)
    normals = registered.vertex_normals[np.concatenate([upper, lower])].mean(axis=0)
    # The rims' own normals point into the mouth as well as out of it: forward is away from the lining.
    lining = registered.vertices[parts == MOUTH].mean(axis=0)
    middle = 0.5 * (right + left)
    forward = middle - lining if normals @ (middle - lining) < 0 else normals + _unit(middle - lining)
    f = _unit(forward - (forward @ s) * s)
    axes = np.stack([s, np.cross(f, s), f])
    line = LipLine(middle, axes, np.zeros(1), np.zeros(1), upper, lower)
    above, below = (line.local(registered.vertices[chain]) for chain in (upper, lower))
    along = np.linspace(above[0, 0], above[-1, 0], SAMPLES)
    height = 0.5 * (_profile(above, along, 1) + _profile(below, along, 1))
    ahead = 0.5 * (_profile(above, along, 2) + _profile(below, along, 2))
    height = height + share * _furrow(skin, line, along, height, ahead)
    return LipLine(middle, axes, along, height, upper, lower)


def _profile(chain: Floats, along: Floats, axis: int) -> Floats:
    order = np.argsort(chain[:, 0], kind="stable")
    return np.interp(along, chain[order, 0], chain[order, axis])


def _furrow(skin: Surface, line: LipLine, along: Floats, height: Floats, ahead: Floats) -> Floats:
    """How far up (k,) [mm] the furrow is of the line: the cheapest way through the depths of the skin (Viterbi)."""
    moves = np.arange(-REACH, REACH + STEP / 2, STEP)
    s, v = np.meshgrid(along, moves, indexing="ij")
    local = np.stack([s, height[:, None] + v, np.broadcast_to(ahead[:, None] + 15.0, s.shape)], axis=-1)
    origins = local.reshape(-1, 3) @ line.axes + line.origin
    tree = TriangleTree(skin.vertices, skin.triangles)
    _, reached = first_hits(tree, origins, np.broadcast_to(-line.axes[2], origins.shape), 30.0)
    depth = np.where(np.isfinite(reached), reached, 30.0).reshape(s.shape)
    # Only what is deeper than the lips around it counts: a parabola across them takes the face's own shape away.
    basis = np.stack([np.ones_like(moves), moves, moves**2], axis=1)
    depth = depth - depth @ np.linalg.pinv(basis).T @ basis.T
    stay = STAY + (CORNER - STAY) * (along / np.abs(along).max()) ** 6
    cost = -depth + stay[:, None] * moves**2
    turn = SMOOTH * (moves[:, None] - moves) ** 2
    total, back = cost[0], []
    for row in cost[1:]:
        ways = total[:, None] + turn
        back.append(ways.argmin(axis=0))
        total = ways.min(axis=0) + row
    at = [int(total.argmin())]
    for before in reversed(back):
        at.append(int(before[at[-1]]))
    return moves[np.array(at[::-1])]


def _unit(vector: Floats) -> Floats:
    return vector / np.linalg.norm(vector)
