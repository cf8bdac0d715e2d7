"""What draws a template to a skin: its own points to their matches, and the skin's points to theirs on the template.

Matched from one side alone a template slides: what juts out of the skin (a nose, lips) may have no match at all.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..geometry.sky import sky_seen
from ..mesh import Floats, Surface
from ..wraps.landmarks import Mask
from .matching import Target, robust

SPACING, MOST = 12.0, 20000
"""[mm²] of the skin for each of its points, and the most of these."""
SEEN = 0.15
"""What sees less of the sky (nostrils, folds of ears) has no counterpart on another head, or in a scan."""
CROWD = 2.0
"""A vertex is drawn by the points that fall to it up to so many times those of its own area."""


@dataclass(frozen=True, eq=False)
class Pulls:
    """Pulls between a skin and a template that moves from `start`; `visible` (n,): what of the template sees the sky.

    `points` and `normals` (k, 3) [mm]: of the skin, evenly spread by area, and visible.
    """

    target: Target
    start: Surface
    visible: Mask
    points: Floats = field(repr=False)
    normals: Floats = field(repr=False)
    expected: Floats = field(repr=False)
    reached: Target = field(repr=False)

    @classmethod
    def of(cls, target: Target, start: Surface) -> Pulls:
        """Between a skin, and a template that stands upon it."""
        skin = target.skin
        along = np.cumsum(skin.areas)
        count = int(np.clip(along[-1] / SPACING, 1, MOST))
        chosen = np.searchsorted(along, (np.arange(count) + 0.5) / count * along[-1])
        chosen = np.unique(np.minimum(chosen, len(along) - 1))
        points, normals = skin.vertices[skin.triangles[chosen]].mean(axis=1), target.faces[chosen]
        seen = sky_seen(skin, points, normals) > SEEN
        expected = np.maximum(start.vertex_areas * count / along[-1], 1e-9)
        return cls(target, start, sky_seen(start) > SEEN, points[seen], normals[seen], expected, Target(start))

    def at(self, x: Floats, drawn: Mask, limit: float, turned: float) -> tuple[Floats, Floats]:
        """Goals (n, 3) [mm] and weights (n,) up to 1.5 of a template at x (n, 3), of which the `drawn` (n,) take part.

        Matches count less the farther they are, and not at all from `limit` [mm] on; `turned` as in `Target.match`.
        Where that is 0 the template's own matches draw alone: they lay it closest to the skin once it slides no more.
        """
        reached = Target(self.start.with_vertices(x), self.reached)
        closest, distance, weights = self.target.match(x, reached.normals, turned=turned)
        weights = weights * drawn * robust(distance, limit)
        if turned == 0.0:
            return closest, weights
        corners, shares, good = reached.located(self.points, self.normals, turned=turned)
        offsets = self.points - (shares[:, :, None] * x[corners]).sum(axis=1)
        counted = good * robust(np.linalg.norm(offsets, axis=1), limit) * drawn[corners].all(axis=1)
        total, sums = np.zeros(len(x)), np.zeros_like(x)
        for c in range(3):
            np.add.at(total, corners[:, c], counted * shares[:, c])
            np.add.at(sums, corners[:, c], (counted * shares[:, c])[:, None] * offsets)
        drawing = np.minimum(total / self.expected, CROWD)
        goals = x + sums / np.maximum(total, 1e-12)[:, None]
        both = weights + drawing
        goals = (weights[:, None] * closest + drawing[:, None] * goals) / np.maximum(both, 1e-12)[:, None]
        return np.where(both[:, None] > 0, goals, x), 0.5 * both
