"""The tets of a facial scene: layers of a head's prisms or its own volume mesh, and where its vertices stand."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats, Ints, tet_volumes
from ...lhm.head import LayeredHead
from ...lhm.layers import prism_tets, stacked

MOST_FOLDED = 2e-3
"""Share of the tets from skin to skull that may be left out because they are folded."""
FLATTEST = 1e-4
"""The least volume of such a tet, over the median."""
NEIGHBOURS = 8
"""Vertices of the wraps with which one between them is carried along."""


@dataclass(frozen=True, eq=False)
class Stack:
    """Rest vertices [mm] in which the skin wrap comes first and the skull wrap at `first_of_skull`; each tissue's tets.

    `muscle` is None where soft tissue goes down to the skull; `counts` are the layers of each tissue's prisms, None
    where the tets are a head's own volume mesh; `inner` (k, wraps' vertices) then has the weights with which vertices
    between the wraps are carried along with them. `sound` masks the soft tets that are used, None for all.
    """

    vertices: Floats
    soft: Ints
    muscle: Ints | None
    first_of_skull: int
    counts: tuple[int, ...] | None
    inner: csr_matrix | None = None
    sound: np.ndarray | None = None

    @classmethod
    def of(cls, head: LayeredHead, layers: tuple[int, int], without: Collection[str]) -> Stack:
        """A head's stack with so many layers of soft tissue and of muscle.

        Raises SceneError for fewer than one, and for layers of a head whose tets are a volume mesh.
        """
        if len(layers) != 2 or min(layers) < 1 or not all(isinstance(count, (int, np.integer)) for count in layers):
            raise SceneError(f"layers: expected two counts of at least 1 (soft tissue, muscle), got {layers!r}")
        n = len(head.bone)
        if head.volume is not None:
            if tuple(layers) != (1, 1):
                raise SceneError(f"layers {layers!r}: the head's tets are a volume mesh, not layers of prisms")
            inner = _carrying(head.vertices, 3 * n)
            if "muscle" in without:
                return cls(head.vertices, head.tets, None, 2 * n, None, inner)
            return cls(head.vertices, head.soft.tets, head.muscle.tets, 2 * n, None, inner)
        if "muscle" in without:
            return cls._merged(head, int(layers[0]))
        if layers == (1, 1):
            return cls(head.vertices, head.soft.tets, head.muscle.tets, 2 * n, layers)
        soft, muscle = head.sub_layers(*layers)
        return cls(soft.vertices, soft.tets, muscle.tets, sum(layers) * n, layers)

    @classmethod
    def _merged(cls, head: LayeredHead, layers: int) -> Stack:
        """Prisms straight from skin to skull; a few tets fold where columns bend at the muscle, and are left out."""
        n = len(head.bone)
        vertices = stacked((head.skin_wrap.vertices, head.skull_wrap.vertices), (layers,))
        tets = np.vstack([prism_tets(head.skin_wrap.triangles, k * n, (k + 1) * n) for k in range(layers)])
        volumes = tet_volumes(vertices, tets)
        sound = volumes > FLATTEST * np.median(volumes)
        if np.mean(~sound) > MOST_FOLDED:
            raise SceneError(
                f"without muscle {np.count_nonzero(~sound)} of {len(tets)} tets from skin to skull are folded; "
                f"at most {MOST_FOLDED:.1%} may be left out"
            )
        return cls(vertices, tets, None, layers * n, (layers,), sound=sound)

    def between(self, skin: Floats, muscle: Floats, skull: Floats) -> Floats:
        """Positions [mm] of the whole stack for those of the wraps, each of shape (n, 3)."""
        if self.counts is not None:
            # Vertices between twisted prisms' wraps are not evenly spaced, and stay as far off.
            now, n = (skin, skull) if self.muscle is None else (skin, muscle, skull), len(skin)
            firsts = n * np.cumsum([0, *self.counts])
            rest = stacked([self.vertices[first : first + n] for first in firsts], self.counts)
            return stacked(now, self.counts) + (self.vertices - rest)
        wraps = np.vstack([skin, muscle, skull])
        moved = wraps - self.vertices[: len(wraps)]
        return np.vstack([wraps, self.vertices[len(wraps) :] + self.inner @ moved])


def _carrying(vertices: Floats, wraps: int) -> csr_matrix:
    """Weights by the inverse distance of the vertices after the wraps' to the nearest of the wraps'."""
    distance, near = cKDTree(vertices[:wraps]).query(vertices[wraps:], k=NEIGHBOURS)
    weight = 1.0 / np.maximum(distance, 1e-9)
    weight /= weight.sum(axis=1, keepdims=True)
    rows = np.arange(0, weight.size + 1, NEIGHBOURS)
    return csr_matrix((weight.ravel(), near.ravel(), rows), shape=(len(near), wraps))
