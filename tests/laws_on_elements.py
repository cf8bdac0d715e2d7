"""Every law of materials on a small block, and the elements of FEniCSx that model it."""

from softdeca.reference.materials import (
    Corotated,
    IsochoricNeoHookean,
    MixedLaw,
    MooneyRivlin,
    NeoHookean,
    StableNeoHookean,
    StVenantKirchhoff,
    lame,
)
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
    PD: None,
}


def energies_of(law):
    """The terms of a law by its name."""
    return (Strain(2 * MU), Volume(3 * LMBDA)) if law == PD else (Hyperelastic(LAWS[law]),)


def elements_of(law):
    """The elements of FEniCSx that model a law by its name."""
    return ("P1", "P2", "P2P1") if isinstance(LAWS[law], MixedLaw) else ("P1", "P2")
