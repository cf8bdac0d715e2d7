"""A template's topology on a skin of any other, and what ties the two."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csr_matrix, identity

from ...base.errors import FitError, InputError
from ...base.geometry.bvh import TriangleTree
from ...base.geometry.cholesky import factorise
from ...base.geometry.topology import graph_laplacian, neighbours, open_edges, pick_rows
from ...base.geometry.triangles import barycentric_matrix
from ...base.geometry.warp import fit_similarity
from ...base.mesh import Floats, Ints, Surface, unit
from ...base.progress import OnProgress, silent
from ...head.skin import check_registrable
from ...identities.space import CAP, EYES, MOUTH
from ..wraps.landmarks import Landmarks, Mask, find_landmarks, find_regions
from .alignment import FACING, Target, find_start
from .landmarks import Pairs, check_pairs, check_placed
from .nonrigid import POLICY, NonrigidPolicy, lay_onto


@dataclass(frozen=True)
class RegistrationBounds:
    """Bounds beyond which a registration is refused, and beyond which the template lies on nothing."""

    least_scale: float = 0.7
    most_scale: float = 1.5
    worst_start: float = 5.0  # [mm] mean distance of a face before it is deformed
    worst_face: float = 3.0  # [mm] and after
    matched: float = 4.0  # [mm] farther from the skin a vertex follows those around it
    least_weight: float = 1e-4  # of such a vertex: smaller ones are left out


BOUNDS = RegistrationBounds()


@dataclass(frozen=True)
class Residual:
    """Distance [mm] of the registered face's visible vertices to the skin."""

    mean: float
    p95: float
    max: float


@dataclass(frozen=True, eq=False)
class Registration:
    """A template's topology on a given skin.

    `surface`: the template's triangles over the registered vertices [mm]; `residual` over the visible face;
    `template_weights` (n, skin vertices): displacements of the skin times these are the template's; rows sum to one;
    `crossings`: pairs of triangles that cross and did not in the template.
    """

    surface: Surface
    residual: Residual
    template_weights: csr_matrix = field(repr=False)
    crossings: int

    @property
    def vertices(self) -> Floats:
        """The registered vertices [mm], shape (n, 3)."""
        return self.surface.vertices


def register(
    template_skin: Surface,
    parts: Ints,
    skin: Surface,
    *,
    landmarks: Pairs | None = None,
    stiff_lids: bool = False,
    policy: NonrigidPolicy = POLICY,
    progress: OnProgress = silent,
) -> Registration:
    """Lay a template's skin onto a neutral skin [mm] of any topology, open or closed (about half a minute).

    `parts` (n,) are the template's, OUTSIDE, MOUTH, EYES or CAP; `landmarks` are template vertices and the points
    [mm] on the skin that belong to them, at least four. Without landmarks the skin has to look along +z with +y up,
    as the template does. Visible vertices come to lie on the skin; the mouth's lining, the eye sockets and what
    the skin lacks are carried along smoothly. With `stiff_lids` the lids keep the template's shape, but for an affine
    map of each eye: they shut and part also where the skin's are closed, or stone.

    Raises MeshError for a skin that is empty, not manifold, facing inwards or of another unit; InputError for
    landmarks that are too few, out of range, off the skin or mirrored; FitError if no face is found in the skin or
    the registered face stays off it.
    """
    places, face = find_face(template_skin, parts)
    whole = check_registrable(skin)
    target = Target(whole)
    progress("aligning the skin", 0.0)
    if landmarks is None:
        points, normals = template_skin.vertices[face], template_skin.vertex_normals[face]
        motion, score = find_start(points, normals, target)
        if not BOUNDS.least_scale <= motion.scale <= BOUNDS.most_scale or score > BOUNDS.worst_start:
            raise FitError(
                f"skin: no face found in it (a template {motion.scale:.2g} times its size is {score:.1f} mm off, "
                f"at most {BOUNDS.worst_start:g}); it has to look along +z with +y up, or landmarks be given"
            )
    else:
        landmarks = check_pairs(landmarks, len(template_skin.vertices))
        check_placed(template_skin.vertices, landmarks, whole)
        motion = fit_similarity(template_skin.vertices[landmarks[0]], landmarks[1])
    start = template_skin.with_vertices(motion(template_skin.vertices))
    vertices, crossings = lay_onto(
        start, parts, places, target, landmarks, progress, stiff_lids=stiff_lids, policy=policy
    )
    done = _registration(template_skin.with_vertices(vertices), parts, face, skin, crossings)
    if done.residual.mean > BOUNDS.worst_face:
        raise FitError(
            f"skin: the registered face is {done.residual.mean:.1f} mm off on average (at most {BOUNDS.worst_face:g}); "
            f"is it a head that looks along +z? landmarks help"
        )
    return done


def find_face(template_skin: Surface, parts: Ints) -> tuple[Landmarks, Mask]:
    """Find a template's rims of mouth and eyes, and the mask (n,) of its face; InputError where `parts` have none."""
    if np.shape(parts) != (len(template_skin.vertices),):
        raise InputError(f"parts: expected shape ({len(template_skin.vertices)},), got {np.shape(parts)}")
    if not (parts == MOUTH).any() or not (parts == EYES).any():
        raise InputError("parts: the template needs vertices of the mouth's lining and of the eye sockets")
    places = find_landmarks(template_skin, parts)
    return places, find_regions(template_skin, parts, places)["face"]


def _registration(surface: Surface, parts: Ints, face: Mask, skin: Surface, crossings: int) -> Registration:
    gap = TriangleTree(skin.vertices, skin.triangles).closest(surface.vertices[face])[2]
    residual = Residual(float(gap.mean()), float(np.quantile(gap, 0.95)), float(gap.max()))
    return Registration(surface, residual, template_ties(surface, skin, parts == CAP), crossings)


def template_ties(template: Surface, skin: Surface, lid: Mask) -> csr_matrix:
    """Weights (n, skin vertices): displacements of the skin as those of the template's vertices; rows sum to one.

    A vertex within 4 mm of a point that faces the same way, and is not on an open edge, moves as that does. What the
    skin lacks (the lining of a mouth, eye sockets, a neck) follows harmonically what lies around it, but for the `lid`
    (n,) of the template's neck, which moves as what is farthest from it: with the skull, however much a jaw draws at
    the edge of a neck that ends under the chin.
    """
    weights, distance, facing = _closest(skin, template)
    rim = np.zeros(len(skin.vertices), bool)
    rim[open_edges(skin.triangles).ravel()] = True
    on_rim = np.asarray(weights @ rim.astype(float)).ravel() > 0.99
    lost = ~facing | (distance > BOUNDS.matched) | (on_rim & (distance > 1.0))
    if not lost.any() or lost.all():
        return weights
    below = np.flatnonzero(lost & lid)
    if below.size:
        away = np.linalg.norm(template.vertices - template.vertices[below].mean(axis=0), axis=1)
        crown = np.where(lost, -1.0, away).argmax()
        weights, lost = replace_rows(weights, below, weights[np.full(below.size, crown)]), lost & ~lid
    n = len(template.vertices)
    laplacian = (graph_laplacian(neighbours(template.triangles, n)) + 1e-9 * identity(n)).tocsr()
    inner, around = laplacian[lost][:, lost], laplacian[lost][:, ~lost]
    border = np.flatnonzero(np.asarray(abs(around).sum(axis=0)).ravel())
    filled = factorise(inner.tocsc())(np.asarray(-around[:, border].todense()))
    filled = np.where(filled > BOUNDS.least_weight, filled, 0.0)
    total = filled.sum(axis=1, keepdims=True)
    # A piece of the template of which nothing lies on the skin keeps its closest points.
    reached = total[:, 0] > 0.5
    follow = csr_matrix(filled[reached] / total[reached])
    return replace_rows(weights, np.flatnonzero(lost)[reached], follow @ weights[np.flatnonzero(~lost)[border]])


def replace_rows(matrix: csr_matrix, ids: Ints, rows: csr_matrix) -> csr_matrix:
    """Put `rows` (k, columns) in place of the `ids` (k,) of a matrix."""
    n = matrix.shape[0]
    kept = np.setdiff1d(np.arange(n), ids)
    return (pick_rows(kept, n).T @ matrix[kept] + pick_rows(ids, n).T @ rows).tocsr()


def _closest(surface: Surface, points: Surface) -> tuple[csr_matrix, Floats, np.ndarray]:
    """Weights (points, n) of the closest point on `surface`, its distance [mm], whether it faces the same way."""
    faces = unit(surface.face_normals)
    tree = TriangleTree(surface.vertices, surface.triangles)
    triangle, weights, distance = tree.closest_facing(points.vertices, points.vertex_normals, faces, FACING)
    lost = triangle < 0
    triangle[lost], weights[lost], distance[lost] = tree.closest(points.vertices[lost])
    shape = (len(points.vertices), len(surface.vertices))
    return barycentric_matrix(surface.triangles[triangle], weights, shape), distance, ~lost
