"""A head's skin as it is drawn finer: subdivided twice, and displaced along its normals where a scan has detail."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, identity

from ..base.geometry.subdivision import subdivide_smoothly
from ..base.geometry.topology import unique_edges
from ..base.mesh import Floats, Floats32, Ints, Surface
from ..identities.anny import has_default_triangles, load_default_people
from ..identities.neck import cut_neck

LEVELS = 2
"""Each splits a triangle into four: the default skin's 4,463 vertices become 71,378."""


@dataclass(frozen=True, eq=False)
class Detail:
    """A scan's detail beyond a head's skin.

    heights (k,) [mm] of the scan over the fine skin, along its normals; colours (k, 3), 0 to 255, of its texture.
    `place` (3, 4): the file's point x lies at place[:, :3] x + place[:, 3] [mm] of the head.
    """

    heights: Floats32
    colours: NDArray[np.uint8] | None = None
    place: Floats | None = None


def count_fine_vertices(skin: Surface) -> int:
    """Count the vertices of a skin's FineSkin."""
    n, edges, triangles = len(skin.vertices), len(unique_edges(skin.triangles)), len(skin.triangles)
    for _ in range(LEVELS):
        n, edges, triangles = n + edges, 2 * edges + 3 * triangles, 4 * triangles
    return n


@dataclass(frozen=True, eq=False)
class FineSkin:
    """A map from a skin's vertices to a finer skin, for drawing.

    `steps` are sparse weights, applied one after another to the skin's n vertices; rows sum to one. The first ends the
    neck. `triangles` (t, 3) are of the k vertices that come out, `heights` (k,) [mm] what is added along their normals,
    `colours` (k, 3) those of a scan, 0 to 255.
    """

    steps: tuple[csr_matrix, ...]
    triangles: Ints
    heights: Floats32
    colours: NDArray[np.uint8] | None = None

    @classmethod
    def from_skin(cls, rest: Surface, detail: Detail | None = None) -> FineSkin:
        """Make the map of a skin at rest: smooth, and with `detail`; default triangles have their neck cut clean."""
        n, triangles, count, levels = len(rest.vertices), rest.triangles, len(rest.vertices), []
        for _ in range(LEVELS):
            weights, triangles = subdivide_smoothly(triangles, count)
            count = weights.shape[0]
            levels.append(weights)
        # Subdivision rounds lips and lids off. Moved by as much to the other side first, vertices stay nearly in place.
        rounded = reduce(lambda before, weights: weights @ before, levels)[:n]
        sharper = (2.0 * identity(n) - rounded).tocsr()
        is_known = has_default_triangles(rest)
        neck = cut_neck(rest, load_default_people().parts) if is_known else identity(n, format="csr")
        if detail is None:
            detail = Detail(np.zeros(count, np.float32))
        return cls((neck, sharper, *levels), triangles, detail.heights, detail.colours)

    def end_neck(self, skin: Floats) -> Floats:
        """Return a skin (n, 3) [mm] whose neck ends clean, where that is known."""
        return self.steps[0] @ skin

    def spread(self, values: Floats) -> Floats:
        """Return what values (n, ...) at the skin's vertices are at the fine ones, shape (k, ...)."""
        return reduce(lambda before, weights: weights @ before, self.steps, values)

    def refine(self, skin: Floats) -> Surface:
        """Return the fine skin [mm] of a skin (n, 3) [mm] in any expression."""
        smooth = Surface(self.spread(skin), self.triangles)
        return smooth.with_vertices(smooth.vertices + self.heights[:, None] * smooth.vertex_normals)
