"""The lips of a skin: the line between them, and what ties a registered template to lips that were cut apart."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ..base.geometry.bvh import TriangleTree
from ..base.geometry.cholesky import factorise
from ..base.geometry.rays import first_hits
from ..base.geometry.topology import find_openings, neighbours
from ..base.mesh import Floats, Ints, Surface
from ..identities.space import CAP, MOUTH, OUTSIDE
from ..registration.alignment import FACING
from ..registration.registration import Registration, barycentric_matrix, replace_rows, skin_ties, template_ties
from ..wraps.columns import edge_graph, unit
from ..wraps.landmarks import Mask
from .slit import Slit

SAMPLES = 61
REACH, STEP = 4.0, 0.2
"""[mm] How far from the template's line the furrow between the lips is looked for, and in which steps."""
SMOOTH, STAY, CORNER = 4.0, 0.004, 0.1
"""What a sideways step of the line costs, and its distance from the template's, in depth [mm]; the latter at the
corners too, where the furrow ends."""
ON_LIP = 12.0
"""[mm] Along the template's skin, so far from the rim of a lip is that lip."""
BESIDE = 3.0
"""[mm] Nearer than this to the cut a skin goes ever more with the rim, so that no spikes are left between the two."""
CORNERS = 12.0
"""[mm] Nearer than this to an end of the cut a skin's motion is harmonic along the skin. Where each vertex had that of
its closest point, a mouth's corners crumpled: 322 mm of folded edges in place of 78; other heads have 0 to 61. Over
the whole of the lips it takes the shape from a funnel."""
SHORTEST = 0.05
"""[mm] Shorter edges count as this long."""
LEAST = 1e-4
"""Smaller weights are left out."""


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
        local = self.local(points)
        return local[:, 1] - np.interp(local[:, 0], self.along, self.height)


def split_rim(triangles: Ints, vertices: Floats, parts: Ints) -> tuple[Ints, Ints]:
    """Split the template's rim of the mouth's lining: upper and lower half, from right to left, corners included."""
    loop = find_openings(triangles[(parts[triangles] == MOUTH).any(axis=1)])[0]
    loop = np.roll(loop, -int(vertices[loop, 0].argmin()))
    left = int(vertices[loop, 0].argmax())
    one, other = loop[: left + 1], np.append(loop[left:], loop[0])[::-1]
    return (one, other) if vertices[one, 1].mean() > vertices[other, 1].mean() else (other, one)


def find_lip_line(template: Surface, parts: Ints, registered: Surface, skin: Surface, *, share: float = 1.0) -> LipLine:
    """Find the line between the lips of `skin` [mm]: the registered template's rim of the mouth, moved to the furrow.

    Of all lines within 4 mm of the template's it is the one that lies deepest, but for what its curves cost; `share` of
    the way there.
    """
    upper, lower = split_rim(template.triangles, template.vertices, parts)
    right, left = registered.vertices[upper[0]], registered.vertices[upper[-1]]
    s = unit(left - right)
    normals = registered.vertex_normals[np.concatenate([upper, lower])].mean(axis=0)
    # The rims' own normals point into the mouth as well as out of it: forward is away from the lining.
    lining = registered.vertices[parts == MOUTH].mean(axis=0)
    middle = 0.5 * (right + left)
    forward = middle - lining if normals @ (middle - lining) < 0 else normals + unit(middle - lining)
    f = unit(forward - (forward @ s) * s)
    axes = np.stack([s, np.cross(f, s), f])
    line = LipLine(middle, axes, np.zeros(1), np.zeros(1), upper, lower)
    rims = [line.local(registered.vertices[chain]) for chain in (upper, lower)]
    along = np.linspace(rims[0][0, 0], rims[0][-1, 0], SAMPLES)

    def mean_profile(axis: int) -> Floats:
        profiles = []
        for rim in rims:
            order = np.argsort(rim[:, 0], kind="stable")
            profiles.append(np.interp(along, rim[order, 0], rim[order, axis]))
        return 0.5 * (profiles[0] + profiles[1])

    height = mean_profile(1)
    height = height + share * _furrow(skin, line, along, height, mean_profile(2))
    return LipLine(middle, axes, along, height, upper, lower)


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


def chain_shares(along: Floats) -> Floats:
    """Give places along a chain as shares from 0 to 1, ever rising."""
    rising = np.maximum.accumulate(along) + 1e-9 * np.arange(len(along))
    return (rising - rising[0]) / (rising[-1] - rising[0])


def tie_lips(
    template: Surface,
    parts: Ints,
    laid: Registration,
    line: LipLine,
    skin: Surface,
    opened: Surface,
    cut: Slit,
    pocket: Ints,
    near: Mask,
    above: Floats,
) -> Registration:
    """Tie the registered template to the opened skin, the upper lip to what is above the cut, the lower to the rest.

    The cut's sides, and what is near them, go with the rims of the template's lips, the `pocket` (template vertices)
    with its lining. `skin` is as before the cut, `near` (its vertices,) the mouth's zone, and `above` (its vertices,)
    positive over the cut.
    """
    n, old, m = len(parts), len(near), len(opened.vertices)
    surface, visible_end = laid.surface, m - len(pocket)
    visible = (parts[template.triangles] != MOUTH).all(axis=1)
    # Beyond the corners both lips are one skin.
    between = [np.abs(line.local(x)[:, 0]) < line.along[-1] for x in (surface.vertices, skin.vertices)]
    lips = np.where(between[0], lips_of_vertices(template, parts, line), 0)
    side_of = np.zeros(m)
    side_of[:old] = np.where(near & between[1], np.sign(above), 0.0)
    to_skin = skin_ties(surface, skin)
    to_template = template_ties(surface, opened, parts == CAP)
    cut_rows = csr_matrix((visible_end - old, n))
    # The skin's own triangles, without pocket and strips.
    front = (opened.triangles < visible_end).all(axis=1)
    rims = np.append(line.upper, line.lower)
    for side, edge, other, rim in ((1, cut.upper, cut.lower, line.upper), (-1, cut.lower, cut.upper, line.lower)):
        on_edge, on_rim = line.local(opened.vertices[edge]), line.local(surface.vertices[rim])
        with_rim = _between_neighbours(on_edge, on_rim, rim, n)
        cut_rows = replace_rows(cut_rows, edge - old, with_rim)
        mine = np.flatnonzero(side_of == side)
        points, normals = opened.vertices[mine], opened.vertex_normals[mine]
        own = _closest(surface, visible & (lips[template.triangles] != -side).all(axis=1), points, normals)
        away, nearest = cKDTree(opened.vertices[edge]).query(points)
        share = np.clip(1 - away / BESIDE, 0.0, 1.0)
        to_skin = replace_rows(to_skin, mine, diags(1 - share) @ own + diags(share) @ with_rim[nearest])
        # The cut's ends belong to both sides.
        beyond = np.isin(opened.triangles, np.setdiff1d(other, edge)).any(axis=1)
        kept = front & (side_of[opened.triangles] != -side).all(axis=1) & ~beyond
        lip = np.flatnonzero((lips == side) & ~np.isin(np.arange(n), rims))
        closest = _closest(opened, kept, surface.vertices[lip], surface.vertex_normals[lip])
        to_template = replace_rows(to_template, lip, closest)
        to_template = replace_rows(to_template, rim, _between_neighbours(on_rim, on_edge, edge, m))
    lining = np.flatnonzero(parts == MOUTH)
    number = np.full(n, -1)
    number[pocket] = np.arange(visible_end, m)
    of_pocket = csr_matrix((np.ones(len(lining)), (np.arange(len(lining)), number[lining])), shape=(len(lining), m))
    own = csr_matrix((np.ones(len(pocket)), (np.arange(len(pocket)), pocket)), shape=(len(pocket), n))
    weights = _relax_corners(opened, cut, visible_end, vstack([to_skin, cut_rows, own]).tocsr())
    return replace(laid, skin_weights=weights, template_weights=replace_rows(to_template, lining, of_pocket))


def _relax_corners(opened: Surface, cut: Slit, visible_end: int, weights: csr_matrix) -> csr_matrix:
    """Replace the weights of the skin near the cut's ends, but for its sides, by harmonic means of those around."""
    x = opened.vertices
    free = (cKDTree(x[cut.upper[[0, -1]]]).query(x)[0] < CORNERS) & (np.arange(len(x)) < visible_end)
    free[np.union1d(cut.upper, cut.lower)] = False
    pairs = neighbours(opened.triangles, len(x)).tocoo()
    length = np.maximum(np.linalg.norm(x[pairs.row] - x[pairs.col], axis=1), SHORTEST)
    on_skin = (pairs.row < visible_end) & (pairs.col < visible_end)
    springs = csr_matrix((on_skin / length, (pairs.row, pairs.col)), shape=pairs.shape)
    rows = (diags(np.asarray(springs.sum(axis=1)).ravel() + 1e-9) - springs).tocsr()[free]
    around = rows[:, ~free]
    border = np.flatnonzero(np.asarray(abs(around).sum(axis=0)).ravel())
    share = factorise(rows[:, free].tocsc())(np.asarray(-around[:, border].todense()))
    share = np.where(share > LEAST, share, 0.0)
    total = share.sum(axis=1)
    # A vertex that no edge ties to the skin around keeps its weights.
    tied = total > 0.5
    follow = csr_matrix(share[tied] / total[tied, None]) @ weights[np.flatnonzero(~free)[border]]
    return replace_rows(weights, np.flatnonzero(free)[tied], follow)


def lips_of_vertices(template: Surface, parts: Ints, line: LipLine) -> Ints:
    """1 for the template's visible vertices nearer to the upper lip's rim along the skin, -1 to the lower's, else 0."""
    graph = edge_graph(template.vertices, template.triangles[(parts[template.triangles] == OUTSIDE).all(axis=1)])
    up, down = (
        dijkstra(graph, directed=False, indices=chain[1:-1], min_only=True, limit=2 * ON_LIP)
        for chain in (line.upper, line.lower)
    )
    lips = np.where(np.minimum(up, down) < ON_LIP, np.where(up < down, 1, -1), 0)
    lips[parts != OUTSIDE] = 0
    lips[[line.upper[0], line.upper[-1]]] = 0
    return lips


def _closest(surface: Surface, kept: Mask, points: Floats, normals: Floats) -> csr_matrix:
    """Weights of the closest point that faces alike, else of the closest, in some of a surface's triangles."""
    triangles = surface.triangles[kept]
    faces = unit(surface.face_normals[kept])
    tree = TriangleTree(surface.vertices, triangles)
    triangle, weights, _ = tree.closest_facing(points, normals, faces, FACING)
    lost = triangle < 0
    triangle[lost], weights[lost], _ = tree.closest(points[lost])
    return barycentric_matrix(triangles[triangle], weights, (len(points), len(surface.vertices)))


def _between_neighbours(points: Floats, chain: Floats, ids: Ints, size: int) -> csr_matrix:
    """Weights (points, size) of the two neighbours in a chain between which each point lies, from end to end."""
    at, places = chain_shares(points[:, 0]), chain_shares(chain[:, 0])
    after = np.clip(np.searchsorted(places, at), 1, len(ids) - 1)
    share = np.clip((at - places[after - 1]) / (places[after] - places[after - 1]), 0.0, 1.0)
    rows = np.tile(np.arange(len(points)), 2)
    values = np.append(1 - share, share)
    return csr_matrix((values, (rows, np.append(ids[after - 1], ids[after]))), shape=(len(points), size))
