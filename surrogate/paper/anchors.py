"""The anchors of a transfer: vertices that simulation leaves where the blendshapes put them."""

from __future__ import annotations

import numpy as np

from ...lhm.base.geometry.topology import connected_parts
from ...lhm.base.mesh import Ints
from .samples import Samples


def still_vertices(samples: Samples, share: float = 0.05) -> Ints:
    """The vertices that simulation moves least away from the blendshapes: `share` of each connected part's."""
    motion = np.sqrt(((samples.simulated - samples.blended) ** 2).sum(axis=2).mean(axis=0))
    count, part = connected_parts(samples.reference.triangles, len(motion))
    still = []
    for number in range(count):
        members = np.flatnonzero(part == number)
        still.append(members[np.argsort(motion[members], kind="stable")[: max(1, round(share * len(members)))]])
    return np.sort(np.concatenate(still))
