"""Bars: elongations of projective dynamics' strain energy in closed form, a pull to ten times the length, a twist.

H5: a bar clamped at one end and pulled to 2, 5 and 10 times its length by its law's nominal stress. Away from the clamp
the stretches must be those of the law's closed form. At 5 times its length the lateral stretches of projective
dynamics' energies differ: an F far from det F = 1 is nearer to a flat shape of that volume than to a round one. Which
way a tet is flat is left to it, so the principal stretches of each are what is compared; where flats of different
directions meet, they cost the lateral stretches some 0.14 % (FEniCSx finds the same).
H6: a bar turned through 360° at nu = .49, one end against the other. Layers have stiffnesses that differ much.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from scipy.optimize import brentq, minimize

from ...lhm.base.mesh import Floats
from ..materials import NeoHookean, lame
from ..scene import Scene
from ..solution import Solution
from ..solve import solve
from ..terms import Fixed, Gravity, Hyperelastic, Strain, Term, Traction, Volume
from .meshes import box, principal_stretches, triangles_at, twist, vertices_at
from .problem import EVERY_SOLVER, Attempt, HardCase, Problem

CELLS = (8, 2, 2)
RATIOS = (1.0, 1e2, 1e4, 1e6)


def _lateral_rollers(X: Floats) -> Fixed:
    """Every vertex moves along the bar only."""
    return Fixed(np.arange(len(X)), components=(1, 2))


def self_weight() -> Scene:
    """A bar of length 1 m, density 1000 kg/m³ and stiffness 1e5 Pa in 9.81 m/s², hanging from x = 0 (SI units).

    The load of a section's vertices differs, so the section warps a little: the mean is exact but for the square of
    that warp, which finer cells along the bar make small.
    """
    X, tets = box((2 * CELLS[0], *CELLS[1:]), (1.0, 0.25, 0.25))
    terms: tuple[Term, ...] = (
        Strain(1e5),
        Gravity(np.array([9.81, 0.0, 0.0]), density=1000.0),
        Fixed(vertices_at(X, 0, 0.0), components=(0,)),
        _lateral_rollers(X),
    )
    return Scene(X, tets, terms)


def pulled_layers(energies: Callable[[np.ndarray], Sequence[Term]]) -> Scene:
    """A bar of two halves under a pull of .1 kPa; its energies are given for a mask of the first half's tets."""
    X, tets = box(CELLS, (1.0, 0.25, 0.25))
    terms: tuple[Term, ...] = (
        *energies(X[tets, 0].mean(axis=1) < 0.5),
        Traction(triangles_at(X, tets, 0, 1.0), np.array([0.1, 0.0, 0.0])),
        Fixed(vertices_at(X, 0, 0.0), components=(0,)),
        _lateral_rollers(X),
    )
    return Scene(X, tets, terms)


def layers(ratio: float) -> Scene:
    """Two halves of strain energy, the second `ratio` times as stiff as the first, of 1 kPa."""
    return pulled_layers(lambda first: (Strain(np.where(first, 1.0, ratio)),))


def elongation(ratio: float) -> float:
    """Return the elongation [mm] of the bar of `layers`: F/A (L1/w1 + L2/w2)."""
    return 0.1 * (0.5 + 0.5 / ratio)


def tip(scene: Scene, solution: Solution) -> float:
    """The mean displacement over the area of the face x = 1, along x."""
    triangles = triangles_at(scene.vertices, scene.tets, 0, 1.0)
    corners = scene.vertices[triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    moved = (solution.positions - scene.vertices)[triangles, 0].mean(axis=1)
    return float(areas @ moved / areas.sum())


BOUNDS = dict.fromkeys(EVERY_SOLVER, 1e-6)
PROBLEMS = (
    Problem(
        "bar under its own weight",
        "closed form: tip = rho g L²/(2 ws)",
        self_weight,
        tip,
        1000.0 * 9.81 / (2 * 1e5),
        BOUNDS,
    ),
    *(
        Problem(
            f"two layers in series, 1:{ratio:g}",
            "closed form: F/A (L1/w1 + L2/w2)",
            partial(layers, ratio),
            tip,
            elongation(ratio),
            BOUNDS,
        )
        for ratio in RATIOS
    ),
)

PULLED_LENGTH, PULLED_CELLS, FEW_CELLS = 6.0, (24, 4, 4), (12, 2, 2)
CLAMPED = 3.0
"""From the clamp on, widths of the bar that are left out."""
START = 0.9
"""The share of the stretch that a solve starts from, so that the answer is not given away."""
FLAT = 4.0
"""The stretch from which on tets of Strain + Volume are flat rather than round."""
STRETCHES = (2.0, 5.0, 10.0)
VOLUME = 10.0
YOUNG, POISSON = 1.0, 0.45

Law = Callable[[float], tuple[Floats, float]]


def strain_law(stretch: float) -> tuple[Floats, float]:
    """Lateral stretches and nominal stress of ‖F - R‖²/2: 1, 1 and the stretch less 1."""
    return np.ones(2), stretch - 1.0


def strain_and_volume_law(stretch: float) -> tuple[Floats, float]:
    """The same of ‖F - R‖²/2 + VOLUME/2 min ‖F - T‖² over det T = 1.

    For T = diag(1/(a b), a, b) the best lateral stretches are (1 + VOLUME (a, b)) / (1 + VOLUME), which leaves a
    problem in a and b.
    """

    def density(t):
        along = stretch - 1.0 / (t[0] * t[1])
        return along**2 + ((t[0] - 1.0) ** 2 + (t[1] - 1.0) ** 2) / (1.0 + VOLUME)

    settings = {"xatol": 1e-12, "fatol": 1e-15, "maxiter": 2000}
    starts = ((1.0, 1.0), (0.9, 0.5), (0.9, 0.2))
    best = min((minimize(density, t, method="Nelder-Mead", options=settings) for t in starts), key=lambda r: r.fun)
    t = np.sort(best.x)[::-1]
    return (1.0 + VOLUME * t) / (1.0 + VOLUME), stretch - 1.0 + VOLUME * (stretch - 1.0 / (t[0] * t[1]))


def neo_hookean_law(stretch: float, poisson: float = POISSON) -> tuple[Floats, float]:
    """The same of the neo-Hookean law: mu (s - 1/s) + lmbda ln J / s along each axis, 0 along the lateral ones."""
    mu, lmbda = lame(YOUNG, poisson)

    def stress(along: float, s: float, lateral: float) -> float:
        return mu * (along - 1 / along) + lmbda * np.log(s * lateral**2) / along

    lateral = brentq(lambda t: stress(t, stretch, t), 0.05, 2.0, xtol=1e-14)
    return np.full(2, lateral), stress(stretch, stretch, lateral)


def stretch_error(
    energies: Sequence[Term], law: Law, stretch: float, attempt: Attempt, *, at_rest: bool = False
) -> float:
    """The largest relative error of the tets' principal stretches, in the mean beyond the clamp; few from rest."""
    X, tets = box(FEW_CELLS if at_rest else PULLED_CELLS, (PULLED_LENGTH, 1.0, 1.0))
    lateral, stress = law(stretch)
    clamp = Fixed(vertices_at(X, 0, 0.0))
    pull = Traction(triangles_at(X, tets, 0, PULLED_LENGTH), stress * np.eye(3)[0])
    scene = Scene(X, tets, (*energies, clamp, pull))
    start = None if at_rest else X * [START * stretch, 1.0, 1.0]
    x = attempt.solve(attempt.prepare(scene), start=start).positions
    stretches = principal_stretches(X, x, tets[X[tets, 0].min(axis=1) >= CLAMPED]).mean(axis=0)
    return float(np.abs(stretches / [stretch, *lateral] - 1.0).max())


ENERGIES: dict[str, tuple[Sequence[Term], Law, tuple[str, ...]]] = {
    "Strain": ((Strain(1.0),), strain_law, EVERY_SOLVER),
    "Strain + 10 Volume": ((Strain(1.0), Volume(VOLUME)), strain_and_volume_law, EVERY_SOLVER),
    "NeoHookean nu=.45": (
        (Hyperelastic(NeoHookean.from_young(YOUNG, POISSON)),),
        neo_hookean_law,
        ("fenicsx", "skfem"),
    ),
}


def _pull(label: str, stretch: float) -> HardCase:
    energies, law, solvers = ENERGIES[label]
    bound = 2e-3 if law is strain_and_volume_law and stretch > FLAT else 1e-3
    return HardCase(
        f"bar stretched x{stretch:g}, {label}",
        "H5; closed form of the law",
        f"principal stretches within {100 * bound:g} % away from the clamp",
        partial(stretch_error, energies, law, stretch),
        bound,
        solvers,
    )


def _from_rest(stretch: float) -> HardCase:
    label = "NeoHookean nu=.45"
    energies, law, _ = ENERGIES[label]
    return HardCase(
        f"bar pulled from rest x{stretch:g}, {label}",
        "H5; closed form of the law",
        "principal stretches within .3 % away from the clamp",
        partial(stretch_error, energies, law, stretch, at_rest=True),
        3e-3,
        ("fenicsx",),
        ("P1", "P2", "P2P1"),
    )


PULLED = (
    *(_pull(label, stretch) for label in ENERGIES for stretch in STRETCHES),
    *(_from_rest(stretch) for stretch in STRETCHES),
)

TWISTED_LENGTH, TWISTED_CELLS = 4.0, (16, 4, 4)
TURN = 2.0 * np.pi
TWISTED_YOUNG, TWISTED_POISSON = 10.0, 0.49


def twisted_bar(energies: Sequence[Term]) -> Scene:
    """A bar of some energies, both ends held, the far one turned."""
    X, tets = box(TWISTED_CELLS, (TWISTED_LENGTH, 1.0, 1.0))
    ends = np.concatenate([vertices_at(X, 0, 0.0), vertices_at(X, 0, TWISTED_LENGTH)])
    return Scene(X, tets, (*energies, Fixed(ends, twist(X, TURN)[ends])))


def _solve_twist(attempt: Attempt) -> tuple[Scene, Solution]:
    mu, lmbda = lame(TWISTED_YOUNG, TWISTED_POISSON)
    scene = twisted_bar((Strain(2 * mu), Volume(3 * lmbda)))
    return scene, attempt.solve(attempt.prepare(scene), start=twist(scene.vertices, TURN))


def difference_to_newton(attempt: Attempt) -> float:
    """The largest distance from scikit-fem's minimiser of the same energy, relative to the largest displacement."""
    scene, solution = _solve_twist(attempt)
    other = solve(scene, solver="skfem", start=twist(scene.vertices, TURN), tolerance=1e-10).positions
    moved = np.linalg.norm(other - scene.vertices, axis=1).max()
    return float(np.linalg.norm(solution.positions - other, axis=1).max() / moved)


def volume_error(attempt: Attempt) -> float:
    """How much the twisted bar's volume changed, relative to it."""
    return change_of_volume(*_solve_twist(attempt))


def change_of_volume(scene: Scene, solution: Solution) -> float:
    """How much the whole volume changed, relative to it."""
    return abs(float(solution.volume_ratio @ scene.volumes / scene.volumes.sum()) - 1.0)


TWISTED = (
    HardCase(
        "bar twisted by 360° at nu = .49: shape",
        "H6; the same energy by Newton's method of scikit-fem",
        "positions within 0.1 % of the largest displacement",
        difference_to_newton,
        1e-3,
        ("projective", "fenicsx"),
    ),
    HardCase("bar twisted by 360° at nu = .49: volume", "H6", "volume within 2 %", volume_error, 0.02, EVERY_SOLVER),
)

CASES = (*PULLED, *TWISTED)
