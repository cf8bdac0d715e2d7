"""How far two sets of positions are apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lhm.base.mesh import Floats


@dataclass(frozen=True)
class Difference:
    """Vertex distances [mm]: mean, root mean square, 95th percentile, max; and max over the largest displacement."""

    mean: float
    rms: float
    p95: float
    max: float
    relative: float


def distances(a: Floats, b: Floats) -> Floats:
    """Distance of each vertex [mm], shape (n,), of positions (n, 3)."""
    return np.linalg.norm(a - b, axis=1)


def difference(a: Floats, b: Floats, rest: Floats, mask: np.ndarray | None = None) -> Difference:
    """Of positions `a` to reference `b`, both (n, 3) [mm]; displacement is counted from `rest`; over mask (n,)."""
    if mask is not None:
        a, b, rest = a[mask], b[mask], rest[mask]
    d = distances(a, b)
    largest = distances(b, rest).max()
    return Difference(
        mean=float(d.mean()),
        rms=float(np.sqrt(np.mean(d**2))),
        p95=float(np.percentile(d, 95)),
        max=float(d.max()),
        relative=float(d.max() / largest) if largest > 0 else float(d.max() > 0),
    )
