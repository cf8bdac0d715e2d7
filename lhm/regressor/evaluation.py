"""How far predicted depths are from measured ones: for one head, and with each pair left out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..base.mesh import Floats, Surface
from ..base.progress import OnProgress, silent
from .depths import DepthPairs, DepthRegressor

SKULL_PLACES = (
    ("SoftDECA, section 4.1", 3.83, "SKULLS: CT skulls and skin scans of 43 people, each left out"),
    ("multilinear model (Achenbach et al. 2018)", 1.98, "SKULLS, as SoftDECA quotes it"),
)
"""Model, mean error [mm] of the fitted skull wrap's places over the whole head, data (SoftDECA, section 4.1)."""


@dataclass(frozen=True)
class DepthErrors:
    """Predicted minus measured depths of one head [mm]: mean, median and 95 % of the size, and the signed mean."""

    vertices: int
    mean: float
    median: float
    quantile_95: float
    bias: float

    @classmethod
    def between(cls, predicted: Floats, measured: Floats) -> DepthErrors:
        """Compare depths (k,) [mm] at the same vertices."""
        off = predicted - measured
        size = np.abs(off)
        return cls(
            len(off), float(size.mean()), float(np.median(size)), float(np.quantile(size, 0.95)), float(off.mean())
        )


@dataclass(frozen=True, eq=False)
class LeaveOneOut:
    """Errors |predicted - measured depth| [mm] of pairs that a regressor has not seen.

    `per_pair` (N,) and `per_vertex` (n,): means over the other index; `mean_depth_per_vertex` (n,): the same if the
    geometric mean of the other pairs' depths is predicted whatever the skin.
    """

    per_pair: Floats = field(repr=False)
    per_vertex: Floats = field(repr=False)
    mean_depth_per_vertex: Floats = field(repr=False)

    @property
    def mean(self) -> float:
        """Over all pairs and vertices [mm]."""
        return float(self.per_vertex.mean())

    @property
    def mean_depth(self) -> float:
        """The same if the mean is predicted [mm]."""
        return float(self.mean_depth_per_vertex.mean())


def leave_one_out(pairs: DepthPairs, template_wrap: Surface, *, progress: OnProgress = silent) -> LeaveOneOut:
    """Fit everything, alignment and ridge included, without each pair in turn, and predict it; three pairs at least."""
    count = len(pairs.names)
    errors, mean_errors = np.empty((2, *pairs.depths.shape))
    for i in range(count):
        regressor = DepthRegressor.fit(pairs.without(i), template_wrap)
        errors[i] = np.abs(regressor.predict(pairs.wraps[i]) - pairs.depths[i])
        mean_errors[i] = np.abs(np.exp(regressor.mean_log) - pairs.depths[i])
        progress("depth regressor: each pair left out", (i + 1) / count)
    return LeaveOneOut(errors.mean(axis=1), errors.mean(axis=0), mean_errors.mean(axis=0))
