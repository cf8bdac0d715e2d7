"""The corotated law: linear elasticity in the rotated frame."""

from __future__ import annotations

from dataclasses import dataclass

from .material import LameLaw


@dataclass(frozen=True)
class Corotated(LameLaw):
    """psi = mu ‖F - R‖² + lmbda/2 tr²(S - I), F = R S with a rotation R; mu and lmbda [kPa].

    Chao, Pinkall, Sanan, Schröder 2010, "A Simple Geometric Model for Elastic Deformations". Finite for every F: an
    inverted one has a negative principal stretch. Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """
