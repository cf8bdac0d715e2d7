"""Bones and muscles placed inside a skin: aligned by landmarks, then warped to plausible soft-tissue depths."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.distance import cdist

from ..base.geometry.bvh import TriangleTree
from ..base.geometry.distance import SignedDistance
from ..base.geometry.topology import find_openings, keep_triangles
from ..base.geometry.warp import Similarity, TriharmonicWarp, farthest_points, fit_similarity
from ..base.mesh import Floats, Ints, Surface
from ..identities.cut import close_loop
from ..identities.space import EYES, MOUTH
from ..template.wraps.depth import mean_depth
from ..template.wraps.landmarks import Landmarks, Mask, find_landmarks
from .bodyparts import Anatomy
from .envelope import POLICY as ENVELOPE
from .envelope import closed_envelope


@dataclass(frozen=True)
class PlacementPolicy:
    """Constants of the placement; lengths in mm."""

    coarse: float = 3.0  # the grid on which the bones' outside is found
    on_bone: float = 1.5  # from bone, up to which a point of that outside counts as bone
    chin: float = 10.5  # depth in the mid-plane at the chin's foremost point
    below_chin: float = 9.0  # depth at its foremost and lowest point
    lip: float = 11.0  # from the lips to the upper incisors' edge
    overlap: float = 1.0  # by which the upper incisors' edges are below the lips' line
    joint_gap: float = 1.0  # by which a fossa is widened for its condyle
    thinnest: float = 0.85  # of the published mean depth, whose standard deviation is about a quarter of it
    thickest: float = 1.15  # likewise
    least: float = 2.0  # of depth
    facing: float = 0.7  # cosine of bone with the direction to the skin, above which published depths speak
    landmark_reach: float = 30.0
    centres: int = 400  # of the warp
    spreads: tuple[float, ...] = (40.0, 25.0, 15.0, 10.0)  # over which a correction of depth is spread
    rounds: int = 6  # of corrections with each of these
    muscle_depth: float = 1.5  # of muscles inside the skin
    outside_head: float = 8.0  # outside the skin, from which on a muscle is cut away
    pushes: int = 12  # of muscles to their depth


POLICY = PlacementPolicy()
"""The constants as they were measured."""


@dataclass(frozen=True, eq=False)
class Depths:
    """Soft-tissue depth over exposed bone: `points` (k, 3), `depth` and `wanted` (k,), all in mm.

    `near_skin` masks the points for which published depths speak: bone that faces the skin closest to it.
    """

    points: Floats
    depth: Floats
    wanted: Floats
    near_skin: Mask = field(repr=False)


@dataclass(frozen=True, eq=False)
class Placement:
    """Anatomy inside a skin, and its depths after the alignment alone and after the warp."""

    anatomy: Anatomy
    aligned: Depths
    warped: Depths


def place(anatomy: Anatomy, skin: Surface, parts: Ints, policy: PlacementPolicy = POLICY) -> Placement:
    """Place anatomy inside a closed neutral skin whose vertices' parts are known (see `identities.space`).

    A similarity brings eyes, incisors, chin and vault to the skin's; then one triharmonic warp moves exposed bone
    along the direction to the closest skin until its depth is within bounds about the published means, with eyes and
    incisors held. The condyles, which touch the temporal bones in the data, are pushed out of them. Muscles follow,
    are cut where they leave the head, and pushed to `policy.muscle_depth` inside the skin.
    """
    outer = close_pockets(skin, parts)
    landmarks = find_landmarks(skin, parts)
    tissue = _Tissue(SignedDistance(outer), landmarks, _visible(skin, parts).sum(), policy)
    outside = closed_envelope(
        [anatomy.cranium, anatomy.mandible], closing=ENVELOPE.skull_closing, spacing=policy.coarse
    )
    exposed = _find_on_bone(anatomy, outside, policy.on_bone)
    normals = outside.vertex_normals[exposed]
    held = _places(anatomy)
    goals = _goals(outer, landmarks, policy)
    similar = _align(tissue, outside.vertices[exposed], normals, held, goals)
    start, normals = similar(outside.vertices[exposed]), normals @ similar.rotation.T
    chosen = farthest_points(start, policy.centres, np.array([0]))
    held = similar(held)
    near = np.exp(-((cdist(start[chosen], held) / policy.landmark_reach) ** 2))
    guided = start[chosen] + near @ (goals - held) / np.maximum(near.sum(axis=1, keepdims=True), 1.0)
    moved = _pull(tissue, start[chosen], guided, normals[chosen])
    # The chin's places are led by the landmarks, but as depth there is known they are not held to a point.
    centres = np.vstack([held[:3], start[chosen]])
    warp = TriharmonicWarp(centres)
    coefficients = warp.coefficients(np.vstack([goals[:3], moved]) - centres)

    def warped(points: Floats) -> Floats:
        return np.vstack([p + warp.basis(p) @ coefficients for p in np.array_split(points, len(points) // 4000 + 1)])

    placed = _joints_opened(anatomy.moved(lambda points: warped(similar(points))), policy.joint_gap)
    muscles = {name: _inside(muscle, tissue.phi, policy) for name, muscle in placed.muscles.items()}
    kept = {name: muscle for name, muscle in muscles.items() if muscle is not None}
    return Placement(
        replace(placed, muscles=kept), tissue.depths(start, normals), tissue.depths(warped(start), normals)
    )


def close_pockets(skin: Surface, parts: Ints) -> Surface:
    """Close the visible skin over mouth and eye sockets by lids across their rims, which come last."""
    triangles = skin.triangles[_visible(skin, parts)]
    vertices = skin.vertices
    for loop in find_openings(triangles):
        weights, lid = close_loop(loop, len(vertices))
        vertices, triangles = np.vstack([vertices, weights @ vertices]), np.vstack([triangles, lid])
    return keep_triangles(Surface(vertices, triangles), np.full(len(triangles), True))


def _visible(skin: Surface, parts: Ints) -> Mask:
    return ~np.isin(parts[skin.triangles], (MOUTH, EYES)).any(axis=1)


class _Tissue:
    """Depths under a skin without pockets, against what is published; its triangles from `lids` on are no skin."""

    def __init__(self, phi: SignedDistance, landmarks: Landmarks, lids: int, policy: PlacementPolicy):
        self.phi, self.landmarks, self.lids, self.policy = phi, landmarks, lids, policy

    def depths(self, points: Floats, normals: Floats) -> Depths:
        return self.measure(points, normals)[0]

    def measure(self, points: Floats, normals: Floats) -> tuple[Depths, Floats]:
        """Measure depths and the direction to the closest skin, (k, 3)."""
        phi, outward, triangle, weights = self.phi(points)
        corners = self.phi.tree.vertices[self.phi.tree.triangles[triangle]]
        over = np.einsum("kc,kcd->kd", weights, corners)
        wanted = mean_depth(over, self.landmarks.eyes, self.landmarks.mouth)
        near = (np.einsum("kd,kd->k", normals, outward) > self.policy.facing) | (phi > -self.policy.least)
        return Depths(points, -phi, wanted, near & (triangle < self.lids)), outward

    def excess(self, points: Floats, normals: Floats) -> Floats:
        """Vectors (k, 3) that bring points within the bounds of depth, and zero where nothing is asked for."""
        tissue, outward = self.measure(points, normals)
        policy = self.policy
        least = np.maximum(policy.thinnest * tissue.wanted, policy.least)
        # Deep muscle covers the neck's side of the skull, the fossae and the ramus: no upper bound holds there.
        most = np.where(tissue.depth < 2.5 * tissue.wanted, policy.thickest * tissue.wanted, np.inf)
        wrong = tissue.depth - np.clip(tissue.depth, least, np.maximum(most, least))
        return np.where(tissue.near_skin, wrong, 0.0)[:, None] * outward


def _pull(tissue: _Tissue, start: Floats, x: Floats, normals: Floats) -> Floats:
    """Move control points (k, 3) from `x`: corrections of depth, spread over fewer and fewer neighbours."""
    apart = cdist(start, start)
    for spread in np.repeat(tissue.policy.spreads, tissue.policy.rounds):
        weight = np.exp(-((apart / spread) ** 2))
        x = x + (weight @ tissue.excess(x, normals)) / weight.sum(axis=1, keepdims=True)
    return x


def _align(tissue: _Tissue, exposed: Floats, normals: Floats, held: Floats, goals: Floats) -> Similarity:
    """Bring landmarks to their goals and the vault to its depth under the scalp."""
    fit = fit_similarity(held, goals)
    vault = exposed[:, 1] > held[0, 1] + 15.0
    source = np.vstack([held, exposed[vault]])
    # Landmarks together weigh as much as the vault.
    weight = np.append(np.full(len(held), vault.sum() / len(held)), np.ones(vault.sum()))
    for _ in range(20):
        x = fit(exposed[vault])
        depths, outward = tissue.measure(x, normals[vault] @ fit.rotation.T)
        target = x + (depths.depth - depths.wanted)[:, None] * outward
        fit = fit_similarity(source, np.vstack([goals, target]), weight)
    return fit


_CHIN_AXES = np.array([[0.0, 0.0, 1.0], [0.0, -(0.5**0.5), 0.5**0.5]])
"""Pogonion is the chin's point farthest to the front, gnathion that farthest to the front and below."""


def _goals(outer: Surface, landmarks: Landmarks, policy: PlacementPolicy) -> Floats:
    """Place eyes, the incisors' edge, pogonion and gnathion belong, shape (5, 3)."""
    x = outer.vertices
    origin = landmarks.eyes.mean(axis=0)
    drop, unit = origin[1] - landmarks.mouth[1], landmarks.face_width
    middle = x[(np.abs(x[:, 0] - origin[0]) < 0.25 * unit) & (x[:, 2] > origin[2] - 0.5 * unit)]
    lips = middle[np.abs(middle[:, 1] - landmarks.mouth[1]) < 0.15 * drop]
    bite = (origin[0], landmarks.mouth[1] - policy.overlap, lips[:, 2].max() - policy.lip)
    below = (origin[1] - middle[:, 1]) / drop
    chin = middle[(below > 1.35) & (below < 2.0)]
    depths = np.array([[policy.chin], [policy.below_chin]])
    tips = chin[(chin @ _CHIN_AXES.T).argmax(axis=0)] - depths * _CHIN_AXES
    tips[:, 0] = origin[0]
    return np.vstack([landmarks.eyes, bite, tips])


def _places(anatomy: Anatomy) -> Floats:
    """Eyes, the incisors' edge, pogonion and gnathion of the anatomy itself, shape (5, 3)."""
    jaw, bite = anatomy.mandible.vertices, anatomy.bite
    # The lower half of the front is bone without teeth.
    chin = jaw[(np.abs(jaw[:, 0] - bite[0]) < 5.0) & (jaw[:, 1] < 0.5 * (jaw[:, 1].min() + bite[1]))]
    tips = chin[(chin @ _CHIN_AXES.T).argmax(axis=0)]
    tips[:, 0] = bite[0]
    return np.vstack([anatomy.eyes, bite, tips])


def _find_on_bone(anatomy: Anatomy, outside: Surface, near: float) -> Ints:
    trees = [TriangleTree(bone.vertices, bone.triangles) for bone in (anatomy.cranium, anatomy.mandible)]
    distance = np.min([tree.closest(outside.vertices)[2] for tree in trees], axis=0)
    return np.flatnonzero(distance < near)


def _joints_opened(anatomy: Anatomy, gap: float) -> Anatomy:
    """The condyles pushed out of the temporal bones until the joints' gap is open; the teeth stay together."""
    jaw, cranium = anatomy.mandible, anatomy.cranium
    low, high = jaw.vertices.min(axis=0), jaw.vertices.max(axis=0)
    # The condyles are the mandible's upper part behind the teeth.
    behind = jaw.vertices[:, 2] < low[2] + 0.3 * (high[2] - low[2])
    condyles = np.flatnonzero(behind & (jaw.vertices[:, 1] > high[1] - 0.35 * (high[1] - low[1])))
    x = jaw.vertices.copy()
    for side in (x[condyles, 0] > anatomy.bite[0], x[condyles, 0] <= anatomy.bite[0]):
        condyle = condyles[side]
        box = x[condyle].min(axis=0) - 10.0, x[condyle].max(axis=0) + 10.0
        near = ((cranium.vertices > box[0]) & (cranium.vertices < box[1])).all(axis=1)
        socket = keep_triangles(cranium, near[cranium.triangles].all(axis=1))
        fossa = closed_envelope([socket], closing=1.5, spacing=0.8, inflate=gap, smallest=0.0)
        phi = SignedDistance(fossa)
        for _ in range(3):
            distance, outward, _, _ = phi(x[condyle])
            x[condyle] += np.maximum(0.3 - distance, 0.0)[:, None] * outward
    return replace(anatomy, mandible=jaw.with_vertices(x))


def _inside(muscle: Surface, phi: SignedDistance, policy: PlacementPolicy) -> Surface | None:
    """A muscle inside the skin, without parts that leave the head; None if nothing is left."""
    x, skin = muscle.vertices, phi.tree.vertices
    # The sharp edge of a neck's cut may be folded and then tells no side; the head's box does.
    boxed = ((x >= skin.min(axis=0)) & (x <= skin.max(axis=0))).all(axis=1)
    kept = (boxed & (phi(x)[0] < policy.outside_head))[muscle.triangles].all(axis=1)
    if not kept.any():
        return None
    muscle = keep_triangles(muscle, kept)
    x = muscle.vertices
    for _ in range(policy.pushes):
        distance, outward, _, _ = phi(x)
        x = x - np.maximum(distance + policy.muscle_depth, 0.0)[:, None] * outward
    return muscle.with_vertices(x)
