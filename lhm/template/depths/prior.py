"""Where no skulls are at hand: random identities with published mean depths and their spread."""

from __future__ import annotations

import hashlib

import numpy as np
from scipy.spatial.distance import cdist

from ...base.files.cache import load_or_make
from ...base.files.pack import pack, unpack
from ...base.geometry.warp import farthest_points
from ...base.mesh import Floats
from ...identities.space import LinearSpace
from ..template import Template
from ..wraps import depth
from ..wraps.landmarks import find_landmarks
from .depths import DepthPairs, DepthRegressor
from .pairs import move_wrap

LABEL = "synthetic prior (published depths and spread), not anatomy"
PAIRS, SEED = 60, 0
FORMAT = 1  # to be raised when another number than a landmark's changes
COMMON = 0.5
"""Share of a depth's variance that the whole head has in common: depths rise together with the body mass index (doi
10.1016/j.jormas.2023.101420, abstract; the share is chosen)."""

CENTRES, REACH = 100, 25.0
"""How many places have a variation of their own, and how far [mm] it reaches: about the distance of two landmarks."""


def prior_pairs(template: Template, space: LinearSpace, rng: np.random.Generator, count: int) -> DepthPairs:
    """Draw skin wraps of `count` random identities, and depths about the published means.

    A depth is its mean at that place of this face (`lhm.wraps.depth`) times a log-normal factor of mean one and the
    place's spread. Half of the factor's variance is common to the head, the other half varies smoothly over it, left
    and right alike. Nothing published ties the factor to the shape of the skin, so nothing here does: what can be
    learned is where the landmarks lie, and the rest of the spread stays as error. Mouth and eye sockets are linings.
    """
    field = _smooth_field(template.skin_wrap.vertices)
    wraps, depths = [], []
    for _ in range(count):
        skin = space.sample(rng)[1]
        landmarks = find_landmarks(skin, space.parts)
        wrap = move_wrap(template, skin.vertices)
        mean = depth.mean_depth(wrap, landmarks.eyes, landmarks.mouth)
        mean[template.regions["mouth"]], mean[template.regions["eyes"]] = depth.LINING, depth.SOCKET
        spread = depth.depth_spread(wrap, landmarks.eyes, landmarks.mouth)
        deviation = np.sqrt(np.log1p(spread**2))
        common, own = rng.standard_normal(), field @ rng.standard_normal(field.shape[1])
        factor = np.exp(deviation * (np.sqrt(COMMON) * common + np.sqrt(1 - COMMON) * own) - 0.5 * deviation**2)
        wraps.append(wrap)
        depths.append(mean * factor)
    names = tuple(f"prior {i}" for i in range(count))
    return DepthPairs(LABEL, names, np.stack(wraps), np.stack(depths))


def default_regressor(template: Template, space: LinearSpace) -> DepthRegressor:
    """Train the regressor on 60 pairs of the prior, the same each time; made once (a second or two) and cached."""
    content = hashlib.sha256(np.ascontiguousarray(space.identity).tobytes())
    content.update(repr((FORMAT, PAIRS, SEED, depth.LANDMARKS)).encode())
    name = f"depths-{template.name}-{template.digest}-{content.hexdigest()[:12]}"

    def make() -> dict[str, np.ndarray]:
        pairs = prior_pairs(template, space, np.random.default_rng(SEED), PAIRS)
        return dict(pack(DepthRegressor.fit(pairs, template.skin_wrap)))

    return load_or_make(name, make, lambda arrays: unpack(DepthRegressor, arrays))


def _smooth_field(points: Floats) -> Floats:
    """Weights (n, k) that make a smooth field of unit variance of k independent normal numbers, mirror-symmetric."""
    folded = points - points.mean(axis=0)
    folded[:, 0] = np.abs(folded[:, 0])
    centres = folded[farthest_points(folded, CENTRES, np.array([0]))]
    weights = np.exp(-0.5 * (cdist(folded, centres) / REACH) ** 2)
    return weights / np.linalg.norm(weights, axis=1, keepdims=True)
