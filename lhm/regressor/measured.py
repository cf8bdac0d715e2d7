"""Depths measured on a head whose skull is known: from the skin wrap inward to the bone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu

from ..base.geometry.bvh import TriangleTree
from ..base.geometry.rays import first_hits
from ..base.mesh import Floats, Surface
from ..wraps.landmarks import Mask

if TYPE_CHECKING:
    from ..template import Template

PLAUSIBLE = (1.0, 40.0)
"""Least and greatest depth [mm] of soft tissue over bone: over the nasal bones about 1, in a heavy cheek 30."""

SLIPPED = 2.0
"""A ray that goes this many times as far as bone is near has slipped through a gap that a skull wrap spans."""

SMOOTH = 4.0
"""Implicit smoothing of the rays' directions, as of the layers' connectors."""


@dataclass(frozen=True, eq=False)
class MeasuredDepths:
    """Depths (n,) [mm] within PLAUSIBLE, and where a ray measured them, (n,); elsewhere the closest point counts."""

    depths: Floats = field(repr=False)
    met: Mask = field(repr=False)

    @property
    def missed(self) -> int:
        """At how many vertices no ray measured the depth."""
        return int(np.count_nonzero(~self.met))


def moved_wrap(template: Template, skin: Floats) -> Floats:
    """The template's skin wrap (n, 3) [mm] moved with a skin (skin vertices, 3) of its topology."""
    return template.skin_wrap.vertices + template.wrap_from_skin @ (skin - template.skin.vertices)


def inward_normals(skin_wrap: Surface) -> Floats:
    """Unit directions (n, 3) into the head: area-weighted normals, smoothed so that a crease's rays do not cross."""
    n, corners = len(skin_wrap.vertices), skin_wrap.triangles
    i, j = corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).T
    # Each edge of a closed surface runs once in either direction.
    edges = csr_matrix((np.ones(len(i)), (i, j)), shape=(n, n))
    laplacian = diags(np.asarray(edges.sum(axis=1)).ravel()) - edges
    inward = -splu((identity(n) + SMOOTH * laplacian).tocsc()).solve(skin_wrap.vertex_normals)
    return inward / np.linalg.norm(inward, axis=1, keepdims=True)


def measured_depths(skin_wrap: Floats, inward: Floats, bones: Sequence[Surface]) -> MeasuredDepths:
    """Distances from a skin wrap's vertices (n, 3) [mm] along `inward` (n, 3) to the first bone that a ray meets.

    Where none is met within the plausible range (eye sockets, the nose's tip, the neck), or only one far behind the
    closest (through a hole of thin bone, between the teeth, under the zygomatic arch), the closest point of the bones
    counts instead, limited to that range.
    """
    starts = np.cumsum([0, *(len(bone.vertices) for bone in bones)])
    triangles = np.vstack([bone.triangles + start for bone, start in zip(bones, starts[:-1], strict=True)])
    tree = TriangleTree(np.vstack([bone.vertices for bone in bones]), triangles)
    along, closest = first_hits(tree, skin_wrap, inward, PLAUSIBLE[1])[1], tree.closest(skin_wrap)[2]
    met = along <= np.maximum(SLIPPED * closest, PLAUSIBLE[0])
    return MeasuredDepths(np.clip(np.where(met, along, closest), *PLAUSIBLE), met)
