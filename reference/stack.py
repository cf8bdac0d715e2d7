"""The tets of a facial scene: how many layers of a head's prisms, and where its vertices stand in the stack."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from ..lhm.errors import SceneError
from ..lhm.head import LayeredHead
from ..lhm.layers import stacked, sub_layers
from ..lhm.mesh import Floats, Ints


@dataclass(frozen=True, eq=False)
class Stack:
    """Rest vertices [mm] from skin wrap (first n) to skull wrap (last n), and each tissue's tets.

    `muscle` is None where soft tissue goes down to the skull; `counts` are the layers of each tissue's prisms.
    """

    vertices: Floats
    soft: Ints
    muscle: Ints | None
    counts: tuple[int, ...]

    @classmethod
    def of(cls, head: LayeredHead, layers: tuple[int, int], without: Collection[str]) -> Stack:
        """A head's stack with so many layers of soft tissue and of muscle; SceneError for fewer than one."""
        if len(layers) != 2 or min(layers) < 1 or not all(isinstance(count, (int, np.integer)) for count in layers):
            raise SceneError(f"layers: expected two counts of at least 1 (soft tissue, muscle), got {layers!r}")
        if "muscle" in without:
            wraps = (head.skin_wrap.vertices, head.skull_wrap.vertices)
            (soft,) = sub_layers(wraps, head.skin_wrap.triangles, layers[:1])
            return cls(soft.vertices, soft.tets, None, layers[:1])
        if layers == (1, 1):
            return cls(head.vertices, head.soft.tets, head.muscle.tets, layers)
        soft, muscle = head.sub_layers(*layers)
        return cls(soft.vertices, soft.tets, muscle.tets, layers)

    @property
    def first_of_skull(self) -> int:
        """Index of the skull wrap's first vertex."""
        return len(self.vertices) // (sum(self.counts) + 1) * sum(self.counts)

    def between(self, skin: Floats, muscle: Floats, skull: Floats) -> Floats:
        """Positions [mm] of the whole stack for those of the wraps, each of shape (n, 3)."""
        return stacked((skin, skull) if self.muscle is None else (skin, muscle, skull), self.counts)
