"""What ties a registered template to a skin whose mouth was cut open: lip to lip, and rim to rim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, diags, vstack
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from ..base.geometry.bvh import TriangleTree
from ..base.mesh import Floats, Ints, Surface
from ..identities.space import CAP, MOUTH, OUTSIDE
from ..registration.matching import FACING
from ..registration.registration import Registration
from ..registration.ties import barycentric, on_skin, on_template, with_rows
from ..wraps.landmarks import Mask
from .cutting import Slit
from .lips import LipLine

BESIDE = 3.0
"""[mm] Nearer than this to the cut a skin goes ever more with the rim, so that no spikes are left between the two."""
REACH = 12.0
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
        dijkstra(graph, directed=False, indices=number[chain[1:-1]], min_only=True, limit=2 * REACH)
        for chain in (line.upper, line.lower)
    )
    lips = np.zeros(len(parts), dtype=np.int64)
    lips[outside] = np.where(np.minimum(up, down) < REACH, np.where(up < down, 1, -1), 0)
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
