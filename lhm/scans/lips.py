"""The line between the lips of a skin, from a template's that was laid onto it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ..base.geometry.bvh import TriangleTree
from ..base.geometry.rays import first_hits
from ..base.geometry.topology import find_openings
from ..base.mesh import Floats, Ints, Surface
from ..identities.space import CAP, MOUTH, OUTSIDE
from ..registration.alignment import FACING
from ..registration.registration import Registration, barycentric, on_skin, on_template, with_rows
from ..wraps.landmarks import Mask
from .slit import Slit

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


# DOC """What ties a registered template to a skin whose mouth was cut open: lip to lip, and rim to rim."""
BESIDE = 3.0
"""[mm] Nearer than this to the cut a skin goes ever more with the rim, so that no spikes are left between the two."""
ON_LIP = 12.0
"""[mm] Along the template's skin, so far from the rim of a lip is that lip."""


def shares(along: Floats) -> Floats:
    """Places along a chain from 0 to 1, ever rising."""
    rising = np.maximum.accumulate(along) + 1e-9 * np.arange(len(along))
    return (rising - rising[0]) / (rising[-1] - rising[0])


def side_by_side(
    template: Surface,
    parts: Ints,
    laid: Registration,
    line: LipLine,
    skin: Surface,
    whole: Surface,
    cut: Slit,
    pocket: Ints,
    near: Mask,
    above: Floats,
) -> Registration:
    """The registration on the opened skin: what is above the cut is tied to the upper lip, what is below to the lower.

    The cut's sides, and what is near them, go with the rims of the template's lips; the pocket with its lining.
    """
    n, old, m = len(parts), len(near), len(whole.vertices)
    surface, visible = laid.surface, (parts[template.triangles] != MOUTH).all(axis=1)
    # Beyond the corners both lips are one skin.
    lips = np.where(np.abs(line.local(surface.vertices)[:, 0]) < line.along[-1], of_lips(template, parts, line), 0)
    to_skin = on_template(surface, skin)
    to_template = on_skin(surface, whole, parts == CAP)
    of_skin = np.zeros(old)
    between = near & (np.abs(line.local(skin.vertices)[:, 0]) < line.along[-1])
    of_skin[between] = np.sign(above[between])
    sides = ((1, cut.upper, line.upper), (-1, cut.lower, line.lower))
    cut_rows = csr_matrix((m - len(pocket) - old, n))
    # The skin's own triangles, without pocket and strips.
    skin_side = np.zeros(m)
    skin_side[:old] = of_skin
    front = (whole.triangles < m - len(pocket)).all(axis=1)
    for side, edge, rim in sides:
        mine = np.flatnonzero(of_skin == side)
        kept = visible & (lips[template.triangles] != -side).all(axis=1)
        points, normals = whole.vertices[mine], whole.vertex_normals[mine]
        with_rim = _along(line.local(whole.vertices[edge]), line.local(surface.vertices[rim]), rim, n)
        away, nearest = cKDTree(whole.vertices[edge]).query(points)
        share = np.clip(1 - away / BESIDE, 0.0, 1.0)
        own = _closest(surface, kept, points, normals)
        to_skin = with_rows(to_skin, mine, diags(1 - share) @ own + diags(share) @ with_rim[nearest])
        mine = np.flatnonzero((lips == side) & ~np.isin(np.arange(n), np.append(line.upper, line.lower)))
        kept = front & (skin_side[whole.triangles] != -side).all(axis=1) & ~_touches(whole.triangles, edge, sides)
        found = _closest(whole, kept, surface.vertices[mine], surface.vertex_normals[mine])
        to_template = with_rows(to_template, mine, found)
        cut_rows = with_rows(cut_rows, edge - old, with_rim)
        followed = _along(line.local(surface.vertices[rim]), line.local(whole.vertices[edge]), edge, m)
        to_template = with_rows(to_template, rim, followed)
    lining = np.flatnonzero(parts == MOUTH)
    number = np.full(n, -1)
    number[pocket] = np.arange(m - len(pocket), m)
    of_pocket = csr_matrix((np.ones(len(lining)), (np.arange(len(lining)), number[lining])), shape=(len(lining), m))
    to_template = with_rows(to_template, lining, of_pocket)
    own = csr_matrix((np.ones(len(pocket)), (np.arange(len(pocket)), pocket)), shape=(len(pocket), n))
    skin_weights = vstack([to_skin, cut_rows, own]).tocsr()
    return replace(laid, skin_weights=skin_weights, template_weights=to_template)


def _touches(triangles: Ints, edge: Ints, sides) -> Mask:
    """Triangles at the other side of the cut; its ends belong to both."""
    other = np.setdiff1d(np.concatenate([chain for _, chain, _ in sides]), edge)
    return np.isin(triangles, other).any(axis=1)


def of_lips(template: Surface, parts: Ints, line: LipLine) -> Ints:
    """1 for the template's visible vertices nearer to the upper lip's rim along the skin, -1 to the lower's, else 0."""
    outside = np.flatnonzero(parts == OUTSIDE)
    number = np.full(len(parts), -1)
    number[outside] = np.arange(len(outside))
    triangles = template.triangles[(parts[template.triangles] == OUTSIDE).all(axis=1)]
    edges = number[np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)]
    x = template.vertices[outside]
    graph = csr_matrix((np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1), edges.T), shape=(len(outside),) * 2)
    up, down = (
        dijkstra(graph, directed=False, indices=number[chain[1:-1]], min_only=True, limit=2 * ON_LIP)
        for chain in (line.upper, line.lower)
    )
    lips = np.zeros(len(parts), dtype=np.int64)
    lips[outside] = np.where(np.minimum(up, down) < ON_LIP, np.where(up < down, 1, -1), 0)
    lips[[line.upper[0], line.upper[-1]]] = 0
    return lips


def _closest(surface: Surface, kept: Mask, points: Floats, normals: Floats) -> csr_matrix:
    """Weights of the closest point that faces alike, else of the closest, in some of a surface's triangles."""
    triangles = surface.triangles[kept]
    faces = surface.face_normals[kept]
    faces = faces / np.maximum(np.linalg.norm(faces, axis=1, keepdims=True), 1e-30)
    tree = TriangleTree(surface.vertices, triangles)
    triangle, weights, _ = tree.closest_facing(points, normals, faces, FACING)
    lost = triangle < 0
    triangle[lost], weights[lost], _ = tree.closest(points[lost])
    return barycentric(triangles[triangle], weights, (len(points), len(surface.vertices)))


def _along(points: Floats, chain: Floats, ids: Ints, size: int) -> csr_matrix:
    """Weights (points, size) of the two neighbours in a chain between which each point lies, from end to end."""
    at, there = shares(points[:, 0]), shares(chain[:, 0])
    after = np.clip(np.searchsorted(there, at), 1, len(ids) - 1)
    share = np.clip((at - there[after - 1]) / (there[after] - there[after - 1]), 0.0, 1.0)
    rows = np.tile(np.arange(len(points)), 2)
    values = np.append(1 - share, share)
    return csr_matrix((values, (rows, np.append(ids[after - 1], ids[after]))), shape=(len(points), size))
