"""Closed surfaces around bones and muscles, and which bone a point belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from ..base.errors import InputError
from ..base.geometry.bvh import TriangleTree
from ..base.geometry.distance import SignedDistance
from ..base.geometry.topology import join_surfaces
from ..base.mesh import Floats, Ints, Surface
from ..head.head import CRANIUM, FREE, MANDIBLE
from .bodyparts import Anatomy


@dataclass(frozen=True)
class EnvelopePolicy:
    """Lengths [mm] by which bones and muscles become closed surfaces, and how fine these are."""

    skull_closing: float = 9.0  # radius of the ball that bridges gaps
    muscle_closing: float = 4.5
    brain: float = 20.0  # radius of a ball that fits into the braincase but not through the foramen magnum
    fascia: float = 0.8  # of the muscle surface outside muscles and bone: periosteum, galea and fascia
    skull_clearance: float = 1.5  # inside the skin
    muscle_clearance: float = 1.0
    near_bone: float = 3.0  # farther points belong to no bone
    spacing: float = 1.5  # between grid points
    exact: float = 2.5  # spacings about a surface within which distances are exact
    most_triangles: int = 40_000


POLICY = EnvelopePolicy()
"""The constants as they were measured."""


def skull_surface(anatomy: Anatomy, skin: Surface, *, policy: EnvelopePolicy = POLICY) -> Surface:
    """Close skull and teeth to one filled body [mm]: orbits, temporal fossae, cheek arches and braincase closed.

    What comes closer than 1.5 mm to the skin, the linings of its pockets included, is cut away: the mouth of a game
    head is a bag that takes the place of the teeth and of the jaws' alveolar parts.
    """
    bones = [anatomy.cranium, anatomy.mandible]
    return closed_envelope(
        bones,
        closing=policy.skull_closing,
        spacing=policy.spacing,
        cavity=policy.brain,
        within=skin,
        clearance=policy.skull_clearance,
    )


def muscle_surface(anatomy: Anatomy, skin: Surface, skull: Surface, *, policy: EnvelopePolicy = POLICY) -> Surface:
    """Close the skull surface with all muscles on it as one filled body [mm], at least 1 mm inside the skin."""
    bodies = [skull, *anatomy.muscles.values()]
    return closed_envelope(
        bodies,
        closing=policy.muscle_closing,
        spacing=policy.spacing,
        inflate=policy.fascia,
        within=skin,
        clearance=policy.muscle_clearance,
    )


def bone_at(anatomy: Anatomy, points: Floats, *, near: float = POLICY.near_bone) -> Ints:
    """Label points FREE, CRANIUM or MANDIBLE, shape (k,): the nearer bone, or none where both are beyond `near`."""
    bones = (anatomy.cranium, anatomy.mandible)
    distance = np.stack([TriangleTree(bone.vertices, bone.triangles).closest(points)[2] for bone in bones])
    nearer = np.where(distance[0] <= distance[1], CRANIUM, MANDIBLE)
    return np.where(distance.min(axis=0) <= near, nearer, FREE)


def closed_envelope(
    surfaces: Sequence[Surface],
    *,
    closing: float,
    spacing: float = POLICY.spacing,
    cavity: float = 0.0,
    inflate: float = 0.0,
    within: Surface | None = None,
    clearance: float = 0.0,
    smallest: float | None = None,
) -> Surface:
    """Lay a closed surface, normals outward, around surfaces that may be open, cross or lie apart. All in mm.

    The morphological closing of their union by a ball of radius `closing`: gaps narrower than its diameter are bridged
    and what is then enclosed is filled; so is an inner cavity that holds a ball of radius `cavity` and has no opening
    for it. The result is larger by `inflate`, keeps `clearance` inside the closed surface `within` where that is thick
    enough, and is the largest connected piece, or all that are larger than `smallest` [mm³]. Details finer than
    `spacing` are lost, and at most 40,000 triangles are kept. Raises InputError for lengths that are not positive, or
    if nothing is left.
    """
    if not (closing > 0 and spacing > 0 and cavity >= 0 and inflate >= 0 and clearance >= 0):
        raise InputError(
            f"closed_envelope: closing {closing:g} and spacing {spacing:g} must be positive, cavity {cavity:g}, "
            f"inflate {inflate:g} and clearance {clearance:g} not negative"
        )
    if not surfaces:
        raise InputError("closed_envelope: no surfaces given")
    joined = join_surfaces(surfaces)
    vertices, triangles = joined.vertices, joined.triangles
    grid = _Grid(vertices, spacing, max(closing + inflate, cavity) + 4 * spacing)
    out = closing + inflate
    tree = TriangleTree(vertices, triangles)
    coarse = grid.distance_from(grid.marked(tree.corners))
    field = grid.refined(coarse, out, lambda p: tree.closest(p)[2]) - out
    if cavity:
        field = np.minimum(field, grid.distance_from(grid.enclosed(coarse, cavity)) - out)
    shut_in = ndimage.binary_fill_holes(field < 0) & (field >= 0)
    field[shut_in] = -spacing
    grown = closed_surface(field, grid.origin, spacing)
    # Back by `closing`: what is left is at least so far from the grown body's surface.
    outline = TriangleTree(grown.vertices, grown.triangles)
    depth = grid.distance_from(field >= 0)
    field = np.where(field < 0, closing - grid.refined(depth, closing, lambda p: outline.closest(p)[2]), spacing)
    if within is not None:
        field = np.maximum(field, grid.signed(within, clearance) + clearance)
    field = _large(field, spacing, smallest)
    if not (field < 0).any():
        raise InputError(f"closed_envelope: nothing is left at a spacing of {spacing:g} mm")
    surface = closed_surface(field, grid.origin, spacing, most=POLICY.most_triangles)
    return surface if within is None else _keep_inside(surface, within, clearance)


class _Grid:
    """A regular grid around points [mm], with distances that are exact near the level where they matter."""

    def __init__(self, points: Floats, spacing: float, margin: float):
        self.spacing = spacing
        self.origin = points.min(axis=0) - margin
        self.shape = tuple(np.ceil((np.ptp(points, axis=0) + 2 * margin) / spacing).astype(int) + 1)

    def marked(self, corners: Floats) -> np.ndarray:
        """Mark the grid points nearest to samples of triangles (m, 3, 3) that leave no hole."""
        mask = np.zeros(self.shape, bool)
        edge = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        parts = np.maximum(np.ceil(edge / (0.5 * self.spacing)).astype(int), 1)
        for count in np.unique(parts):
            steps = np.array([(i, j, count - i - j) for i in range(count + 1) for j in range(count + 1 - i)]) / count
            samples = np.einsum("sc,mcd->msd", steps, corners[parts == count]).reshape(-1, 3)
            place = np.rint((samples - self.origin) / self.spacing).astype(int)
            place = place[((place >= 0) & (place < self.shape)).all(axis=1)]
            mask[tuple(place.T)] = True
        return mask

    def distance_from(self, mask: np.ndarray) -> Floats:
        """Distance [mm] from every grid point to the nearest marked one."""
        if not mask.any():
            return np.full(self.shape, np.inf)
        return ndimage.distance_transform_edt(~mask, sampling=self.spacing)

    def refined(self, coarse: Floats, level: float, exact) -> Floats:
        """`coarse`, replaced by `exact` at the points within a few spacings of `level`."""
        near = np.argwhere(np.abs(coarse - level) < POLICY.exact * self.spacing)
        field = coarse.copy()
        field[tuple(near.T)] = exact(self.origin + self.spacing * near)
        return field

    def enclosed(self, coarse: Floats, radius: float) -> np.ndarray:
        """The balls of this radius that fit where nothing is marked, but are shut in."""
        wall = coarse <= radius
        core = ndimage.binary_fill_holes(wall) & ~wall
        return self.distance_from(core) < radius - self.spacing

    def signed(self, surface: Surface, clearance: float) -> Floats:
        """Signed distance [mm] to a closed surface, exact where it is about -`clearance`."""
        coarse = self.distance_from(self.marked(surface.vertices[surface.triangles]))
        near = coarse < clearance + POLICY.exact * self.spacing
        phi = SignedDistance(surface)
        field = coarse.copy()
        field[near] = phi(self.origin + self.spacing * np.argwhere(near))[0]
        # Far from the surface one point tells the side of all that it is connected with.
        pieces, count = ndimage.label(~near)
        first = np.array([np.argmax(pieces == k) for k in range(1, count + 1)], dtype=np.int64)
        points = np.stack(np.unravel_index(first, self.shape), axis=1)
        inner = phi(self.origin + self.spacing * points)[0] < 0
        return np.where(np.append(False, inner)[pieces], -field, field)


def _keep_inside(surface: Surface, within: Surface, clearance: float) -> Surface:
    """Move back vertices that smoothing has brought closer than `clearance` to the skin."""
    phi = SignedDistance(within)
    x = surface.vertices.copy()
    for _ in range(3):
        distance, outward, _, _ = phi(x)
        x -= np.maximum(distance + clearance, 0.0)[:, None] * outward
    return surface.with_vertices(x)


def _large(field: Floats, spacing: float, smallest: float | None) -> Floats:
    pieces, count = ndimage.label(field < 0)
    if count == 0:
        return field
    volume = np.bincount(pieces.ravel())[1:] * spacing**3
    kept = volume >= (volume.max() if smallest is None else smallest)
    return np.where(np.append(True, kept)[pieces], field, spacing)


def closed_surface(field: Floats, origin: Floats, spacing: float, *, most: int | None = None) -> Surface:
    """Return the closed surface around where `field` (i, j, k) is negative, normals outward, by marching cubes.

    Point (a, b, c) of the grid lies at origin + spacing (a, b, c) [mm]. With `most`, the surface is smoothed by Taubin
    (SIGGRAPH 1995) and has at most so many triangles.
    """
    import pyvista

    values = np.clip(np.pad(field, 1, constant_values=np.inf), -4 * spacing, 4 * spacing)
    # No vertex of the surface lies on a point of the grid.
    values = np.where(values < 0, np.minimum(values, -1e-3 * spacing), np.maximum(values, 1e-3 * spacing))
    grid = pyvista.ImageData(dimensions=values.shape, spacing=(spacing,) * 3, origin=tuple(origin - spacing))
    grid["field"] = values.ravel(order="F")  # type: ignore[assignment]
    mesh: Any = grid.contour([0.0], scalars="field", method="flying_edges")
    if most is not None:
        mesh = mesh.smooth_taubin(n_iter=16, pass_band=0.1)
        if mesh.n_cells > most:
            # VTK now and then folds two triangles onto an edge, at one size and not at the next.
            sizes = most * np.linspace(1.0, 0.8, 9)
            simpler = (mesh.decimate_pro(1.0 - size / mesh.n_cells, preserve_topology=True) for size in sizes)
            mesh = next((each for each in simpler if each.is_manifold), mesh)
    return Surface(mesh.points, mesh.faces.reshape(-1, 4)[:, :0:-1])
