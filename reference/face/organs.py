"""Eyeballs and teeth as lids, lips and what lines them feel them: rigid surfaces, coarser than those that are drawn.

They lie where `lhm.identities.organs` places them in the neutral skin without p, and clear the skin wrap there. Only
what lids and lips come to is felt: the front of an eyeball, and the teeth before the molars, which lie in the cheeks.
An eyeball fits its socket: where it has less room than its size asks for it is smaller. A scaled bone takes its organs
along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from ...lhm.base.geometry.bvh import TriangleTree
from ...lhm.base.geometry.distance import SignedDistance
from ...lhm.base.geometry.surfaces import geodesic_sphere
from ...lhm.base.geometry.topology import keep_triangles
from ...lhm.base.mesh import Ints, Surface
from ...lhm.head.head import CRANIUM, MANDIBLE, LayeredHead
from ...lhm.identities.anny import has_default_triangles
from ...lhm.identities.organs import TEETH, make_organs
from .. import terms
from .bones import scale_bone
from .parameters import Parameters

BEHIND_LIDS, BEHIND_LIPS = 0.75, 0.3
"""Gap of eyeballs and teeth to the skin wrap at rest [mm]: more than contact keeps, so the neutral face meets none.

Blendshapes draw lids along straight lines, which cut into a ball that fills its socket: it would press them thin.
"""
LEAST = 0.5
"""Share of its size below which an eyeball is left out."""
FRONT = 75.0
"""Degrees from where an eye looks, up to which lids come. Behind, blendshapes draw the socket through the ball."""
FELT = 4
"""Teeth of half a row, from the middle on, that lips reach; the other three lie between the cheeks."""
BALL, CROWN = 5, 2
"""Parts that an icosahedron's edges are cut into: edges of a ball and of a crown are no longer than the wrap's."""


@dataclass(frozen=True, eq=False)
class RigidOrgan:
    """An organ's surface [mm] in the neutral face without p, and the bone it moves with: CRANIUM or MANDIBLE."""

    surface: Surface
    bone: int


def find_organs(head: LayeredHead) -> tuple[RigidOrgan, ...]:
    """Find the eyeballs and the rows of teeth of a head in the default triangles; none in another head.

    What has no room in the head is left out.
    """
    if not has_default_triangles(head.skin):
        return ()
    skin, distance = head.skin.vertices, SignedDistance(head.skin_wrap)
    ball, bud = Surface(*geodesic_sphere(BALL)), Surface(*geodesic_sphere(CROWN))
    left, right, upper, lower = (Surface(organ.place(skin), organ.triangles) for organ in make_organs(ball, bud))
    in_front = ball.vertices[:, 2] >= np.cos(np.radians(FRONT))
    surfaces = {
        CRANIUM: (*(_fit_ball(eye, in_front, distance) for eye in (left, right)), _keep_clear(upper, distance)),
        MANDIBLE: (_keep_clear(lower, distance),),
    }
    return tuple(RigidOrgan(each, bone) for bone, some in surfaces.items() for each in some if each is not None)


def _fit_ball(ball: Surface, in_front: np.ndarray, distance: SignedDistance) -> Surface | None:
    """Shrink a ball [mm] to the room that it has about its centre, and take its front; None where it has too little."""
    centre = ball.vertices.mean(axis=0)
    radius = np.linalg.norm(ball.vertices - centre, axis=1).max()
    share = min(1.0, (float(distance(centre[None])[0][0]) - BEHIND_LIDS) / radius)
    return _take(ball.with_vertices(centre + share * (ball.vertices - centre)), in_front) if share >= LEAST else None


def _keep_clear(row: Surface, distance: SignedDistance) -> Surface | None:
    """Take the front crowns of a row of teeth that are clear of tissue; None where none is."""
    crown = np.repeat(np.arange(TEETH), len(row.vertices) // TEETH)
    is_clear = np.arange(TEETH) % (TEETH // 2) < FELT
    is_clear[crown[distance(row.vertices)[0] < BEHIND_LIPS]] = False
    crossing = distance.tree.crossings(TriangleTree(row.vertices, row.triangles))[:, 0]
    is_clear[crown[row.triangles[crossing]]] = False
    return _take(row, is_clear[crown]) if is_clear.any() else None


def _take(surface: Surface, kept: np.ndarray) -> Surface:
    """Take the triangles all of whose vertices are kept (k,)."""
    return keep_triangles(surface, kept[surface.triangles].all(axis=1))


def make_obstacles(
    head: LayeredHead, parameters: Parameters, organs: Sequence[RigidOrgan], first: int, moving: bool
) -> tuple[terms.Obstacle, ...]:
    """Make obstacles of organs: those of the cranium stand where p scales it, those of the mandible go along with it.

    first: index of the skull wrap's first vertex in the scene; `moving` says that the mandible there is rigid or put in
    place, since otherwise its organs are left out.
    """
    obstacles = []
    for organ in organs:
        surface = organ.surface
        if organ.bone == CRANIUM:
            points = scale_bone(head, parameters, CRANIUM, surface.vertices)
            obstacles.append(terms.Obstacle(surface.with_vertices(points)))
        elif moving:
            obstacles.append(terms.Obstacle(surface, first + _find_carriers(head)))
    return tuple(obstacles)


def _find_carriers(head: LayeredHead) -> Ints:
    """Find four vertices of the mandible in the skull wrap that span it well."""
    mandible = np.flatnonzero(head.bone == MANDIBLE)
    points = head.skull_wrap.vertices[mandible]
    affine = np.column_stack([points - points.mean(axis=0), np.full(len(points), np.ptp(points))])
    _, _, order = qr(affine.T, mode="economic", pivoting=True)
    return mandible[order[:4]]
