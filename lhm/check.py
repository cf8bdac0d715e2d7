"""The gates that a layered head has to pass, each with its figure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from .geometry.bvh import TriangleTree
from .geometry.quality import smallest_dihedrals
from .head import CRANIUM, FREE, MANDIBLE, LayeredHead
from .mesh import Floats, Ints
from .wraps.landmarks import Mask

LEAST_THICKNESS = 0.2
LEAST_LIP_PATH = 30.0  # around the corner of a small mouth it is 39 mm, across lips that are bridged under 15
WRAPS = ("skin", "muscle", "skull")


@dataclass(frozen=True)
class HeadReport:
    """Figures of a layered head; lengths in mm, angles in degrees.

    `crossings`: pairs of triangles without a common vertex that cross within and between the wraps;
    `smallest_dihedral`, `share_below_5_degrees`: of all tets; `least_thickness`: shortest way from skin to skull wrap
    along a column; `wrap_to_skin_*`: distance of the skin wrap's vertices in the region "face" to the skin;
    `lip_path`: shortest way along the skin wrap from the middle of the upper lip to that of the lower, which leads
    around the corner of the mouth unless the lips are bridged.
    """

    tets: int
    least_volume: float
    smallest_dihedral: float
    share_below_2_degrees: float
    share_below_5_degrees: float
    least_thickness: float
    mean_thickness: float
    crossings_within_skin_wrap: int
    crossings_within_muscle_wrap: int
    crossings_within_skull_wrap: int
    crossings_skin_muscle: int
    crossings_skin_skull: int
    crossings_muscle_skull: int
    wrap_to_skin_mean: float
    wrap_to_skin_95: float
    wrap_to_skin_max: float
    lip_path: float
    cranium_vertices: int
    mandible_vertices: int
    free_vertices: int

    @property
    def problems(self) -> tuple[str, ...]:
        """The gates that are not passed, each named with its figure; empty for a head that is fit for use."""
        found = []
        for name, count in vars(self).items():
            if name.startswith("crossings") and count:
                found.append(f"{name.replace('_', ' ')}: {count} pairs of triangles (must be 0)")
        if not self.least_volume > 0:
            found.append(f"smallest tet: {self.least_volume:.3g} mm³ (must be positive)")
        if self.least_thickness < LEAST_THICKNESS:
            found.append(f"least thickness: {self.least_thickness:.3g} mm (at least {LEAST_THICKNESS})")
        if self.lip_path < LEAST_LIP_PATH:
            found.append(f"upper to lower lip: {self.lip_path:.3g} mm along the skin (at least {LEAST_LIP_PATH:g})")
        return tuple(found)


def check_head(head: LayeredHead) -> HeadReport:
    """Measure all gates of a head (about a second)."""
    dihedrals = smallest_dihedrals(head.vertices, head.tets)
    thickness = np.linalg.norm(head.skin_wrap.vertices - head.skull_wrap.vertices, axis=1)
    face = head.regions.get("face", np.ones(len(head.bone), bool))
    gap = TriangleTree(head.skin.vertices, head.skin.triangles).closest(head.skin_wrap.vertices[face])[2]
    trees = {name: TriangleTree(getattr(head, f"{name}_wrap").vertices, head.skin_wrap.triangles) for name in WRAPS}
    within = {f"crossings_within_{name}_wrap": len(tree.self_crossings()) for name, tree in trees.items()}
    between = {
        f"crossings_{a}_{b}": len(trees[a].crossings(trees[b]))
        for a, b in (("skin", "muscle"), ("skin", "skull"), ("muscle", "skull"))
    }
    bones = {f"{name}_vertices": int(np.count_nonzero(head.bone == label)) for name, label in _BONES}
    return HeadReport(
        tets=len(head.tets),
        least_volume=float(min(head.soft.volumes.min(), head.muscle.volumes.min())),
        smallest_dihedral=float(dihedrals.min()),
        share_below_2_degrees=float((dihedrals < 2).mean()),
        share_below_5_degrees=float((dihedrals < 5).mean()),
        least_thickness=float(thickness.min()),
        mean_thickness=float(thickness.mean()),
        wrap_to_skin_mean=float(gap.mean()),
        wrap_to_skin_95=float(np.quantile(gap, 0.95)),
        wrap_to_skin_max=float(gap.max()),
        lip_path=lip_path(head.skin_wrap.vertices, head.skin_wrap.triangles, head.regions),
        **within,
        **between,
        **bones,
    )


_BONES = (("cranium", CRANIUM), ("mandible", MANDIBLE), ("free", FREE))


def lip_path(vertices: Floats, triangles: Ints, regions: Mapping[str, Mask]) -> float:
    """Shortest way [mm] along the wrap's edges from the middle of the upper lip to that of the lower lip.

    It runs through the mouth's lining or around its corner, and is short only where a wrap bridges the lips. Infinite
    for a wrap without the regions "lips" and "mouth".
    """
    lips, mouth = regions.get("lips"), regions.get("mouth")
    if lips is None or mouth is None or not lips.any() or not mouth.any():
        return float("inf")
    x = vertices[lips]
    centre = np.median(x, axis=0)
    middle = np.flatnonzero(lips)[np.abs(x[:, 0] - centre[0]) < 6.0]
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    graph = csr_matrix((length, edges.T), shape=(len(vertices), len(vertices)))
    # Of the lips' middle the rows next to the line between them face each other across the gap.
    upper = middle[vertices[middle, 1] > centre[1] + 3.0]
    lower = middle[vertices[middle, 1] < centre[1] - 3.0]
    if not upper.size or not lower.size:
        return float("inf")
    return float(dijkstra(graph, directed=False, indices=upper, min_only=True)[lower].min())
