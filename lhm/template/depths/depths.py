"""A linear map from the shape of a skin wrap to the logarithm of its depths, and how far off its predictions are."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field, replace

import numpy as np

from ...base.checks import finite
from ...base.errors import InputError, quote
from ...base.files.pack import load_packed, save_packed
from ...base.geometry.warp import rigid_motion
from ...base.mesh import Floats, Surface
from ...base.progress import OnProgress, silent

SKULL_PLACES = (
    ("SoftDECA, section 4.1", 3.83, "SKULLS: CT skulls and skin scans of 43 people, each left out"),
    ("multilinear model (Achenbach et al. 2018)", 1.98, "SKULLS, as SoftDECA quotes it"),
)
"""Model, mean error [mm] of the fitted skull wrap's places over the whole head, data (SoftDECA, section 4.1)."""
FORMAT = "softdeca depth regressor 2"
MODES = 15
"""Principal components of skin wraps and of depths, at most: with 43 pairs more cannot be told from chance."""

RIDGES = np.logspace(-4, 4, 33)
"""Candidates for the ridge, as multiples of the first component's sum of squares."""

FARTHEST = 3.0
"""Standard deviations of the pairs' scores beyond which a skin counts as that far: logs turn a line into e^x."""


@dataclass(frozen=True, eq=False)
class DepthPairs:
    """Skin wraps (N, n, 3) [mm] over one triangulation, and their depths to the skull (N, n) [mm].

    `label` says where they come from. Raises InputError for fewer than two pairs, for shapes that differ, and for
    depths that are not positive or values that are not finite, naming the pair.
    """

    label: str
    names: tuple[str, ...]
    wraps: Floats = field(repr=False)
    depths: Floats = field(repr=False)

    def __post_init__(self):
        count, shape = len(self.names), np.shape(self.wraps)
        if count < 2:
            raise InputError(f"{self.label}: {count} pairs of skin and skull; a mean needs 2 or more")
        if len(shape) != 3 or shape[0] != count or shape[2] != 3 or np.shape(self.depths) != shape[:2]:
            raise InputError(
                f"{self.label}: {count} names need wraps ({count}, n, 3) and depths ({count}, n), "
                f"got {shape} and {np.shape(self.depths)}"
            )
        for name, wrap, depth in zip(self.names, self.wraps, self.depths, strict=True):
            if not (np.isfinite(wrap).all() and np.isfinite(depth).all() and (depth > 0).all()):
                raise InputError(f"pair {name}: wraps must be finite and depths positive [mm]")

    def without(self, index: int) -> DepthPairs:
        """Leave out one of the pairs."""
        others = np.arange(len(self.names)) != index
        names = tuple(name for name, keep in zip(self.names, others, strict=True) if keep)
        return replace(self, names=names, wraps=self.wraps[others], depths=self.depths[others])


@dataclass(frozen=True, eq=False)
class DepthRegressor:
    """The regressor D of Eq. 4: depths from a skin wrap of one triangulation.

    Skin wraps are aligned rigidly to `reference` (n, 3) [mm], so that size stays; their k principal scores, on the
    rows of `axes` (k, 3 n), are standardised by `deviations` (k,) [mm] and `coefficients` (k, n) map them to what is
    added to `mean_log` (n,), the mean of the logarithms of the depths in mm. `wrap`: the digest of the template's skin
    wrap, by which a regressor of another is refused; `label`: what it was trained on.
    """

    label: str
    wrap: str
    pairs: int
    ridge: float
    reference: Floats = field(repr=False)
    axes: Floats = field(repr=False)
    deviations: Floats = field(repr=False)
    coefficients: Floats = field(repr=False)
    mean_log: Floats = field(repr=False)

    @classmethod
    def fit(cls, pairs: DepthPairs, template_wrap: Surface) -> DepthRegressor:
        """Fit the depths' principal scores to the wraps' by ridge regression, the ridge chosen by leave-one-out.

        On principal scores the ridge's hat matrix is diagonal, so that each pair's error without it has a closed
        form, e_i / (1 - h_i) (Hastie, Tibshirani, Friedman, The Elements of Statistical Learning, section 7.10).
        Where no shape helps, the largest ridge wins, and the answer is close to the mean. Raises InputError for pairs
        of another triangulation.
        """
        count = len(pairs.names)
        if pairs.wraps.shape[1:] != template_wrap.vertices.shape:
            raise InputError(
                f"{pairs.label}: wraps of {pairs.wraps.shape[1]} vertices, "
                f"the template's has {len(template_wrap.vertices)}"
            )
        reference, aligned = _aligned_to_their_mean(pairs.wraps, template_wrap.vertices)
        modes = min(MODES, count - 2)
        scores, axes = _principal((aligned - reference).reshape(count, -1), modes)
        logs = np.log(pairs.depths)
        wanted, directions = _principal(logs - logs.mean(axis=0), modes)

        size = np.linalg.norm(scores, axis=0)
        unit = scores / size
        ridges = RIDGES * size[0] ** 2 if size.size else np.zeros(1)
        errors = [_leave_one_out(unit, size**2 / (size**2 + ridge), wanted) for ridge in ridges]
        ridge = ridges[int(np.argmin(errors))]
        deviations = size / np.sqrt(count - 1)
        shrunk = (size**2 / (size**2 + ridge) * deviations / size)[:, None]
        return cls(
            pairs.label,
            wrap_digest(template_wrap),
            count,
            float(ridge),
            reference,
            axes,
            deviations,
            shrunk * (unit.T @ wanted) @ directions,
            logs.mean(axis=0),
        )

    def predict(self, skin_wrap: Floats) -> Floats:
        """Predict depths (n,) [mm], all positive, from a skin wrap's vertices (n, 3) [mm] to its skull wrap's.

        Only rigid motion is taken out of it; InputError for another shape or values that are not finite.
        """
        wrap = finite("skin wrap", skin_wrap, self.reference.shape)
        rotation, translation = rigid_motion(wrap, self.reference)
        displacement = (wrap @ rotation.T + translation - self.reference).ravel()
        scores = np.clip(self.axes @ displacement / self.deviations, -FARTHEST, FARTHEST)
        return np.exp(self.mean_log + scores @ self.coefficients)

    def check(self, template_wrap: Surface) -> None:
        """Raise InputError unless this regressor was trained on the skin wrap of this template."""
        digest = wrap_digest(template_wrap)
        if digest != self.wrap:
            raise InputError(
                f"depth regressor ({quote(self.label)}): trained on the skin wrap {quote(self.wrap)} of another "
                f"template; this template's is {digest}"
            )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to a .npz file, whole or not at all."""
        save_packed(path, FORMAT, self)

    @classmethod
    def load(cls, path: str | os.PathLike[str], template_wrap: Surface) -> DepthRegressor:
        """Read what `save` wrote; InputError names a file that is damaged, something else or of another template."""
        again = "train it again by `softdeca train regressor`"
        regressor = load_packed(path, FORMAT, cls, what="a depth regressor", else_do=again)
        try:
            regressor.check(template_wrap)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        return regressor


def wrap_digest(template_wrap: Surface) -> str:
    """Hash a template's skin wrap to 12 hexadecimal digits.

    Of places and triangles: templates of other heads have the same triangles, but not at the same places of the face.
    """
    content = hashlib.sha256(template_wrap.triangles.tobytes())
    content.update(template_wrap.vertices.tobytes())
    return content.hexdigest()[:12]


def _aligned_to_their_mean(wraps: Floats, first: Floats) -> tuple[Floats, Floats]:
    """The mean of wraps moved rigidly to it, and the wraps so moved (generalised Procrustes analysis, two rounds)."""
    mean = first
    for _ in range(2):
        motions = [rigid_motion(wrap, mean) for wrap in wraps]
        aligned = np.stack([wrap @ r.T + t for wrap, (r, t) in zip(wraps, motions, strict=True)])
        mean = aligned.mean(axis=0)
    return mean, aligned


def _principal(rows: Floats, most: int) -> tuple[Floats, Floats]:
    """Scores (N, k) and orthonormal axes (k, m) of rows (N, m) whose mean is zero, k <= `most`.

    By the small matrix of the rows' products; axes without a share in the rows are left out.
    """
    squares, vectors = np.linalg.eigh(rows @ rows.T)
    largest = np.flatnonzero(squares > max(1e-9 * squares[-1], 1e-12))[::-1][:most]
    scores = vectors[:, largest] * np.sqrt(squares[largest])
    return scores, (vectors[:, largest] / np.sqrt(squares[largest])).T @ rows


def _leave_one_out(unit: Floats, shrink: Floats, wanted: Floats) -> float:
    """Sum of squared errors of each row of `wanted` (N, q) predicted without it, with a mean of its own."""
    residuals = wanted - (unit * shrink) @ (unit.T @ wanted)
    hat = 1 / len(unit) + (unit**2) @ shrink
    return float(((residuals / (1 - hat)[:, None]) ** 2).sum())


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
