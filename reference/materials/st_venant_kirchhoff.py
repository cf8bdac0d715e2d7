"""The St. Venant-Kirchhoff law: linear elasticity in Green's strain."""

from __future__ import annotations

from dataclasses import dataclass

from .material import LameLaw


@dataclass(frozen=True)
class StVenantKirchhoff(LameLaw):
    """psi = mu tr E² + lmbda/2 tr²E, E = (FᵀF - I)/2 (Bonet and Wood 2008, Eq. 6.25); mu and lmbda [kPa].

    For small strains only: it softens under compression and does not see inversion, F and -F cost the same.
    Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """
