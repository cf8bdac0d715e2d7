"""The modal network under the rivals' protocol: alone, or with the simulator's offset and responses."""

from __future__ import annotations

import numpy as np

from ..corpus.face import Face
from ..corpus.reading import Faces
from ..modal.compressed import compressed
from ..modal.rig import Modal
from ..modal.weights import ModalWeights
from .protocol import Bound, Takes


class ModalMethod:
    """Trained weights; with `exact`, derivatives are the face's."""

    def __init__(self, weights: ModalWeights, *, exact: bool = False):
        self._modal, self.simulates = Modal(weights), exact
        self.takes: Takes = "derivatives" if exact else "nothing"
        self.name = "network + simulator at bind" if exact else "network"

    def fit(self, faces: Faces) -> None:
        """Trained already."""

    def bind(self, face: Face) -> Bound:
        """By the run time's own arithmetic."""
        at_vertices = self._modal.features.at_vertices(face.coefficients)
        bound = compressed(self._modal.bound(face.code, face.skin, at_vertices, face.shapes))
        offset = face.offset.astype(np.float32) if self.simulates else bound.offset
        responses = face.responses.astype(np.float32) if self.simulates else bound.responses
        return lambda weights: offset + np.tensordot(weights, responses, axes=1) + bound.remainder(weights)
