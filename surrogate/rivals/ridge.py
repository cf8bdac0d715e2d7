"""Ridge regression of whole frames into principal components: of (w, p, h) as they are, or of what physics suggests."""

from __future__ import annotations

from typing import Literal

import numpy as np

from ...lhm.base.mesh import Floats
from ..corpus.face import Face
from ..corpus.mixture import STATIC
from ..corpus.reading import Faces
from ..modal.features import Inputs
from ..modal.principal import principal
from .protocol import Bound, Takes

FRAMES = 6000
PENALTIES = 10.0 ** np.arange(-2.0, 5.0)
SOFT, TARGET = STATIC.index("soft_stiffness"), STATIC.index("target_stiffness")
_LOG = {SOFT: 0.5 * np.log(20.0), TARGET: 0.5 * np.log(30.0)}
"""What half of the range of each stiffness is by its logarithm."""


class Ridge:
    """Features "raw": w, and the summary of p and h; "dimensionless" adds w (soft/target stiffness)^q of three q."""

    simulates = False
    takes: Takes = "nothing"

    def __init__(self, features: Literal["raw", "dimensionless"] = "raw", components: int = 128):
        self._features, self._components = features, components
        self.name = f"ridge regression, {features}"

    def fit(self, faces: Faces) -> None:
        """To at most FRAMES frames; the penalty is the one of least leave-one-out error (Allen 1974)."""
        self._inputs = Inputs.of(faces)
        rng = np.random.default_rng(0)
        rows, values = [], []
        each = max(1, FRAMES // max(len(faces), 1))
        for index in range(len(faces)):
            face = faces.face(index)
            frames = faces.frames(index, rng.permutation(len(faces.frames_of[index]))[:each])
            rows.append(self._rows(face, frames.weights))
            values.append(frames.corrected.reshape(len(frames.weights), -1).astype(np.float32))
        features, motion = np.vstack(rows), np.vstack(values)
        self._mean, self._scale = features.mean(axis=0), np.maximum(features.std(axis=0), 1e-6)
        known = (features - self._mean) / self._scale
        self._centre = motion.mean(axis=0)
        self._basis, _ = principal(motion - self._centre, self._components, rng)
        scores = ((motion - self._centre) @ self._basis.T).astype(np.float64)
        size, turn = np.linalg.eigh(known.T @ known)
        turned, pulled = known @ turn, turn.T @ (known.T @ scores)

        def wrong(penalty: float) -> float:
            leverage = (turned**2 / (size + penalty)).sum(axis=1)
            residual = scores - turned @ (pulled / (size + penalty)[:, None])
            return float(((residual / (1.0 - np.minimum(leverage, 0.999))[:, None]) ** 2).sum())

        best = min(PENALTIES, key=wrong)
        self._coefficients = turn @ (pulled / (size + best)[:, None])

    def bind(self, face: Face) -> Bound:
        """The same matrix for all faces."""

        def corrected(weights):
            known = (self._rows(face, weights) - self._mean) / self._scale
            motion = self._centre + (known @ self._coefficients).astype(np.float32) @ self._basis
            return motion.reshape(len(weights), *face.offset.shape)

        return corrected

    def _rows(self, face: Face, weights) -> Floats:
        summary = np.tile(self._inputs.summary_of(face), (len(weights), 1))
        parts: list[Floats] = [np.asarray(weights, dtype=np.float64), summary.astype(np.float64)]
        if self._features == "dimensionless":
            level = face.coefficients[:, 0].astype(np.float64)
            ratio = np.exp(_LOG[SOFT] * level[SOFT] - _LOG[TARGET] * level[TARGET])
            parts += [weights * ratio**q for q in (1.0 / 3.0, 2.0 / 3.0, 1.0)]
        return np.hstack(parts)
