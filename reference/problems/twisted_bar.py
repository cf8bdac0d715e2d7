"""H6: a bar turned through 360° at nu = .49, one end against the other; H9: layers whose stiffnesses differ much."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats
from ..materials import lame
from ..scene import Scene
from ..solution import Solution
from ..solve import solve
from ..terms import Fixed, Strain, Volume
from . import bars
from .hard_case import Attempt, HardCase
from .meshes import box, vertices_at

LENGTH, CELLS = 4.0, (16, 4, 4)
TURN = 2.0 * np.pi
YOUNG, POISSON = 10.0, 0.49


def twisted(X: Floats, turn: float = TURN) -> Floats:
    """Sections of the bar along x turned about its middle line, the last by `turn` [rad]."""
    angle = turn * X[:, 0] / LENGTH
    y, z = X[:, 1] - 0.5, X[:, 2] - 0.5
    across = np.cos(angle) * y - np.sin(angle) * z, np.sin(angle) * y + np.cos(angle) * z
    return np.column_stack([X[:, 0], 0.5 + across[0], 0.5 + across[1]])


def bar() -> Scene:
    """Strain and Volume, both ends held, the far one turned."""
    mu, lmbda = lame(YOUNG, POISSON)
    X, tets = box(CELLS, (LENGTH, 1.0, 1.0))
    ends = np.concatenate([vertices_at(X, 0, 0.0), vertices_at(X, 0, LENGTH)])
    return Scene(X, tets, (Strain(2 * mu), Volume(3 * lmbda), Fixed(ends, twisted(X)[ends])))


def _solved(attempt: Attempt) -> tuple[Scene, Solution]:
    scene = bar()
    return scene, attempt.solve(attempt.prepare(scene), start=twisted(scene.vertices))


def difference_to_newton(attempt: Attempt) -> float:
    """The largest distance from scikit-fem's minimiser of the same energy, relative to the largest displacement."""
    scene, solution = _solved(attempt)
    other = solve(scene, solver="skfem", start=twisted(scene.vertices), tolerance=1e-10).positions
    moved = np.linalg.norm(other - scene.vertices, axis=1).max()
    return float(np.linalg.norm(solution.positions - other, axis=1).max() / moved)


def volume_error(attempt: Attempt) -> float:
    """How much the bar's volume changed, relative to it."""
    scene, solution = _solved(attempt)
    return abs(float(solution.volume_ratio @ scene.volumes / scene.volumes.sum()) - 1.0)


def layers_error(ratio: float, attempt: Attempt) -> float:
    """The relative error of the elongation of two layers in series under a pull, in closed form."""
    scene = bars.layers(ratio)
    solution = attempt.solve(attempt.prepare(scene), tolerance=1e-11)
    expected = 0.1 * (0.5 + 0.5 / ratio)
    return abs(bars.tip(scene, solution) / expected - 1.0)


ALL = ("projective", "fenicsx", "skfem")
CASES = (
    HardCase(
        "bar twisted by 360° at nu = .49: shape",
        "H6; the same energy by Newton's method of scikit-fem",
        "positions within 0.1 % of the largest displacement",
        difference_to_newton,
        1e-3,
        ("projective", "fenicsx"),
    ),
    HardCase("bar twisted by 360° at nu = .49: volume", "H6", "volume within 2 %", volume_error, 0.02, ALL),
    *(
        HardCase(
            f"layers of stiffness 1:{ratio:g}",
            "H9; closed form: F/A (L1/w1 + L2/w2)",
            "elongation within 1e-6",
            partial(layers_error, ratio),
            1e-6,
            ALL,
        )
        for ratio in bars.RATIOS
    ),
)
