"""The template: three wraps of one triangulation around a head, and what ties them to its skin."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from ..base.geometry.mirror import find_twins, is_symmetric
from ..base.mesh import Floats, Ints, Surface
from ..head.columns import Columns
from ..head.head import LayeredHead
from ..identities.space import LinearSpace
from .depths.depths import DepthRegressor
from .wraps.landmarks import Landmarks, Mask, find_landmarks

DEFAULT_LEVEL = 2
LEVELS = {1: 1212, 2: 4842, 3: 19362}
"""Wrap vertices per level; each level splits the triangles of the one before into four."""


@dataclass(frozen=True, eq=False)
class Template:
    """A head's skin [mm], its wraps, their labels and their ties to the skin.

    `parts` (skin vertices,): OUTSIDE, MOUTH, EYES or CAP; `stack` (3 n, 3) [mm]: skin, muscle and skull wrap over
    `triangles` (m, 3); `room` (n,) [mm]: how long a column may be before it meets tissue of another; `bone`,
    `regions`, `wrap_from_skin` and `skin_from_wrap` as in LayeredHead. `muscles` and `skull`: the surfaces that the
    inner wraps lie on, where the template was built from some; `skull_bone`: which bone each vertex of the latter is.
    `regressor`: how deep the skull wrap lies under a skin wrap; without one, as deep as in the template. `space`: whose
    mean head this is, where it is known: its expressions go to the heads that are fitted, and its identities help to
    register skins of another topology.
    """

    name: str
    skin: Surface
    parts: Ints = field(repr=False)
    triangles: Ints = field(repr=False)
    stack: Floats = field(repr=False)
    room: Floats = field(repr=False)
    bone: Ints = field(repr=False)
    wrap_from_skin: csr_matrix = field(repr=False)
    skin_from_wrap: csr_matrix = field(repr=False)
    regions: Mapping[str, Mask] = field(repr=False)
    muscles: Surface | None = field(default=None, repr=False)
    skull: Surface | None = field(default=None, repr=False)
    skull_bone: Ints | None = field(default=None, repr=False)
    regressor: DepthRegressor | None = field(default=None, repr=False)
    space: LinearSpace | None = field(default=None, repr=False)

    @property
    def skin_wrap(self) -> Surface:
        """The outermost wrap [mm]."""
        return Surface(self.stack[: self.columns.n], self.triangles)

    @cached_property
    def columns(self) -> Columns:
        """Columns of the triangulation."""
        return Columns(self.triangles, len(self.stack) // 3)

    @cached_property
    def _symmetric_columns(self) -> Columns | None:
        """`columns` with twins; None where the wraps are not their own mirror image."""
        n = self.columns.n
        twins = find_twins(self.stack[:n])
        if twins is None or not is_symmetric(self.stack.reshape(3, n, 3), twins):
            return None
        return Columns(self.triangles, n, twins)

    @cached_property
    def _skin_twins(self) -> Ints | None:
        return find_twins(self.skin.vertices)

    def columns_of(self, skin: Surface) -> Columns:
        """Return the columns of a head with this skin: those with twins where skin and wraps are symmetric."""
        if self._skin_twins is None or not is_symmetric(skin.vertices, self._skin_twins):
            return self.columns
        return self._symmetric_columns or self.columns

    @cached_property
    def landmarks(self) -> Landmarks:
        """The landmarks of the skin."""
        return find_landmarks(self.skin, self.parts)

    @property
    def digest(self) -> str:
        """A name for the layers: 12 hexadecimal digits that change with the skin, the wraps or the labels."""
        content = hashlib.sha256()
        for array in (self.skin.vertices, self.triangles, self.stack, self.bone):
            content.update(np.ascontiguousarray(array).tobytes())
        return content.hexdigest()[:12]

    @property
    def head(self) -> LayeredHead:
        """The template's own head."""
        return self.layered(self.skin, self.stack, muscles=self.muscles, skull=self.skull)

    def layered(
        self, skin: Surface, stack: Floats, *, muscles: Surface | None = None, skull: Surface | None = None
    ) -> LayeredHead:
        """Make a head of this template's triangulation from its skin and the stacked wraps (3 n, 3) [mm]."""
        skin_wrap, muscle_wrap, skull_wrap = (Surface(wrap, self.triangles) for wrap in stack.reshape(3, -1, 3))
        ties = (self.wrap_from_skin, self.skin_from_wrap)
        wraps = (skin_wrap, muscle_wrap, skull_wrap)
        return LayeredHead(skin, *wraps, self.bone, *ties, self.regions, muscles, skull)
