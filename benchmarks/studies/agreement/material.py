"""Compare PD's energy with hyperelastic laws: stresses of a uniform cube, over Poisson's ratio and strain."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from ....lhm.base.errors import SoftdecaError
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....reference.added import added_laws
from ....reference.materials import (
    Corotated,
    EnergyLaw,
    IsochoricNeoHookean,
    NeoHookean,
    StableNeoHookean,
    StVenantKirchhoff,
    lame,
)
from ....reference.skfem.solids import ByInvariants, ByRotation, Law, Strain, Volume
from ...harness.study import Column, Row, Study, Task, Values, at_most

LAWS: Mapping[str, Callable[[float, float], EnergyLaw | Corotated]] = {
    "neo-Hookean": NeoHookean.from_young,
    "stable neo-Hookean": StableNeoHookean.from_young,
    "isochoric neo-Hookean": IsochoricNeoHookean.from_young,
    "corotated": Corotated.from_young,
    "St. Venant-Kirchhoff": StVenantKirchhoff.from_young,
}
MODES = {"one axis": (1, 0), "two axes": (2, 0), "pure shear": (1, 1)}
"""Axes that are stretched, and that keep their length."""
BANDS = {"tiny": 0.005, "small": 0.05, "middle": 0.2, "large": 0.5}
"""Largest strain |stretch - 1| of the figures."""
STRETCHES = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.995, 1.005, 1.05, 1.1, 1.2, 1.3, 1.4, 1.5)


@dataclass(frozen=True)
class Material(Study):
    """Poisson's ratios and modes of deformation by law, with those that files have added."""

    name = "material"
    question = "Which material does the fast simulator stand for?"
    cheap = "nu = 0.45, one axis, neo-Hookean"
    columns = (
        Column("tiny", "differs at 0.5 % strain, max [%]"),
        Column("small", "at 5 % [%]"),
        Column("middle", "at 20 % [%]"),
        Column("large", "at 50 % [%]"),
    )
    note = (
        "A unit cube on rollers of PD's energy, w_str/2 |F - R|² + w_vol/2 min |F - T|² over det T = 1. Beside it a "
        "law with the same small-strain moduli: w_str = 2 mu, w_vol = 3 lmbda, E = 1 kPa. Nominal stresses (the "
        "energy's derivative) at the same stretch; their difference is over the law's. The other axes are free; in "
        "pure shear one keeps its length. Energies are those of our scikit-fem solver, which has every law."
    )

    poisson: tuple[float, ...] = option((0.3, 0.4, 0.45, 0.49), "repeat for several", name="--poisson", type=float)

    def tasks(self) -> Sequence[Task]:
        """List each Poisson's ratio and mode by each law; SceneError for a ratio out of range."""
        for ratio in self.poisson:
            lame(1.0, ratio)
        return [
            Task(f"nu = {nu}, {mode}", law) for nu in self.poisson for mode in MODES for law in (*LAWS, *added_laws())
        ]

    def measure(self, task: Task) -> Values:
        """Measure stresses of both at every stretch, and the largest differences by strain."""
        ratio, mode = task.case.removeprefix("nu = ").split(", ")
        mu, lmbda = lame(1.0, float(ratio))
        added = added_laws().get(task.method)
        material = added.of_moduli(mu, lmbda) if added else LAWS[task.method](1.0, float(ratio))
        law = ByRotation(material) if isinstance(material, Corotated) else ByInvariants(material)
        pd = Strain(np.array([2.0 * mu]), np.ones(1)), Volume(np.array([3.0 * lmbda]), np.ones(1))
        energies: tuple[Sequence[Law], Sequence[Law]] = pd, [law]
        ours, theirs = (
            np.array([find_stress(each, stretch, *MODES[mode]) for stretch in STRETCHES]) for each in energies
        )
        off = 100.0 * np.abs(ours - theirs) / np.abs(theirs)
        strain = np.abs(np.array(STRETCHES) - 1.0)
        worst = {name: float(off[strain <= most + 1e-9].max()) for name, most in BANDS.items()}
        return {"stretch": list(STRETCHES), "pd_kpa": ours.tolist(), "law_kpa": theirs.tolist(), **worst}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that the moduli at rest are the same, whatever the law."""
        worst = max(row.values["tiny"] for row in rows)
        return [at_most("largest difference at 0.5 % strain, all laws [%]", worst, 5.0)]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the nearest law by strain, its difference the worst over cases."""
        parts = []
        for name, most in list(BANDS.items())[1:]:
            worst = {
                law: max(row.values[name] for row in rows if row.method == law)
                for law in dict.fromkeys(row.method for row in rows)
            }
            nearest = min(worst, key=lambda law: worst[law])
            parts.append(f"up to {100 * most:.0f} % strain the {nearest} law, to {worst[nearest]:.0f} % of its stress")
        return f"PD's energy stands nearest for: {'; '.join(parts)}."


def find_stress(energies: Sequence[Law], stretch: float, loaded: int, confined: int) -> float:
    """Find the nominal stress [kPa] of each stretched axis, where the free axes bear none."""
    stretches = [stretch] * loaded + [1.0] * confined

    def measure(free: Floats) -> tuple[float, Floats]:
        """Energy density and nominal stresses (3,) [kPa]."""
        F = np.diag([*stretches, *free])[None]
        density = sum(float(law.psi(F)[0]) for law in energies)
        return density, np.diagonal(sum(law.stress(F)[0] for law in energies))

    def measure_free(free: Floats) -> tuple[float, Floats]:
        density, stresses = measure(free)
        return density, stresses[len(stretches) :]

    # Nominal stress [kPa] that is left on free axes; Young's modulus is 1.
    settled = minimize(measure_free, np.ones(3 - len(stretches)), jac=True, method="BFGS", options={"gtol": 1e-7})
    if not settled.success:
        raise SoftdecaError(f"stretch {stretch:g}: {settled.message}")
    return float(measure(settled.x)[1][0])
