"""The best rigid motion between two sets of points."""

from __future__ import annotations

import numpy as np

from ..mesh import Floats


def rigid_motion(rest: Floats, moved: Floats) -> tuple[Floats, Floats]:
    """Rotation R (3, 3) and translation t [mm] of the least-squares fit moved = R rest + t, (n, 3) (Kabsch 1976)."""
    a, b = rest.mean(axis=0), moved.mean(axis=0)
    u, _, vt = np.linalg.svd((moved - b).T @ (rest - a))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return rotation, b - rotation @ a
