"""Gent's law, which stiffens as chains of molecules come to their full length: one file, one law."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from softdeca.reference import add_law, terms
from softdeca.reference.materials import EnergyLaw
from softdeca.reference.materials.material import check_lame, lame
from softdeca.reference.problems.homogeneous import Row, free_stretch, loaded_stretch


@dataclass(frozen=True)
class Gent(EnergyLaw):
    """psi = -mu Jm/2 ln(1 - (I1 - 3)/Jm) - mu ln J + beta/2 ln²J; mu, beta [kPa] and Jm [1].

    Gent 1996, "A new constitutive relation for rubber", with the volumetric part of the compressible neo-Hookean law,
    which it is as Jm grows. Infinite for I1 - 3 >= Jm and for J <= 0.
    """

    mu: float
    beta: float
    Jm: float = 30.0

    def __post_init__(self):
        check_lame(self, *self.lame)

    @classmethod
    def of_moduli(cls, mu, lmbda):
        """The law of these moduli at rest [kPa], where the logarithm in I1 adds 2 mu/Jm to beta."""
        return cls(mu, lmbda - 2 * mu / cls.Jm)

    @property
    def lame(self):
        """See Isotropic."""
        return self.mu, self.beta + 2 * self.mu / self.Jm

    def density(self, I1, I2, J, p, m):
        """See EnergyLaw."""
        log_J = m.log(J)
        stretched = -p.mu * p.Jm / 2 * m.log(1 - (I1 - 3) / p.Jm)
        return stretched - p.mu * log_J + p.beta / 2 * log_J**2


def nominal_stress(law, stretches, axis):
    """The nominal stress [kPa] along an axis of a body with these principal stretches, (3,): dpsi/dstretch by hand."""
    I1, log_J = np.sum(np.square(stretches)), np.sum(np.log(stretches))
    shear = law.mu * law.Jm / (law.Jm - I1 + 3)
    return shear * stretches[axis] + (law.beta * log_J - law.mu) / stretches[axis]


def pulled(law, stretch):
    """A cube pulled along one axis, the stretch of the others where their stress is 0."""
    free = brentq(
        lambda s: nominal_stress(law, [stretch, s, s], 1), 0.3, 2.0, xtol=1e-15
    )
    stress = nominal_stress(law, [stretch, free, free], 0)
    return Row(
        "Gent nu=.45, uniaxial",
        (terms.Hyperelastic(law),),
        1,
        stretch,
        free,
        stress,
    )


ROWS = [
    pulled(Gent.of_moduli(*lame(1.0, 0.45)), stretch) for stretch in (0.7, 1.5, 2.0)
]
BOUNDS = {"fenicsx": 1e-9, "skfem": 1e-9}
add_law(
    "Gent",
    Gent.of_moduli,
    problems=tuple(
        make(row, BOUNDS, source="Gent 1996; one equation")
        for row in ROWS
        for make in (free_stretch, loaded_stretch)
    ),
)
