"""The stable neo-Hookean law, which is finite and smooth through inversion."""

from __future__ import annotations

from dataclasses import dataclass

from .material import LameLaw


@dataclass(frozen=True)
class StableNeoHookean(LameLaw):
    """psi = m/2 (I1 - 3) + l/2 (J - a)² - m/2 ln(I1 + 1) up to a constant, m = 4/3 mu, l = lmbda + 5/6 mu.

    a = 1 + m/l - m/(4 l) makes rest free of stress; m and l make mu and lmbda [kPa] the moduli there (Smith, de Goes,
    Kim 2018, "Stable Neo-Hookean Flesh Simulation", Section 3.4). Finite for every F.
    Raises SceneError unless mu > 0 and lmbda > -2/3 mu.
    """
