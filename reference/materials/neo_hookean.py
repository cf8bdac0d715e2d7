"""The compressible neo-Hookean law with a logarithmic volumetric part."""

from __future__ import annotations

from dataclasses import dataclass

from .material import LameLaw


@dataclass(frozen=True)
class NeoHookean(LameLaw):
    """psi = mu/2 (I1 - 3) - mu ln J + lmbda/2 ln²J (Bonet and Wood 2008, Eq. 6.27); mu and lmbda [kPa].

    Infinite for J <= 0. Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """
