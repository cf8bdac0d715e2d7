"""Ridge regression of whole frames into principal components: of (w, p, h) as they are, or of what physics suggests."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from ...lhm.base.mesh import Floats, Floats32
from ..corpus.face import Frames, KeptFace
from ..corpus.mixture import STATIC
from ..corpus.reading import Faces
from ..rigs.rig import CorrectedRig, Needs
from .features import Inputs

FRAMES = 6000
PENALTIES = 10.0 ** np.arange(-2.0, 5.0)
SOFT, TARGET = STATIC.index("soft_stiffness"), STATIC.index("target_stiffness")
_LOG = {SOFT: 0.5 * np.log(20.0), TARGET: 0.5 * np.log(30.0)}
"""What half of the range of each stiffness is by its logarithm."""


class Ridge:
    """Features "raw": w, and the summary of p and h; "dimensionless" adds w (soft/target stiffness)^q of three q."""

    needs: Needs = "nothing"

    def __init__(self, features: Literal["raw", "dimensionless"] = "raw", components: int = 128):
        self._features, self._components = features, components

    def fit(self, faces: Faces) -> None:
        """Fit at most FRAMES frames; the penalty is the one of least leave-one-out error (Allen 1974)."""
        self._inputs = Inputs.from_faces(faces)
        rng = np.random.default_rng(0)
        rows, values = [], []
        for face, frames in sample_frames(faces, FRAMES, rng):
            rows.append(self._rows(face, frames.weights))
            values.append(frames.corrected.reshape(len(frames.weights), -1).astype(np.float32))
        features, motion = np.vstack(rows), np.vstack(values)
        self._mean, self._scale = features.mean(axis=0), np.maximum(features.std(axis=0), 1e-6)
        normalised = (features - self._mean) / self._scale
        self._centre = motion.mean(axis=0)
        self._basis, _ = find_components(motion - self._centre, self._components, rng)
        scores = ((motion - self._centre) @ self._basis.T).astype(np.float64)
        size, turn = np.linalg.eigh(normalised.T @ normalised)
        turned, pulled = normalised @ turn, turn.T @ (normalised.T @ scores)

        def wrong(penalty: float) -> float:
            leverage = (turned**2 / (size + penalty)).sum(axis=1)
            residual = scores - turned @ (pulled / (size + penalty)[:, None])
            return float(((residual / (1.0 - np.minimum(leverage, 0.999))[:, None]) ** 2).sum())

        best = min(PENALTIES, key=wrong)
        self._coefficients = turn @ (pulled / (size + best)[:, None])

    def bind(self, face: KeptFace) -> CorrectedRig:
        """Take the same matrix for all faces."""

        def correct(weights: Floats32) -> Floats32:
            rows = (self._rows(face, weights[None]) - self._mean) / self._scale
            motion: Floats32 = self._centre + (rows @ self._coefficients).astype(np.float32) @ self._basis
            return motion.reshape(face.skin.vertices.shape)

        return CorrectedRig(face.skin, face.shapes, correct)

    def _rows(self, face: KeptFace, weights) -> Floats:
        summary = np.tile(self._inputs.summary_of(face), (len(weights), 1))
        parts: list[Floats] = [np.asarray(weights, dtype=np.float64), summary.astype(np.float64)]
        if self._features == "dimensionless":
            level = face.coefficients[:, 0].astype(np.float64)
            ratio = np.exp(_LOG[SOFT] * level[SOFT] - _LOG[TARGET] * level[TARGET])
            parts += [weights * ratio**q for q in (1.0 / 3.0, 2.0 / 3.0, 1.0)]
        return np.hstack(parts)


def sample_frames(faces: Faces, most: int, rng: np.random.Generator) -> Iterator[tuple[KeptFace, Frames]]:
    """Yield each face with some of its frames, about `most` in all."""
    each = max(1, most // max(len(faces), 1))
    for index in range(len(faces)):
        yield faces.face(index), faces.frames(index, rng.permutation(len(faces.frames_of[index]))[:each])


def find_components(data: Floats32, count: int, rng: np.random.Generator) -> tuple[Floats32, Floats]:
    """Find the `count` leading right singular vectors (count, m) of data (rows, m), and their amplitudes' mean size.

    By one power iteration of random combinations (Halko, Martinsson and Tropp 2011); vectors beyond the rank are zero.
    Sizes (count,) are roots of mean squares.
    """
    more = min(len(data), count + 20)
    sketch = data.T @ (data @ (data.T @ rng.normal(size=(len(data), more)).astype(np.float32)))
    basis = np.linalg.qr(sketch)[0]
    _, size, vectors = np.linalg.svd(data @ basis, full_matrices=False)
    kept = min(count, len(size))
    modes, sizes = np.zeros((count, data.shape[1]), dtype=np.float32), np.zeros(count)
    modes[:kept] = vectors[:kept] @ basis.T
    sizes[:kept] = size[:kept] / np.sqrt(len(data))
    return modes, sizes
