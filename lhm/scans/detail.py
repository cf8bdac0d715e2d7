"""A scan's detail beyond a registered skin: heights over the fine skin, along its normals, and colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, diags

from ..base.files.texture import Texture
from ..base.geometry.bvh import TriangleTree
from ..base.geometry.cholesky import factorise_definite
from ..base.geometry.rays import first_hits, visible_sky
from ..base.geometry.topology import graph_laplacian, neighbours, unique_edges
from ..base.mesh import Floats, Surface, unit
from ..head.detail import Detail, FineSkin
from ..identities.space import OUTSIDE
from ..template.template import Template
from ..template.wraps.landmarks import Mask, distance_to


@dataclass(frozen=True)
class DetailPolicy:
    """Constants of the detail that is taken from a scan."""

    reach: float = 4.0  # [mm] of a height: what lies farther off is no detail of this skin
    facing: float = 0.5  # cosine between the normals of fine skin and scan
    seen: float = 0.15  # of the sky: folds of ears and nostrils have no counterpart
    lips: tuple[float, float] = (3.0, 9.0)  # [mm] from the rim of the mouth: without detail up to the first
    lids: tuple[float, float] = (6.0, 12.0)  # [mm] from the lids' rims, whose shape is the template's
    smooth: float = 0.15  # weight of an edge's squared difference of heights beside a vertex' own
    outlier: float = 1.0  # [mm] off the heights around, beyond which a vertex' own does not count
    calm: float = 30.0  # `smooth` of the heights that outliers are told by
    fades: float = 1e-3  # weight of no height at all, where the scan has nothing near
    turned: float = 0.3  # cosine between a triangle with and without its heights: below, it folds
    halvings: int = 6  # of heights that fold


POLICY = DetailPolicy()


def lay_detail(template: Template, skin: Surface, scan: Surface, policy: DetailPolicy = POLICY) -> Detail:
    """Measure a scan's heights [mm] over a template's skin that was laid onto it; both upright in mm.

    Lips, lids, hidden folds and inner parts have none. Where the scan has nothing near, heights fade.
    """
    fine = FineSkin.from_skin(skin)
    smooth = fine.refine(skin.vertices)
    if _mean_edge(scan) > _mean_edge(smooth):
        scan = FineSkin.from_skin(scan).refine(scan.vertices)
    heights, met = measure_heights(smooth, scan, policy)
    edges = neighbours(smooth.triangles, len(heights))
    for stiffness in (policy.calm, policy.smooth):
        matrix = stiffness * graph_laplacian(edges) + diags(met + policy.fades)
        even = factorise_definite(matrix.tocsc())((met * heights)[:, None])[:, 0]
        met &= np.abs(heights - even) < policy.outlier
    even *= np.clip(fine.spread(_shares(template, skin, fine, policy)), 0.0, 1.0)
    return Detail(_unfold(smooth, even, edges, policy).astype(np.float32))


def _unfold(smooth: Surface, heights: Floats, edges: csr_matrix, policy: DetailPolicy) -> Floats:
    """Halve the heights (k,) [mm] on and around triangles that they turn over, again and again."""
    normals, before = smooth.vertex_normals, unit(smooth.face_normals)
    for _ in range(policy.halvings):
        moved = smooth.with_vertices(smooth.vertices + heights[:, None] * normals)
        turned = np.einsum("kd,kd->k", unit(moved.face_normals), before) < policy.turned
        hit = np.zeros(len(heights))
        hit[smooth.triangles[turned]] = 1.0
        heights = np.where(hit + edges @ hit > 0.0, 0.5 * heights, heights)
    return heights


def find_colours(skin: Surface, detail: Detail, texture: Texture) -> NDArray[np.uint8] | None:
    """Find the colours (k, 3) of a skin's fine vertices in a scan's texture [mm], by the closest point of the scan.

    What lies beyond the scan, or where it has no texture, takes the face's median. None where nothing has a colour.
    """
    drawn = FineSkin.from_skin(skin, detail).refine(skin.vertices)
    colours, distance = texture.find_colours(drawn.vertices)
    return fill_colours(colours, distance < POLICY.reach)


def fill_colours(colours: Floats, known: NDArray[np.bool_]) -> NDArray[np.uint8] | None:
    """Round colours (k, 3), with the median of those `known` (k,) for the others; None where none is."""
    if not known.any():
        return None
    return np.round(np.where(known[:, None], colours, np.median(colours[known], axis=0))).astype(np.uint8)


def measure_heights(smooth: Surface, scan: Surface, policy: DetailPolicy = POLICY) -> tuple[Floats, Mask]:
    """Find where lines along a surface's normals meet a scan: heights (k,) [mm], and a mask of those that do."""
    points, normals = smooth.vertices, smooth.vertex_normals
    tree, faces = TriangleTree(scan.vertices, scan.triangles), unit(scan.face_normals)
    heights, met = np.zeros(len(points)), np.zeros(len(points), bool)
    for side in (1.0, -1.0):
        which, way = first_hits(tree, points, side * normals, policy.reach)
        faces_alike = (which >= 0) & (np.einsum("kd,kd->k", faces[which], normals) > policy.facing)
        nearer = faces_alike & (~met | (way < np.abs(heights)))
        heights[nearer], met = side * way[nearer], met | nearer
    return heights, met


def _shares(template: Template, skin: Surface, fine: FineSkin, policy: DetailPolicy) -> Floats:
    """The share (n,) of its detail that each vertex of the skin shows: none where the neck is cut."""
    x, landmarks = skin.vertices, template.landmarks
    stays = (np.abs(fine.end_neck(x) - x) < 1e-6).all(axis=1)
    share = ((template.parts == OUTSIDE) & stays & (visible_sky(skin) > policy.seen)).astype(np.float64)
    for rim, (least, most) in ((landmarks.rim, policy.lips), (landmarks.lids, policy.lids)):
        share *= np.clip((distance_to(x, x[rim]) - least) / (most - least), 0.0, 1.0)
    return share


def _mean_edge(surface: Surface) -> float:
    edges = unique_edges(surface.triangles)
    return float(np.linalg.norm(np.diff(surface.vertices[edges], axis=1), axis=2).mean())
