"""Points and weights on the reference tet and triangle, by an element's degree; all weights are positive.

With a negative weight, semi-definite tangents at the points would not add up to a semi-definite one of the element.
"""

from __future__ import annotations

import numpy as np
from skfem.quadrature import get_quadrature
from skfem.refdom import RefTet, RefTri

from ...lhm.base.mesh import Floats

# Keast (1986), the rule of 14 points and degree 4: six edges' middles, then twice four points (1 - 3a, a, a, a) in
# barycentric coordinates. scikit-fem's own rule of that degree has a negative weight.
EDGE_WEIGHT = 2 / 105
ORBITS = ((0.10052676522520447, 0.08858982474298065), (0.31437287349319220, 0.13283874668559070))


def tet_rule(degree: int) -> tuple[Floats, Floats]:
    """Points (3, q) and weights (q,) for tets of degree 1 or 2: exact for polynomials of degree 1 or 4."""
    if degree == 1:
        return get_quadrature(RefTet, 1)
    barycentric = [0.5 * (np.eye(4)[i] + np.eye(4)[j]) for i in range(4) for j in range(i)]
    weights = [EDGE_WEIGHT] * 6
    for a, weight in ORBITS:
        barycentric += list(a + (1 - 4 * a) * np.eye(4))
        weights += [weight] * 4
    return np.array(barycentric).T[1:], np.array(weights) / 6


def triangle_rule(degree: int) -> tuple[Floats, Floats]:
    """Points (2, q) and weights (q,) for triangles of degree 1 or 2: exact for polynomials of degree 1 or 4."""
    if degree == 1:
        return np.full((2, 1), 1 / 3), np.array([1 / 2])
    return get_quadrature(RefTri, 4)
