"""Every law of materials on a small block, and the elements of FEniCSx that model it."""

import numpy as np

from softdeca.reference.materials import (
    Corotated,
    Guccione,
    IsochoricNeoHookean,
    MooneyRivlin,
    NeoHookean,
    StableNeoHookean,
    StVenantKirchhoff,
    lame,
)
from softdeca.reference.materials.material import HasMixedDensity
from softdeca.reference.problems.recovery import POISSON, YOUNG
from softdeca.reference.terms import Hyperelastic, Strain, Volume

MU, LMBDA = lame(YOUNG, POISSON)
KAPPA = LMBDA + 2 / 3 * MU
PD = "Strain + Volume"
LAWS = {
    "NeoHookean": NeoHookean(MU, LMBDA),
    "StableNeoHookean": StableNeoHookean(MU, LMBDA),
    "Corotated": Corotated(MU, LMBDA),
    "StVenantKirchhoff": StVenantKirchhoff(MU, LMBDA),
    "IsochoricNeoHookean": IsochoricNeoHookean(MU, KAPPA),
    "MooneyRivlin": MooneyRivlin(0.3 * MU, 0.2 * MU, KAPPA),
    "Guccione": Guccione(MU, 2.0, 0.5, 1.0, np.array([1.0, 2.0, 0.0]), KAPPA),
    PD: None,
}


def energies_of(law):
    """The terms of a law by its name."""
    return (Strain(2 * MU), Volume(3 * LMBDA)) if law == PD else (Hyperelastic(LAWS[law]),)


def elements_of(law):
    """The elements of FEniCSx that model a law by its name."""
    return ("P1", "P2", "P2P1") if isinstance(LAWS[law], HasMixedDensity) else ("P1", "P2")
