"""Time integration: how displacement, velocity and acceleration at two times hang together, and where forces balance.

u₁ = u₀ + h v₀ + h² (β₀ a₀ + β₁ a₁) and v₁ = v₀ + h (γ₀ a₀ + γ₁ a₁), with
M (α_m a₀ + (1 - α_m) a₁) + α_f (C v₀ + f₀) + (1 - α_f) (C v₁ + f₁) = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..lhm.base.errors import SceneError

SCHEMES = ("implicit Euler", "Newmark", "generalised-alpha")


@dataclass(frozen=True)
class Scheme:
    """The coefficients above [1]; `name` is for reports."""

    name: str
    by_acceleration: tuple[float, float]  # β₀, β₁
    to_velocity: tuple[float, float]  # γ₀, γ₁
    alpha_m: float = 0.0
    alpha_f: float = 0.0


def scheme(name: str, *, spectral_radius: float = 0.8) -> Scheme:
    """A scheme by name; spectral_radius in [0, 1] is that of "generalised-alpha" at infinite frequency.

    "implicit Euler" is of order 1 and damps what it does not resolve; "Newmark" (β = 1/4, γ = 1/2) and
    "generalised-alpha" (Chung and Hulbert 1993) are of order 2, the former without loss at any frequency, the latter
    with loss at high ones only. Raises SceneError for another name or radius.
    """
    if name not in SCHEMES:
        raise SceneError(f"unknown scheme {name!r}; there are {', '.join(SCHEMES)}")
    radius = float(spectral_radius)
    if not 0.0 <= radius <= 1.0:
        raise SceneError(f"spectral_radius: must lie in [0, 1], got {spectral_radius!r}")
    if name == "implicit Euler":
        return Scheme(name, (0.0, 1.0), (0.0, 1.0))
    alpha_m = alpha_f = 0.0
    if name == "generalised-alpha":
        alpha_m, alpha_f = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
    gamma = 0.5 - alpha_m + alpha_f
    beta = 0.25 * float(np.square(1.0 - alpha_m + alpha_f))
    return Scheme(name, (0.5 - beta, beta), (1.0 - gamma, gamma), alpha_m, alpha_f)
