"""A scan's own mesh in its head's place, moved as the head's fine skin moves."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from ..base.errors import InputError, MeshError
from ..base.files.texture import read_texture
from ..base.geometry.bvh import TriangleTree
from ..base.geometry.rays import first_hits
from ..base.geometry.settle import settle_on
from ..base.geometry.topology import unique_edges
from ..base.mesh import Floats, Surface, unit
from ..head.head import LayeredHead
from .detail import POLICY, fill_colours
from .intake import read_at_rest

TURNED = 10.0
"""[mm] that a unit of difference between normals counts beside a distance: an upper lip is not tied to the lower."""
NEAR = 1.0
"""[mm] in the median of a scan to the skin that was laid onto it, 0.1 to 0.3, and of what would settle it."""
POINTS = 4000
"""Points of the scan by which that motion is found."""
TORN, FEW = 0.7, 3
"""Lids count as shut where a blink parts the ends of FEW edges by this share of its largest motion."""
IN_FRONT, DEEP = 60.0, 20.0
"""[mm] from the lips from where an open mouth is looked into, and how far behind them the first surface then lies."""


@dataclass(frozen=True, eq=False)
class OwnMesh:
    """A scan's mesh [mm] where its head is, as its file has it; `weights` (n, k) tie it to the fine skin's vertices.

    colours (n, 3), 0 to 255, of its texture, where it has one.
    """

    surface: Surface
    weights: csr_matrix
    colours: NDArray[np.uint8] | None

    @classmethod
    def read(cls, path: str | os.PathLike[str], head: LayeredHead) -> OwnMesh:
        """Read the scan that a head was fitted to; InputError names the file, and says where it is another."""
        detail, fine = head.detail, head.fine_skin.refine(head.skin.vertices)
        if detail is None or detail.place is None:
            raise InputError(
                f"{path}: the head does not know where it lies in its scan: it has none, or its scan is in its own "
                "triangles, or an earlier version fitted it"
            )
        scan, _ = read_at_rest(path)
        sound = scan.sound
        try:
            surface = Surface(scan.vertices @ detail.place[:, :3].T + detail.place[:, 3], scan.triangles[sound])
        except MeshError as error:
            raise InputError(f"{path}: {error}") from None
        laid = detail.heights != 0.0
        tree = TriangleTree(surface.vertices, surface.triangles)
        off = float(np.median(tree.closest(fine.vertices[laid] if laid.any() else fine.vertices)[2]))
        if off <= NEAR:
            some = np.unique(np.linspace(0, len(surface.vertices) - 1, POINTS).astype(int))
            points, normals = surface.vertices[some], surface.vertex_normals[some]
            skin = TriangleTree(fine.vertices, fine.triangles)
            settled, _ = settle_on(skin, unit(fine.face_normals), points, normals)
            off = float(np.median(np.linalg.norm(settled - points, axis=1)))
        if off > NEAR:
            raise InputError(f"{path}: it lies {off:.3g} mm off the head; is it the scan that the head was fitted to?")
        return cls(surface, _tie(surface, fine), _find_colours(path, surface))

    def has_shut_lids(self, blink: Floats) -> bool:
        """Tell whether a blink (n, 3) [mm] tears the mesh: the scan's lids are shut, or one surface with the eyes."""
        ends = unique_edges(self.surface.triangles)
        apart = np.linalg.norm(np.diff(blink[ends], axis=1)[:, 0], axis=1)
        return np.count_nonzero(apart > TORN * np.linalg.norm(blink, axis=1).max()) >= FEW

    def has_sealed_mouth(self, opened: Floats, lips: Floats) -> bool:
        """Tell whether a surface lies between the lips (k, 3) [mm] of the head, its jaw and the mesh (n, 3) opened."""
        before = lips.mean(axis=0, keepdims=True) + (0.0, 0.0, IN_FRONT)
        _, way = first_hits(TriangleTree(opened, self.surface.triangles), before, np.array([[0.0, 0.0, -1.0]]), np.inf)
        return bool(way[0] < IN_FRONT + DEEP)


def _tie(surface: Surface, fine: Surface) -> csr_matrix:
    """Tie each vertex to the nearest triangle of the fine skin that faces as it does."""
    tree, faces = TriangleTree(fine.vertices, fine.triangles), unit(fine.face_normals)
    triangle, weights, _ = tree.closest_facing(surface.vertices, surface.vertex_normals, faces, -1.0, TURNED)
    count = len(surface.vertices)
    rows = np.repeat(np.arange(count), 3)
    entries = weights.ravel(), (rows, fine.triangles[triangle].ravel())
    return csr_matrix(entries, shape=(count, len(fine.vertices)))


def _find_colours(path: str | os.PathLike[str], surface: Surface) -> NDArray[np.uint8] | None:
    """Find each vertex' colour in the scan's texture; the median where it has none."""
    try:
        texture = read_texture(path, surface.vertices)
    except (InputError, ValueError):  # the fit has told it
        return None
    if texture is None:
        return None
    colours, distance = texture.find_colours(surface.vertices)
    return fill_colours(colours, distance < POLICY.reach)
