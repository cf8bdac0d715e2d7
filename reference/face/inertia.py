"""Where a face has inertia: flesh lags behind speech; lips, lids and skin close to bone follow it at once.

Eq. 9 with one frequency for the whole face lets lips miss their closures. Lips and lids are moved by the ring of muscle
in and around them, and skin close to bone by bone: there is little between that could swing. So each vertex of the skin
wrap is `loose` by a share, 0 to 1, and p's frequency and damping are those of loose flesh; see `coefficients`.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from ...lhm.base.mesh import Floats
from ...lhm.flesh import LEAN_REGIONS, fleshy
from ...lhm.head import FREE, LayeredHead
from .dynamics import Recurrence, coefficients
from .local import on_vertices
from .parameters import Parameters

CLOSE, DEEP = 5.0, 15.0
"""Depth [mm] of bone below the skin up to which skin follows it, and from which on it is loose."""
RING = 20.0
"""Width [mm] along the skin over which flesh comes loose beside lips and lids: that of the muscle around a mouth."""


def loose(head: LayeredHead) -> Floats:
    """The share of each skin wrap vertex that lags, shape (n,), 0 to 1: flesh far from bone.

    A head without the regions that tell where it has flesh is loose everywhere.
    """
    n = len(head.bone)
    if not all(name in head.regions for name in (*LEAN_REGIONS, "face", "neck")):
        return np.ones(n)
    flesh, bone = fleshy(head, fade=RING), head.bone != FREE
    if not bone.any():
        return flesh
    depth = cKDTree(head.skull_wrap.vertices[bone]).query(head.skin_wrap.vertices)[0]
    t = np.clip((depth - CLOSE) / (DEEP - CLOSE), 0.0, 1.0)
    return flesh * t * t * (3.0 - 2.0 * t)


def recurrence(head: LayeredHead, parameters: Parameters, time_step: float) -> Recurrence:
    """Eq. 9's α, β, γ of a head under p at the skin wrap's vertices, each of shape (n,).

    Frames are time_step [s] apart. For those of the skin's own vertices, `recurrence(...).at(head.skin_from_wrap)`.
    Raises what `coefficients` raises, and SceneError for a field of another length.
    """
    frequency, damping = (
        on_vertices(name, getattr(parameters, name), head.skin_wrap) for name in ("frequency", "damping")
    )
    return coefficients(frequency, damping, time_step, loose=loose(head))
