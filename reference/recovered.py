"""Stresses and reactions of an answer: what each solver works out anew from where its nodes ended, when asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lhm.base.mesh import Floats


@dataclass(frozen=True, eq=False)
class Recovered:
    """Stresses [kPa] of the tets, shape (m, 3, 3), and reactions [mN], shape (n, 3); see `Solution`."""

    first_piola: Floats
    cauchy: Floats
    reactions: Floats

    @classmethod
    def of_points(cls, P: Floats, F: Floats, volume: Floats, reactions: Floats) -> Recovered:
        """Means over the tets of P [kPa] and F at q points each, shape (m, q, 3, 3), of volumes [mm³], shape (m, q).

        P over the volume at rest, Cauchy's stress P Fᵀ / J over the deformed one.
        """
        deformed = np.einsum("mq,mq->m", volume, np.linalg.det(F))
        with np.errstate(divide="ignore", invalid="ignore"):
            cauchy = np.einsum("mq,mqij,mqkj->mik", volume, P, F) / deformed[:, None, None]
        mean = np.einsum("mq,mqij->mij", volume, P) / volume.sum(axis=1)[:, None, None]
        return cls(mean, cauchy, reactions)


def von_mises(cauchy: Floats) -> Floats:
    """√(3/2) ‖dev σ‖ [kPa], shape (m,), of stresses (m, 3, 3)."""
    mean = np.trace(cauchy, axis1=1, axis2=2)[:, None, None] / 3.0
    return np.sqrt(1.5) * np.linalg.norm(cauchy - mean * np.eye(3), axis=(1, 2))
