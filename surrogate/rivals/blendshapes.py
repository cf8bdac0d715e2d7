"""T = S: no physics at all."""

from __future__ import annotations

import numpy as np

from ..corpus.face import Face
from ..corpus.reading import Faces
from .protocol import Bound, Takes


class Blendshapes:
    """The error of doing nothing."""

    name = "blendshapes (T = S)"
    simulates = False
    takes: Takes = "nothing"

    def fit(self, faces: Faces) -> None:
        """Nothing to learn."""

    def bind(self, face: Face) -> Bound:
        """Zero."""
        shape = face.offset.shape
        return lambda weights: np.zeros((len(weights), *shape), dtype=np.float32)
