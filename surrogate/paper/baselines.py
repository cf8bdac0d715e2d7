"""What a learned surrogate has to beat: linear regression; the other baseline, T = S_t, needs no code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.mesh import Floats, Floats32
from .samples import Samples

PENALTIES = 10.0 ** np.arange(-2.0, 5.0)


@dataclass(frozen=True, eq=False)
class Ridge:
    """Ridge regression from (w, p, h) to the coefficients of T - S_t in its principal components.

    mean (3 n,), components (r, 3 n) [mm]; coefficients (features, r); the features' own mean and scale.
    """

    mean: Floats
    components: Floats
    coefficients: Floats
    feature_mean: Floats
    feature_scale: Floats

    @classmethod
    def fit(cls, samples: Samples, *, components: int = 64) -> Ridge:
        """Fit to training frames; the penalty is the one of least leave-one-out error (Allen 1974, PRESS)."""
        motion = (samples.simulated - samples.blended).reshape(len(samples), -1).astype(np.float64)
        mean = motion.mean(axis=0)
        u, size, basis = np.linalg.svd(motion - mean, full_matrices=False)
        rank = min(components, len(size))
        scores = u[:, :rank] * size[:rank]
        raw = _features(samples)
        feature_mean, feature_scale = raw.mean(axis=0), np.maximum(raw.std(axis=0), 1e-6)
        features = (raw - feature_mean) / feature_scale
        best = min(PENALTIES, key=lambda penalty: _leave_one_out(features, scores, penalty))
        gram = features.T @ features + best * np.eye(features.shape[1])
        return cls(mean, basis[:rank], np.linalg.solve(gram, features.T @ scores), feature_mean, feature_scale)

    def predict(self, samples: Samples) -> Floats32:
        """The simulated skins [mm], shape (N, n, 3), as this regression has them."""
        features = (_features(samples) - self.feature_mean) / self.feature_scale
        motion = self.mean + features @ self.coefficients @ self.components
        return samples.blended + motion.reshape(samples.blended.shape).astype(np.float32)


def _features(samples: Samples) -> Floats:
    return np.hstack([samples.weights, samples.normalised_parameters(), samples.codes]).astype(np.float64)


def _leave_one_out(features: Floats, scores: Floats, penalty: float) -> float:
    gram = features.T @ features + penalty * np.eye(features.shape[1])
    hat = features @ np.linalg.solve(gram, features.T)
    residual = (scores - hat @ scores) / (1.0 - np.diag(hat) - 1.0 / len(features))[:, None]
    return float((residual**2).sum())
