"""A start for a fine mesh of a face: where the answer on a coarser one takes its vertices.

The finer a mesh, the more of Newton's iterations go into large motions and elements that they crush, which the coarse
mesh has settled at a small part of the cost. A template's levels are nested, each wrap's triangles those of the level
before split into four; sub-layers lie evenly between the wraps.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.checks import check_arguments
from ...lhm.base.errors import SceneError
from ...lhm.base.geometry.tets import untangle
from ...lhm.base.geometry.topology import split_triangles
from ...lhm.base.mesh import Floats
from ...lhm.head import LayeredHead
from ..scene import Scene

LEAST = 0.1
"""Of a tet's volume at rest, that the start leaves it."""


@check_arguments
def nested_start(
    scene: Scene,
    head: LayeredHead,
    positions: Floats,
    coarse: LayeredHead,
    *,
    layers: tuple[int, int] = (1, 1),
    coarse_layers: tuple[int, int] = (1, 1),
) -> Floats:
    """Where to `start` the solve of a facial scene [mm], shape (scene vertices, 3), from the answer on a coarser mesh.

    `scene` is `facial_scene(head, ..., layers=layers)`, and `positions` [mm], shape (coarse vertices, 3), solve that of
    `coarse`, a head of the same person on the same or a coarser level of the template, with `coarse_layers`. Its
    displacements are carried over: on the middle of an edge the mean of its ends', between the wraps by depth. Vertices
    of tets that this would crush, which some laws have no energy for, are moved aside. Raises SceneError for heads that
    are not nested, and for positions of another mesh, MeshError where tets stay inverted.
    """
    n = len(coarse.bone)
    rest = _stacked(coarse, coarse_layers)
    if positions.shape != rest.shape:
        raise SceneError(f"positions: expected shape {rest.shape}, got {positions.shape}")
    across = _between(coarse_layers, layers)
    moved = np.einsum("fc,cnd->fnd", across, (positions - rest).reshape(-1, n, 3))
    triangles = coarse.skin_wrap.triangles
    while moved.shape[1] < len(head.bone):
        triangles, ends = split_triangles(triangles, moved.shape[1])
        moved = np.concatenate([moved, moved[:, ends].mean(axis=2)], axis=1)
    if not np.array_equal(triangles, head.skin_wrap.triangles):
        raise SceneError("coarse: the head's wraps are not its wraps' triangles split into four")
    if scene.vertices.size != moved.size:
        raise SceneError(f"scene: expected {moved.size // 3} vertices of layers {layers}, got {len(scene.vertices)}")
    start = scene.vertices + moved.reshape(-1, 3)
    return untangle(start, scene.tets, np.ones(len(start), dtype=bool), LEAST * scene.volumes)


def _stacked(head: LayeredHead, layers: tuple[int, int]) -> Floats:
    """The vertices of a head's layers; SceneError for one without, whose tets are a volume mesh."""
    if head.volume is not None:
        raise SceneError("coarse: the head's tets are a volume mesh, not layers of prisms")
    return head.sub_layers(*layers)[0].vertices


def _between(coarse: tuple[int, int], fine: tuple[int, int]) -> Floats:
    """The weights of layers of one stack of vertices for those of another, shape (fine, coarse)."""
    depths = [np.concatenate([np.arange(a) / a, 1.0 + np.arange(b + 1) / b]) for a, b in (coarse, fine)]
    return np.stack([np.interp(depths[1], depths[0], row) for row in np.eye(len(depths[0]))], axis=1)
