"""Unit cubes of every hyperelastic law, stretched along one axis, two, or one with another confined (pure shear).

Corotated and St. Venant-Kirchhoff have closed forms. The values of the others solve one equation for the free stretch
(tests/verification/test_closed_forms.py). Mooney-Rivlin's formulas are for an incompressible body: they stand beside a
nearly incompressible one, with the error that its compressibility must cause as the bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..materials import (
    Corotated,
    Guccione,
    IsochoricNeoHookean,
    Material,
    MooneyRivlin,
    StableNeoHookean,
    StVenantKirchhoff,
    Volumetric,
)
from ..terms import Hyperelastic, Term
from .homogeneous import SOURCE, TEN_DIGITS, Row, free_stretch, held_energy, under_load
from .problem import Problem

YOUNG, POISSON = 1.0, 0.45
C1, C2 = 0.3, 0.1
BULK = 1e4 * 2 * (C1 + C2)


@dataclass(frozen=True)
class Law:
    """A material as a row's energies."""

    material: Material

    def __call__(self) -> list[Term]:
        """The term."""
        return [Hyperelastic(self.material)]


COROTATED = Law(Corotated.from_young(YOUNG, POISSON))
KIRCHHOFF = Law(StVenantKirchhoff.from_young(YOUNG, POISSON))
STABLE = Law(StableNeoHookean.from_young(YOUNG, POISSON))
QUADRATIC = Law(IsochoricNeoHookean.from_young(YOUNG, POISSON))
LOGARITHMIC = Law(IsochoricNeoHookean.from_young(YOUNG, POISSON, Volumetric.LOGARITHMIC))
POLYNOMIAL = Law(MooneyRivlin(C10=0.1, C01=0.05, kappa=10 / 3, C20=0.02))
ALONG = Law(Guccione(C=2.0, bf=8.0, bt=2.0, bfs=4.0, fibres=np.array([1.0, 0.0, 0.0]), kappa=20.0))
ACROSS = Law(Guccione(C=2.0, bf=8.0, bt=2.0, bfs=4.0, fibres=np.array([0.0, 0.0, 1.0]), kappa=20.0))
RIVLIN = Law(MooneyRivlin(C10=C1, C01=C2, kappa=BULK))


def corotated(stretch: float, loaded: int) -> Row:
    """P is linear in the stretches: E (stretch - 1) along one axis, E/(1 - nu) (stretch - 1) along two."""
    away = stretch - 1
    if loaded == 1:
        return Row("Corotated nu=.45, uniaxial", COROTATED, 1, stretch, 1 - POISSON * away, YOUNG * away)
    free = 1 - 2 * POISSON / (1 - POISSON) * away
    return Row("Corotated nu=.45, equibiaxial", COROTATED, 2, stretch, free, YOUNG / (1 - POISSON) * away)


def kirchhoff(stretch: float) -> Row:
    """S = E e of Green's strain e = (stretch² - 1)/2; the free axes' strain is -nu e, and P = stretch S."""
    e = (stretch**2 - 1) / 2
    free = (1 - 2 * POISSON * e) ** 0.5
    return Row("StVenantKirchhoff nu=.45, uniaxial", KIRCHHOFF, 1, stretch, free, YOUNG * e * stretch)


CLOSED_ROWS = (
    *(corotated(stretch, 1) for stretch in (0.8, 1.5, 2.0)),
    *(corotated(stretch, 2) for stretch in (1.2, 1.5)),
    *(kirchhoff(stretch) for stretch in (1.2, 1.5)),
)
CRUSHED_ROW = corotated(0.5, 1)
SOLVED_ROWS = (
    Row("StableNeoHookean nu=.45, uniaxial", STABLE, 1, 0.7, 1.1673782584, -0.4372646134),
    Row("StableNeoHookean nu=.45, uniaxial", STABLE, 1, 2.0, 0.7228808390, 0.6671711837),
    Row("StableNeoHookean nu=.45, equibiaxial", STABLE, 2, 1.5, 0.4790507973, 0.5112212478),
    Row("IsochoricNeoHookean nu=.45 (quadratic), uniaxial", QUADRATIC, 1, 2.0, 0.7420503532, 0.5576728792),
    Row("IsochoricNeoHookean nu=.45 (quadratic), equibiaxial", QUADRATIC, 2, 1.5, 0.4956669842, 0.4284448055),
    Row("IsochoricNeoHookean nu=.45 (logarithmic), uniaxial", LOGARITHMIC, 1, 2.0, 0.7435047292, 0.5558704664),
    Row("IsochoricNeoHookean nu=.45 (logarithmic), equibiaxial", LOGARITHMIC, 2, 1.5, 0.4980810392, 0.4265481723),
    Row("MooneyRivlin with C20, uniaxial", POLYNOMIAL, 1, 2.0, 0.7460226037, 0.6294546814),
    Row("MooneyRivlin with C20, equibiaxial", POLYNOMIAL, 2, 1.5, 0.5148229027, 0.6114224614),
    Row("MooneyRivlin with C20, pure shear", POLYNOMIAL, 1, 1.5, 0.7153319328, 0.3787427959, confined=1),
)
FIBRE_ROWS = (
    Row("Guccione, uniaxial along the fibres", ALONG, 1, 1.2, 0.9512199470, 4.6571016844),
    Row("Guccione, equibiaxial across the fibres", ACROSS, 2, 1.2, 0.7871152445, 3.7813443531),
)
RIVLIN_SOURCE = "Rivlin 1948, incompressible; the bound is the error of kappa = 1e4 mu"


def rivlin(stretch: float, loaded: int, confined: int = 0) -> Row:
    """P = 2 (C1 + C2/l) (l - l⁻²) along one axis, 2 (C1 + C2 l²) (l - l⁻⁵) along two; 2 (C1 + C2) (l - l⁻³)."""
    s = stretch
    if loaded == 2:
        return Row("MooneyRivlin, equibiaxial", RIVLIN, 2, s, s**-2, 2 * (C1 + C2 * s**2) * (s - s**-5))
    if confined:
        return Row("MooneyRivlin, pure shear", RIVLIN, 1, s, 1 / s, 2 * (C1 + C2) * (s - s**-3), confined=1)
    return Row("MooneyRivlin, uniaxial", RIVLIN, 1, s, s**-0.5, 2 * (C1 + C2 / s) * (s - s**-2))


RIVLIN_ROWS = (rivlin(1.5, 1), rivlin(2.0, 1), rivlin(1.5, 2), rivlin(1.5, 1, 1), rivlin(2.0, 1, 1))


def mean_stress(row: Row) -> float:
    """A third of the trace of Cauchy's stress [kPa] of an incompressible Mooney-Rivlin body."""
    l3 = row.free_stretch
    confined = row.confined * (2 * C1 * (1 - l3**2) - 2 * C2 * (1 - l3**-2))
    return (row.loaded * row.stretch * row.stress + confined) / 3


def free_stretch_error(row: Row) -> float:
    """Relative error of the free stretch to first order in 1 / kappa.

    kappa/2 (J - 1)² makes J - 1 = mean stress / kappa; the free axes share it, as the other stretches are held.
    """
    return mean_stress(row) / BULK / (3 - row.loaded - row.confined)


def stretch_error(row: Row) -> float:
    """Relative error of the stretch under load, to first order in 1 / kappa.

    Where the stretch is held, the energy is lower by (mean stress)² / (2 kappa), and its derivative by the stretch is
    `loaded` times P; so P is lower by e = mean stress · (mean stress)' / (kappa · loaded), which a stretch greater by
    e / P' makes good.
    """
    h = 1e-5
    high, low = (rivlin(row.stretch + d, row.loaded, row.confined) for d in (h, -h))
    e = mean_stress(row) * (mean_stress(high) - mean_stress(low)) / (2 * h) / (BULK * row.loaded)
    return e / ((high.stress - low.stress) / (2 * h)) / row.stretch


def _problems() -> list[Problem]:
    problems = []
    for rows, source in ((CLOSED_ROWS, "closed form"), (SOLVED_ROWS, SOURCE)):
        for row in rows:
            problems += [free_stretch(row, TEN_DIGITS, source), under_load(row, TEN_DIGITS, source=source)]
    # A dead load that halves the corotated cube buckles it: the energy of the held state stands for the stress.
    crushed = YOUNG / 2 * (CRUSHED_ROW.stretch - 1) ** 2
    problems.append(free_stretch(CRUSHED_ROW, TEN_DIGITS, "closed form"))
    problems.append(held_energy(CRUSHED_ROW, TEN_DIGITS, crushed, "closed form"))
    for row in FIBRE_ROWS:
        bounds = {"fenicsx": TEN_DIGITS["fenicsx"]}
        problems += [free_stretch(row, bounds), under_load(row, bounds)]
    for row in RIVLIN_ROWS:
        # Terms of second order are smaller by the relative change of volume, 1e-4.
        held, loaded = (dict.fromkeys(TEN_DIGITS, 1.001 * error(row)) for error in (free_stretch_error, stretch_error))
        problems.append(free_stretch(row, held, RIVLIN_SOURCE))
        problems.append(under_load(row, loaded, source=RIVLIN_SOURCE))
    return problems


PROBLEMS = tuple(_problems())
