"""H1-H3, H5-H9, H11 for every law on every element of FEniCSx: what each makes of starts and motions that are hard.

Which outcomes are no fault depends on the law. The corotated law leads back from anywhere. Strain + Volume and the
stable neo-Hookean law have other equilibria, with tets that stay inside out, which a random start may end in. Laws with
ln J, or J to a power below 0, are infinite for an inverted tet: they must refuse such a start. The St. Venant-Kirchhoff
law does not see inversion, so whatever it does there, it is not at fault. A quadratic element starts from
vertices, its edges straight, which after a crush may be inverted. Taylor-Hood's element follows the load first and
descends where that gives up: it must come back where the start is near, or say that it cannot.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.optimize import brentq

from ..added import added_laws
from ..materials import (
    Corotated,
    Guccione,
    IsochoricNeoHookean,
    Material,
    MooneyRivlin,
    NeoHookean,
    StableNeoHookean,
    StVenantKirchhoff,
    lame,
)
from ..materials.material import HasMixedDensity
from ..scene import Scene
from ..terms import Fixed, Gravity, Hyperelastic, Strain, Term, Volume
from . import bars, cook, recovery, time_steps
from .meshes import block, vertices_at
from .problem import Attempt, HardCase

FIBRE = np.array([1.0, 2.0, 0.0])
STIFF_IN_VOLUME = 0.49
"""Poisson's ratio of H6."""


def laws(poisson: float) -> dict[str, Material | None]:
    """Every law of H1's Young's modulus, and those that files have added; None stands for Strain + Volume."""
    mu, lmbda = lame(recovery.YOUNG, poisson)
    kappa = lmbda + 2 / 3 * mu
    return {
        "NeoHookean": NeoHookean(mu, lmbda),
        "StableNeoHookean": StableNeoHookean(mu, lmbda),
        "Corotated": Corotated(mu, lmbda),
        "StVenantKirchhoff": StVenantKirchhoff(mu, lmbda),
        "IsochoricNeoHookean": IsochoricNeoHookean(mu, kappa),
        "MooneyRivlin": MooneyRivlin(0.3 * mu, 0.2 * mu, kappa),
        "Guccione": Guccione(mu, 2.0, 0.5, 1.0, FIBRE, kappa),
        "Strain + Volume": None,
        **{name: added.of_moduli(mu, lmbda) for name, added in added_laws().items()},
    }


LAWS = laws(recovery.POISSON)
DISPLACEMENT, MIXED = ("P1", "P2"), ("P2P1",)
MANY_MINIMA, BLIND = ("StableNeoHookean", "Strain + Volume"), ("StVenantKirchhoff",)
LINEAR = ("Corotated", "StVenantKirchhoff")
"""Laws whose lmbda resists the trace of a strain, not J."""
PASSED, REFUSED = ("passed",), ("NOT_FINITE",)
ANYTHING = ("passed", "missed", "NOT_FINITE", "LINE_SEARCH", "LIMIT_POINT", "STAGNATED", "MAX_ITERATIONS")
STARTS = {name: start for name, start in recovery.STARTS.items() if start[0] != "H1" or name.endswith("seed 0")}
TURN = np.pi
FENICSX = ("fenicsx",)


def energies_of(law: str, poisson: float = recovery.POISSON) -> tuple[Term, ...]:
    """The terms of a law of `laws`, by its name."""
    material = laws(poisson)[law]
    if material is not None:
        return (Hyperelastic(material),)
    mu, lmbda = lame(recovery.YOUNG, poisson)
    return Strain(2 * mu), Volume(3 * lmbda)


def standing(law: str) -> Scene:
    """A small block on a held base."""
    X, tets = block(3)
    return Scene(X, tets, (*energies_of(law), Fixed(vertices_at(X, 2, 0.0))))


def _allowed_outcomes(law: str, source: str, mixed: bool) -> tuple[str, ...]:
    """The outcomes that are no fault where a law starts from collapse, inversion or at random."""
    added = added_laws().get(law)
    if added is not None:
        return (*PASSED, "missed") if added.of_moduli(1.0, 9.0).finite_inverted else REFUSED
    if law not in ("Corotated", *MANY_MINIMA, *BLIND):
        return REFUSED
    if mixed or law in BLIND:
        return ANYTHING
    return (*PASSED, "missed") if law in MANY_MINIMA and source == "H1" else PASSED


def _allowed_after_crush(law: str, share: float, element: str) -> tuple[str, ...]:
    if law == "Corotated" or (share < 0.6 and element == "P1" and law not in BLIND):
        return PASSED
    return ANYTHING


def layers_error(ratio: float, attempt: Attempt) -> float:
    """Relative error of the elongation of two neo-Hookean layers in series, held across, under a pull."""
    first, second = NeoHookean.from_young(1.0, 0.3), NeoHookean.from_young(ratio, 0.3)
    scene = bars.pulled_layers(
        lambda near: (Hyperelastic(first, np.flatnonzero(near)), Hyperelastic(second, np.flatnonzero(~near)))
    )
    expected = sum(0.5 * (_stretch(law, 0.1) - 1.0) for law in (first, second))
    solution = attempt.solve(attempt.prepare(scene), tolerance=1e-11)
    return abs(bars.tip(scene, solution) / expected - 1.0)


def _stretch(law: NeoHookean, stress: float) -> float:
    """The stretch s under a nominal stress: mu (s - 1/s) + lmbda ln s / s, where nothing moves across."""
    return brentq(lambda s: law.mu * (s - 1 / s) + law.lmbda * np.log(s) / s - stress, 1.0, 2.0, xtol=1e-15)


def twist_error(law: str, attempt: Attempt) -> float:
    """How much the volume of a bar changed, relative to it, one end turned against the other by TURN."""
    scene = bars.twisted_bar(energies_of(law, STIFF_IN_VOLUME), TURN)
    start = bars.twist(scene.vertices, TURN)
    return bars.change_of_volume(scene, attempt.solve(attempt.prepare(scene), start=start, tolerance=1e-8))


def share_error(poisson: float, attempt: Attempt) -> float:
    """How far Cook's membrane falls short of Taylor-Hood's element on a finer mesh, relative to it."""
    rises = []
    for way, cells in ((Attempt("fenicsx", "P2P1"), 16), (attempt, 12)):
        scene = cook.locking_panel(poisson, cells)
        solution = way.solve(way.prepare(scene), tolerance=cook.LOCKING_TOLERANCE)
        rises.append(cook.rise(cook.MIDDLE, scene, solution))
    return abs(rises[1] / rises[0] - 1.0)


def elements_of(law: str) -> tuple[str, ...]:
    """The elements of FEniCSx that model a law."""
    return (*DISPLACEMENT, *MIXED) if isinstance(laws(recovery.POISSON)[law], HasMixedDensity) else DISPLACEMENT


def _recoveries(law: str) -> list[HardCase]:
    pose = partial(standing, law)
    cases = []
    for element in elements_of(law):
        for name, (source, start) in STARTS.items():
            error = partial(recovery.start_error, pose, start)
            right = _allowed_outcomes(law, source, element in MIXED)
            cases.append(_case(f"{name}, {law}", source, recovery.CRITERION, error, 1e-6, element, right))
        for share in recovery.CRUSHED:
            name = f"crushed by {100 * share:g} % and released, {law}"
            error = partial(recovery.crush_error, pose, share)
            right = _allowed_after_crush(law, share, element)
            cases.append(_case(name, "H7", recovery.CRITERION, error, 1e-6, element, right))
    return cases


def _case(name: str, source: str, criterion: str, error, bound: float, element: str, right=PASSED) -> HardCase:
    return HardCase(name, source, criterion, error, bound, FENICSX, (element,), right)


def disagreement(law: str, attempt: Attempt) -> float:
    """The largest distance [mm] from FEniCSx' answer of a block of 1 mm that its weight bends sideways."""
    scene = standing(law)
    weight = Gravity(np.array([recovery.YOUNG / 20, 0.0, 0.0]), density=1.0)
    bent = Scene(scene.vertices, scene.tets, (*scene.terms, weight))
    answers = [way.solve(way.prepare(bent)).positions for way in (attempt, Attempt("fenicsx"))]
    return float(np.linalg.norm(answers[0] - answers[1], axis=1).max())


def cases_of(law: str) -> list[HardCase]:
    """The cases of one law, by its name; one that was added is held against its derivatives by hand, too."""
    cases = _recoveries(law)
    if law in added_laws():
        name, error = f"block bent by its weight, {law}", partial(disagreement, law)
        cases.append(HardCase(name, "two codes", "within 1e-6 of FEniCSx", error, 1e-6, ("skfem",)))
    name, error = f"bar twisted by 180° at nu = .49, {law}", partial(twist_error, law)
    right = ANYTHING if law in LINEAR else PASSED
    for element in elements_of(law):
        cases.append(_case(name, "H6", "volume within 2 %", error, 0.02, element, right))
    return cases


def _cases() -> list[HardCase]:
    cases = [case for law in LAWS for case in cases_of(law)]
    for stretch in bars.STRETCHES:
        error = partial(bars.stretch_error, *bars.ENERGIES["NeoHookean nu=.45"][:2], stretch)
        name, criterion = (
            f"bar stretched x{stretch:g}, NeoHookean",
            "principal stretches within .1 % away from the clamp",
        )
        cases += [_case(name, "H5; closed form", criterion, error, 1e-3, element) for element in MIXED]
    for poisson in cook.POISSON:
        name, error = f"Cook's membrane, nu = {poisson:g}", partial(share_error, poisson)
        criterion = "within .5 % of Taylor-Hood's on a finer mesh; the others lock"
        for element in (*DISPLACEMENT, *MIXED):
            outcomes = PASSED if element in MIXED else ("passed", "missed")
            cases.append(_case(name, "H8", criterion, error, cook.NEAR_LIMIT, element, outcomes))
    for ratio in bars.RATIOS:
        error = partial(layers_error, ratio)
        cases += [
            _case(f"neo-Hookean layers, 1:{ratio:g}", "H9; closed form", "elongation within 1e-6", error, 1e-6, element)
            for element in (*DISPLACEMENT, *MIXED)
        ]
    error, criterion = partial(time_steps.distance_to_static, 1000.0), "within 1e-6 of the static answer"
    cases.append(_case("time step of 1000 s, Strain + Volume", "H11", criterion, error, 1e-6, "P2"))
    return cases


CASES = tuple(_cases())
