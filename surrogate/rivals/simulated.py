"""Rivals that simulate: projective dynamics of few iterations a frame, and each shape simulated once at bind."""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats
from ...reference.face.derivatives import FaceDerivatives, differentiate_head, spring_norm
from ..corpus.face import Face
from ..corpus.reading import Faces
from ..heads import Heads
from .protocol import Bound, Takes

TOLERANCE, MOST = 5e-4, 200
"""Of a frame that is simulated to the end, as a corpus asks it, and after how many iterations it ends at the latest."""


class _Face:
    """A face of a corpus, simulated anew: head, settled neutral face and tangent."""

    def __init__(self, heads: Heads, face: Face):
        self.head, self.shapes = heads.fit(face), heads.shapes(face)
        self.linear: FaceDerivatives = differentiate_head(self.head, heads.parameters(face, self.head))

    def corrected(self, weights, *, iterations: int | None = None) -> Floats:
        """T - S [mm], shape (n, 3), from the first-order answer by so many iterations, or to the end."""
        expression = self.head.skin.vertices + np.tensordot(weights, self.shapes, axes=1)
        neutral = self.linear.face
        scene = neutral.scene(expression)
        if iterations is None:
            solution = self.linear.solve(expression, accuracy=TOLERANCE, max_iterations=MOST)
        else:
            start, norm = self.linear.predict(expression), spring_norm(scene)
            solution = self.linear.prepared.solve(
                scene, start=start, absolute=TOLERANCE * norm, max_iterations=iterations, untangle=False
            )
        return neutral.skin_after(expression, solution.positions) - expression


class CoarsePD:
    """The simulator stopped after some iterations a frame, which begins at the first-order answer."""

    simulates = True
    takes: Takes = "nothing"

    def __init__(self, heads: Heads, iterations: int):
        self._heads, self._iterations = heads, iterations
        self.name = f"PD, {iterations} iteration{'s' if iterations > 1 else ''} a frame"

    def fit(self, faces: Faces) -> None:
        """Nothing to learn."""

    def bind(self, face: Face) -> Bound:
        """Fit, settle, factor."""
        simulated = _Face(self._heads, face)
        return lambda weights: np.stack([simulated.corrected(w, iterations=self._iterations) for w in weights]).astype(
            np.float32
        )


class BakedShapes:
    """Each of the 52 shapes simulated at full weight, once; frames are sums of what they do."""

    simulates, name = True, "baked shapes"
    takes: Takes = "nothing"

    def __init__(self, heads: Heads):
        self._heads = heads

    def fit(self, faces: Faces) -> None:
        """Nothing to learn."""

    def bind(self, face: Face) -> Bound:
        """Fifty-three solves."""
        simulated = _Face(self._heads, face)
        offset = simulated.corrected(np.zeros(52))
        shapes = np.stack([simulated.corrected(unit) - offset for unit in np.eye(52)])
        return lambda weights: (offset + np.tensordot(weights, shapes, axes=1)).astype(np.float32)
