"""The simulator to first order: offset at neutral and 52 responses of this very face; it learns nothing."""

from __future__ import annotations

import numpy as np

from ..corpus.face import Face
from ..corpus.reading import Faces
from .protocol import Bound, Takes


class Linearised:
    """One factor and 52 solves at bind, then blendshapes; with `responses` False the settled neutral face alone."""

    simulates = True

    def __init__(self, *, responses: bool = True):
        self._responses = responses
        self.takes: Takes = "derivatives" if responses else "settled"
        self.name = "linearised simulator" if responses else "settled neutral face + blendshapes"

    def fit(self, faces: Faces) -> None:
        """Nothing to learn."""

    def bind(self, face: Face) -> Bound:
        """What the corpus keeps of the face."""
        offset, responses = face.offset.astype(np.float32), face.responses.astype(np.float32)
        if not self._responses:
            return lambda weights: np.broadcast_to(offset, (len(weights), *offset.shape))
        return lambda weights: offset + np.tensordot(weights, responses, axes=1)
