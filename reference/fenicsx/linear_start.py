"""The scene that a large mixed problem starts from: a compressible law on linear tets finds the way cheaply."""

from __future__ import annotations

from dataclasses import replace

from ..materials import NeoHookean
from ..scene import Scene
from ..terms import Hyperelastic, Term
from .mixed_densities import shear_modulus

BULK = 10.0
"""lmbda by mu: volumes are nearly kept, linear tets do not lock yet."""


def compressible(scene: Scene) -> Scene:
    """The scene with a neo-Hookean law of the same shear modulus and a low bulk modulus in place of every law."""

    def softer(term: Term) -> Term:
        if not isinstance(term, Hyperelastic):
            return term
        mu = shear_modulus(term.material)
        return replace(term, material=NeoHookean(mu, BULK * mu))

    return replace(scene, terms=tuple(softer(term) for term in scene.terms))
