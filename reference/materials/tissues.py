"""Laws of facial tissues from literature [kPa], each with its source."""

from __future__ import annotations

from ...lhm.base.mesh import Floats
from .guccione import Guccione
from .mooney_rivlin import MooneyRivlin

FACE = MooneyRivlin(C10=2.5, C01=0.0, kappa=25.0, C20=1.175)
"""The whole face as one tissue (Nazari et al. 2010; kappa as in ArtiSynth's face model): mu 5 kPa, nu .41."""

FAT = MooneyRivlin(C10=0.4, C01=0.0, kappa=50.0, C20=1.4)
"""Superficial fat (Barbarino et al. 2011, who give it and the SMAS one law): mu 0.8 kPa."""

SMAS = FAT
"""The superficial musculoaponeurotic system (Barbarino et al. 2011)."""

MUSCLE = FACE
"""Muscle at rest, taken to be as stiff as the whole face (Nazari et al. 2010); no active stress."""


def skin(fibres: Floats) -> Guccione:
    """Facial skin, stiffest along `fibres`, shape (3,) or (m, 3), such as Langer's lines.

    Flynn's orthotropic Fung law, moduli 17.8, 5.9, 5.9 kPa, C 3.78 kPa, kappa 250 kPa (ArtiSynth's face model):
    Q = (2 Σ mu_a (E²)_aa + lmbda tr²E) / C is Guccione's with bf = 2 mu_1 / C, bt = 2 mu_2 / C and
    bfs = (mu_1 + mu_2) / C, but for its lmbda of 1 kPa: tr E is of second order in an isochoric strain.
    """
    C, along, across = 3.78, 17.8, 5.9
    return Guccione(C, 2 * along / C, 2 * across / C, (along + across) / C, fibres, kappa=250.0)
