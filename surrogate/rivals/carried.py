"""Blendshapes carried along by the bones that p scales: no physics, no learning."""

from __future__ import annotations

import numpy as np

from ..corpus.face import Face
from ..corpus.reading import Faces
from ..heads import Heads
from .protocol import Bound, Takes


class BonesCarried:
    """T - S is by how much scaled bones carry the neutral skin, whatever the expression; it needs a head."""

    name = "bones carried"
    simulates = False
    takes: Takes = "carried"

    def __init__(self, heads: Heads):
        self._heads = heads

    def fit(self, faces: Faces) -> None:
        """Nothing to learn."""

    def bind(self, face: Face) -> Bound:
        """Zero where p scales no bone."""
        carried = self._heads.carry(face)
        return lambda weights: np.broadcast_to(carried, (len(weights), *carried.shape))
