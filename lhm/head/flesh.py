"""Where a face has fat that hangs free of bone, and where muscles move it: shares over the wraps' vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import dijkstra

from ..base.errors import InputError
from ..base.mesh import Floats
from .columns import edge_graph
from .head import LayeredHead

LEAN_REGIONS = ("lips", "lids", "mouth", "eyes", "teeth", "ears")


@dataclass(frozen=True)
class FleshPolicy:
    """Lengths [mm] that bound flesh and muscle."""

    fade: float = 12.0  # along the skin wrap, over which the share of flesh rises from 0 to 1
    brow: float = 10.0  # above the lids' highest point, up to which a face is fleshy
    throat: tuple[float, float] = (30.0, 45.0)  # from the lips inward, between which the lining ends to follow muscles
    cheek: float = 15.0  # radius of a cheek's middle, seen from the front; its share falls to 0 over as much again


POLICY = FleshPolicy()
"""The lengths as they were measured."""


def flesh_share(head: LayeredHead, *, fade: float = POLICY.fade) -> Floats:
    """Find fat, shape (n,), 0 to 1: neck and face below the brow, less lips, lids, mouth, eyes and ears.

    The share rises over `fade` [mm] along the skin. Raises InputError for a head that lacks one of these regions.
    """
    y = head.skin_wrap.vertices[:, 1]
    inside = (_region(head, "face") | _region(head, "neck")) & (y < y[_region(head, "lids")].max() + POLICY.brow)
    for name in LEAN_REGIONS:
        inside = inside & ~_region(head, name)
    return _smooth_step(_path_from(head, ~inside) / fade)


def cheek_share(head: LayeredHead) -> Floats:
    """The cheeks, shape (n,), 0 to 1: half-way from mouth to lids, and a quarter beyond the mouth's corners."""
    x = head.skin_wrap.vertices
    lips, lids = x[_region(head, "lips")], x[_region(head, "lids")]
    middle, half = 0.5 * (lips[:, 0].max() + lips[:, 0].min()), 0.5 * np.ptp(lips[:, 0])
    up = x[:, 1] - 0.5 * (lips[:, 1].max() + lids[:, 1].min())
    off = np.hypot(np.abs(x[:, 0] - middle) - 1.25 * half, up)
    return flesh_share(head) * _smooth_step((2.0 * POLICY.cheek - off) / POLICY.cheek)


def expressive_share(head: LayeredHead) -> Floats:
    """Find skin that facial muscles move, shape (n,), 0 to 1: the face with mouth and eyes; elsewhere skin is tied.

    The share rises over `fade` along the skin, and falls again far within the mouth, whose lining goes with the
    jaw. A head without the region "face" is one everywhere.
    """
    n = len(head.skin_wrap.vertices)
    none = np.zeros(n, dtype=bool)
    if not head.regions.get("face", none).any():
        return np.ones(n)
    names = ("face", *(name for name in LEAN_REGIONS if name != "ears"))
    inside = np.any([head.regions.get(name, none) for name in names], axis=0)
    share = np.ones(n) if inside.all() else _smooth_step(_path_from(head, ~inside) / POLICY.fade)
    return np.minimum(share, 1.0 - _fade_within(head, "mouth", "lips", POLICY.throat))


def socket_share(head: LayeredHead) -> Floats:
    """Find the lining of the eyes, shape (n,), 0 at the lids' edge and 1 from `fade` within."""
    return _fade_within(head, "eyes", "lids", (0.0, POLICY.fade))


def mean_on_triangles(head: LayeredHead, share: Floats) -> Floats:
    """Average a share per vertex (n,) over each triangle of the wraps, shape (m,)."""
    return share[head.skin_wrap.triangles].mean(axis=1)


def _fade_within(head: LayeredHead, lining: str, edge: str, between: tuple[float, float]) -> Floats:
    """Measure the way into a lining, shape (n,): 0 to 1 `between` these distances [mm] from the region at its edge."""
    share, none = np.zeros(len(head.skin_wrap.vertices)), np.zeros(len(head.skin_wrap.vertices), dtype=bool)
    inside = head.regions.get(lining, none) & ~head.regions.get(edge, none)
    if inside.any() and not inside.all():
        near, far = between
        share[inside] = _smooth_step((_path_from(head, ~inside)[inside] - near) / (far - near))
    return share


def _region(head: LayeredHead, name: str) -> np.ndarray:
    if name not in head.regions or not head.regions[name].any():
        raise InputError(f"head: it has no region {name!r}, which tells where the face has an effect")
    return head.regions[name]


def _path_from(head: LayeredHead, outside: np.ndarray) -> Floats:
    """Length [mm] of the way along the skin wrap's edges from the vertices `outside`, shape (n,)."""
    graph = edge_graph(head.skin_wrap.vertices, head.skin_wrap.triangles)
    return dijkstra(graph, directed=False, indices=np.flatnonzero(outside), min_only=True)


def _smooth_step(t: Floats) -> Floats:
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
