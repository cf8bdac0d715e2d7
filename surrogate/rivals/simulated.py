"""Rivals that simulate: projective dynamics of few iterations a frame, and each shape simulated once at bind."""

from __future__ import annotations

import numpy as np

from ...lhm.mesh import Floats
from ...reference import settled
from ...reference.face.linearised import DIRECT, Linearised, linearised, spring_norm
from ...reference.face.settling import FOR_TARGETS
from ..corpus.person import OfSpace
from ..local import of_static
from ..modal.faces import Face, Faces
from ..modal.features import Features
from .protocol import Bound

TOLERANCE, MOST = 5e-4, 200
"""Of a frame that is simulated to the end, as a corpus asks it, and after how many iterations it ends at the latest."""


class _Face:
    """A face of a corpus, simulated anew: head, settled neutral face and tangent."""

    def __init__(self, people: OfSpace, face: Face):
        self.skin, self.shapes = people.space.skin(face.code), people.space.expression_deltas(face.code)
        self.head = people.fit(self.skin)  # type: ignore[operator]
        at_vertices = Features(people.mean).at_vertices(face.coefficients)
        self.linear: Linearised = linearised(
            settled(self.head, of_static(self.head, at_vertices), **FOR_TARGETS), accuracy=DIRECT
        )

    def corrected(self, weights, *, iterations: int | None = None) -> Floats:
        """T - S [mm], shape (n, 3), from the first-order answer by so many iterations, or to the end."""
        expression = self.skin.vertices + np.tensordot(weights, self.shapes, axes=1)
        neutral = self.linear.face
        scene = neutral.scene(expression)
        if iterations is None:
            solution = self.linear.solve(expression, accuracy=TOLERANCE, max_iterations=MOST)
        else:
            start, norm = self.linear.start(expression), spring_norm(scene)
            solution = self.linear.prepared.solve(
                scene, start=start, absolute=TOLERANCE * norm, max_iterations=iterations, untangle=False
            )
        return neutral.skin_after(expression, solution.positions) - expression


class CoarsePD:
    """The simulator stopped after some iterations a frame, which begins at the first-order answer."""

    simulates = True

    def __init__(self, people: OfSpace, iterations: int):
        self._people, self._iterations = people, iterations
        self.name = f"PD, {iterations} iteration{'s' if iterations > 1 else ''} a frame"

    def fit(self, faces: Faces) -> None:
        """Nothing to learn."""

    def bind(self, face: Face) -> Bound:
        """Fit, settle, factor."""
        simulated = _Face(self._people, face)
        return lambda weights: np.stack([simulated.corrected(w, iterations=self._iterations) for w in weights]).astype(
            np.float32
        )


class BakedShapes:
    """Each of the 52 shapes simulated at full weight, once; frames are sums of what they do."""

    simulates, name = True, "baked shapes"

    def __init__(self, people: OfSpace):
        self._people = people

    def fit(self, faces: Faces) -> None:
        """Nothing to learn."""

    def bind(self, face: Face) -> Bound:
        """Fifty-three solves."""
        simulated = _Face(self._people, face)
        offset = simulated.corrected(np.zeros(52))
        shapes = np.stack([simulated.corrected(unit) - offset for unit in np.eye(52)])
        return lambda weights: (offset + np.tensordot(weights, shapes, axes=1)).astype(np.float32)
