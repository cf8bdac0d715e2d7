"""A guard against inverted tets: thin tets of soft tissue resist stretches that no face has.

The energies of Eq. 10 are finite at inversion, and a tet of half a millimetre, as at lids and lips, is inverted by
targets that are some tenths of a millimetre off what its neighbours allow. Mesh motion meets the same with stiffness
that grows as elements shrink (Stein, Tezduyar and Benney 2003); here it acts on none but extreme stretches.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats, Ints, tet_volumes
from ..terms import Strain

FREE_STRETCH = 3.0
"""Stretches within [1 / FREE_STRETCH, FREE_STRETCH] are left alone: no answer within them changes."""
THIN = 4.0
"""[mm] Tets of less height are guarded, the more the thinner they are."""
STIFFNESS = 20.0
"""A guard's stiffness over soft tissue's: STIFFNESS (THIN / height - 1), so that it resists displacements alike."""


def guard(vertices: Floats, tets: Ints, stiffness: float | Floats) -> Strain | None:
    """The guard of tets (k, 4), the first of a scene over `vertices` [mm]; None where none of them is thin.

    stiffness [kPa]: soft tissue's, one or one per tet.
    """
    height = _heights(vertices, tets)
    thin = np.flatnonzero(height < THIN)
    if not thin.size:
        return None
    own = np.broadcast_to(stiffness, len(tets))[thin]
    return Strain(STIFFNESS * own * (THIN / height[thin] - 1.0), FREE_STRETCH, tets=thin)


def is_guard(strain: Strain) -> bool:
    """Whether a scene's Strain is a guard: tissue's own strain limit is never as wide."""
    return bool(np.all(strain.limit >= FREE_STRETCH))


def _heights(vertices: Floats, tets: Ints) -> Floats:
    """The smallest height of each tet [mm], shape (k,): three volumes over its largest face."""
    x = vertices[tets]
    faces = [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]
    doubled = [np.linalg.norm(np.cross(x[:, j] - x[:, i], x[:, k] - x[:, i]), axis=1) for i, j, k in faces]
    return 6.0 * tet_volumes(vertices, tets) / np.max(doubled, axis=0)
