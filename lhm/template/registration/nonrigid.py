"""Non-rigid ICP: a template laid onto a skin, stiff at first and ever softer (Amberg et al., CVPR 2007)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix, diags, hstack, vstack

from ...base.geometry.bvh import TriangleTree
from ...base.geometry.cholesky import factorise_definite
from ...base.geometry.rays import visible_sky
from ...base.geometry.topology import neighbours, unique_edges
from ...base.mesh import Floats, Ints, Surface, unit
from ...base.progress import OnProgress
from ...identities.space import EYES, MOUTH, OUTSIDE
from ..wraps.landmarks import Landmarks, Mask, distance_to
from .alignment import FACING, Target, tukey_weights
from .landmarks import Pairs


@dataclass(frozen=True)
class NonrigidPolicy:
    """Constants of the registration, stage by stage from stiff to soft."""

    stages: int = 13
    stiffest: float = 200.0
    softest: float = 0.1  # with .2 a ragged scan's face is .46 mm off, not .37; slides and transferred shapes are alike
    first_limit: float = 25.0  # [mm] of a match
    last_limit: float = 12.0  # [mm]: a heavy neck is still that far off when the template is soft enough for it
    normals_above: float = 1.0  # stiffness down to which normals count: at first shape tells points apart
    turned: float = 15.0  # [mm] that a unit of difference between normals counts at the stiffest stage
    early_steps: int = 10  # of a stage while normals count
    late_steps: int = 4  # of a later stage
    early_weight: float = 0.5  # of a match while normals count: it may lie beside its point
    gradient_return: float = 0.01  # weight of gradients' return to the start's, within 1 / sqrt(weight) free edges
    tie: float = 4.0  # weight of what should move together, beside the edges' 1
    seen: float = 0.15  # of the sky: what sees less (nostrils, folds of ears) has no counterpart on another head
    late: int = 8  # the stage from which on matches are taken from lips and lids that cross
    repairs: int = 8  # stages more at most, while the surface crosses itself
    landmark: float = 5.0  # weight of a landmark beside a match's 1
    landmark_fades: float = 20.0  # stiffness below which it fades: points picked by hand are not exact
    lids: float = 30.0  # times as stiff as skin: eyes shut where a scan's are stone; faces are .03 mm farther off
    lid_zone: float = 8.0  # [mm] from the lids' rims, within which they are
    lip_zone: float = 4.0  # [mm] from the rim of the mouth
    lip_gap: float = 2.0  # [mm] at most between facing points of two lips
    flap: float = 12.0  # [mm] at most between the mouth's lining and the skin
    near: float = 12.0  # [mm] from the rims of mouth and eyes, within which crossings count early

    @property
    def stiffnesses(self) -> Floats:
        """The stiffness of each stage."""
        return np.geomspace(self.stiffest, self.softest, self.stages)

    @property
    def limits(self) -> Floats:
        """The longest match of each stage [mm]."""
        return np.geomspace(self.first_limit, self.last_limit, self.stages)


POLICY = NonrigidPolicy()
"""The constants as they were measured."""


class SmoothAffine:
    """Positions x_i and gradients A_i (3, 3) of a surface that moves away from a start X, and their stiffness.

    E = sum over edges, both ways, |x_j - x_i - A_i (X_j - X_i)|² + |X_j - X_i|² |A_i - A_j|² / 2, plus per vertex
    gradient_return h² |A_i - I|² with h the mean length of its edges, plus tie |ties (x - X)|² for the rows of `ties`
    (k, n), differences of points that should move together. An edge counts as the smaller `weight` (n,) of its ends.
    But for the last two it vanishes for every affine map of the start (Amberg, Romdhani and Vetter, CVPR 2007, Eq. 4,
    written about each vertex in place of the origin).
    """

    def __init__(
        self,
        start: Floats,
        triangles: Ints,
        ties: csr_matrix,
        weight: Floats | float = 1.0,
        policy: NonrigidPolicy = POLICY,
    ):
        n = self.n = len(start)
        pairs = unique_edges(triangles)
        i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
        along = start[j] - start[i]
        length = np.linalg.norm(along, axis=1)
        h = np.bincount(i, length, n) / np.maximum(np.bincount(i, minlength=n), 1)
        # Unknowns, for each coordinate alike: n positions, then 3 n gradients.
        at_i, at_j = (n + 3 * k[:, None] + np.arange(3) for k in (i, j))
        weight = np.broadcast_to(weight, n)
        edges, root = np.arange(len(i)), np.sqrt(np.minimum(weight[i], weight[j]))
        values = np.concatenate([root, -root, -(root[:, None] * along).ravel()])
        places = np.concatenate([edges, edges, np.repeat(edges, 3)]), np.concatenate([j, i, at_i.ravel()])
        stretch = csc_matrix((values, places), shape=(len(i), 4 * n))
        size, rows = np.repeat(root * length, 3), np.arange(3 * len(i))
        values = np.concatenate([size, -size])
        change = csc_matrix((values, (np.tile(rows, 2), np.append(at_i, at_j))), shape=(3 * len(i), 4 * n))
        back = np.concatenate([np.zeros(n), policy.gradient_return * np.repeat(h**2, 3)])
        tied = hstack([ties, csr_matrix((ties.shape[0], 3 * n))])
        self._matrix = (
            stretch.T @ stretch + 0.5 * change.T @ change + policy.tie * tied.T @ tied + diags(back)
        ).tocsc()
        self._right = back[:, None] * np.vstack([np.zeros((n, 3)), np.tile(np.eye(3), (n, 1))])
        self._right[:n] += policy.tie * (ties.T @ (ties @ start))

    def solve(self, stiffness: float, weights: Floats, targets: Floats) -> Floats:
        """Find the positions (n, 3) [mm] of least stiffness E + sum_i weights_i |x_i - targets_i|²."""
        data = np.concatenate([weights, np.zeros(3 * self.n)])
        right = stiffness * self._right
        right[: self.n] += weights[:, None] * targets
        factor = factorise_definite((stiffness * self._matrix + diags(data)).tocsc())
        return factor(right)[: self.n]


def lay_onto(
    start: Surface,
    parts: Ints,
    places: Landmarks,
    target: Target,
    landmarks: Pairs | None,
    progress: OnProgress,
    *,
    stiff_lids: bool = False,
    policy: NonrigidPolicy = POLICY,
) -> tuple[Floats, int]:
    """Lay a template that stands at `start` onto a skin: its vertices (n, 3) [mm], and how many pairs cross anew.

    `places`: the template's rims of mouth and eyes; `landmarks`: points that its vertices are drawn to, fading.
    Visible vertices are drawn to their matches; those in hidden `parts`, those that see no sky but at the lips, and
    those without a match are carried along. Points of the skin that draw the template too hardly lessen its slides
    (.42 and .53 mm in place of .43 and .54 between two heads), and draw a chin down where there is another below it.
    With `stiff_lids` each eye's lids and socket move nearly as one affine map. Facing points of the two lips keep their
    gap. Where the surface comes to cross itself its vertices lose their match, with more rings in each of up to 8
    rounds, and the round with the fewest crossings counts.
    """
    x, triangles = start.vertices, start.triangles
    weight = np.ones(len(x))
    if stiff_lids:
        weight[(parts == EYES) | (distance_to(x, x[places.lids]) < policy.lid_zone)] = policy.lids
    ties = vstack([lip_ties(start, places.rim, policy), flap_ties(start, parts, policy)]).tocsr()
    model = SmoothAffine(x, triangles, ties, weight, policy)
    edges = neighbours(triangles, len(x))
    pockets = (parts == MOUTH) | (parts == EYES)
    near = pockets | (distance_to(x, x[np.append(places.rim, places.lids)]) < policy.near)
    crossings_before = {tuple(pair) for pair in TriangleTree(x, triangles).self_crossings().tolist()}
    # Lips that touch see no sky, but have to come to lie between those of the skin.
    lips = distance_to(x, x[places.rim]) < policy.lip_zone
    drawn = (parts == OUTSIDE) & ((visible_sky(start) > policy.seen) | lips)

    def lay(x: Floats, stiffness: float, limit: float) -> Floats:
        """Draw the template to its matches within `limit` [mm], at one stiffness."""
        use_normals = stiffness > policy.normals_above
        turned = policy.turned * np.sqrt(stiffness / policy.stiffnesses[0]) if use_normals else 0.0
        match_weight = policy.early_weight if use_normals else 1.0
        for _ in range(policy.early_steps if use_normals else policy.late_steps):
            normals = start.with_vertices(x).vertex_normals
            goals, weights = x.copy(), np.zeros(len(x))
            goals[drawn], distance, matched = target.match(x[drawn], normals[drawn], turned=turned, reach=limit)
            weights[drawn] = matched * tukey_weights(distance, limit) * match_weight
            x = _step(model, goals, weights, landmarks, stiffness, policy)
        return x

    def find_crossings(x: Floats) -> Ints:
        """Find the corners (k, 6) of the pairs of triangles that cross anew."""
        pairs = TriangleTree(x, triangles).self_crossings().tolist()
        return triangles[[pair for pair in pairs if tuple(pair) not in crossings_before]].reshape(-1, 6)

    for stage, (stiffness, limit) in enumerate(zip(policy.stiffnesses, policy.limits, strict=True)):
        x = lay(x, stiffness, limit)
        progress("registering the skin", (stage + 1) / (policy.stages + policy.repairs))
        if policy.late <= stage < policy.stages - 1:
            crossing = find_crossings(x)
            drawn = drawn & ~_around(crossing[near[crossing].any(axis=1)], edges, 1)
    crossing = find_crossings(x)
    best, fewest = x, len(crossing)
    for repair in range(policy.repairs):
        if not len(crossing):
            break
        drawn = drawn & ~_around(crossing, edges, 1 + repair // 2)
        x = lay(x, stiffness, limit)
        crossing = find_crossings(x)
        if len(crossing) < fewest:
            best, fewest = x, len(crossing)
    progress("registering the skin", 1.0)
    return best, fewest


def _step(
    model: SmoothAffine,
    goals: Floats,
    weights: Floats,
    landmarks: Pairs | None,
    stiffness: float,
    policy: NonrigidPolicy,
) -> Floats:
    if landmarks is not None:
        ids, points = landmarks
        more = policy.landmark * min(1.0, stiffness / policy.landmark_fades)
        pulled = weights[ids, None] * goals[ids] + more * points
        weights[ids] += more
        goals[ids] = pulled / weights[ids, None]
    return model.solve(stiffness, weights, goals)


def lip_ties(skin: Surface, rim: Ints, policy: NonrigidPolicy = POLICY) -> csr_matrix:
    """Differences (k, n) between points of one lip, near its `rim`, and the points of the other that they face.

    A template's lips are half a millimetre apart: drawn to a skin one by one they would cross.
    """
    lips = np.flatnonzero(distance_to(skin.vertices, skin.vertices[rim]) < policy.lip_zone)
    return _opposite(skin, lips, skin.triangles, policy.lip_gap, 1.0)


def flap_ties(skin: Surface, parts: Ints, policy: NonrigidPolicy = POLICY) -> csr_matrix:
    """Differences (k, n) between points of the mouth's lining and the visible skin on the other side of lip or cheek.

    The skin is drawn and the lining is not: without ties lips and cheeks would end as thick as chance has it.
    """
    visible = skin.triangles[(parts[skin.triangles] == OUTSIDE).all(axis=1)]
    return _opposite(skin, np.flatnonzero(parts == MOUTH), visible, policy.flap, -1.0)


def _opposite(skin: Surface, points: Ints, triangles: Ints, reach: float, side: float) -> csr_matrix:
    """Rows x_i - sum_c w_c x_c of vertices and the closest point in `triangles` that faces the other way.

    It lies within `reach` [mm], before the vertex (side 1) or behind it (side -1).
    """
    x, normals = skin.vertices, skin.vertex_normals[points]
    faces = unit(Surface(x, triangles).face_normals)
    triangle, weights, distance = TriangleTree(x, triangles).closest_facing(x[points], -normals, faces, FACING)
    corners = triangles[triangle]
    gap = np.einsum("kc,kcd->kd", weights, x[corners]) - x[points]
    used = (triangle >= 0) & (distance < reach) & (side * np.einsum("kd,kd->k", gap, normals) > 0)
    count = int(used.sum())
    rows = np.append(np.arange(count), np.repeat(np.arange(count), 3))
    columns = np.append(points[used], corners[used].ravel())
    values = np.append(np.ones(count), -weights[used].ravel())
    return csr_matrix((values, (rows, columns)), shape=(count, len(x)))


def _around(crossing: Ints, edges: csr_matrix, rings: int) -> Mask:
    hit = np.zeros(edges.shape[0])
    hit[crossing.ravel()] = 1.0
    for _ in range(rings):
        hit = ((edges @ hit + hit) > 0).astype(np.float64)
    return hit > 0
