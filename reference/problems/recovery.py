"""H1, H2, H3, H7: a block that was scattered, flattened, turned inside out or crushed must come back to rest.

Projective dynamics' block is free, of 10³ cells, E = 1e4 and nu = .45. Newton's, of the corotated law and 4³ cells,
stands on its base: of the laws here it alone is known to lead back from anywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ...lhm.base.geometry.warp import rigid_motion
from ...lhm.base.mesh import Floats
from ..materials import Corotated, lame
from ..materials.material import Isotropic
from ..scene import Scene
from ..solution import Solution
from ..terms import Fixed, Hyperelastic, Strain, Volume
from .meshes import block, vertices_at
from .problem import Attempt, HardCase

YOUNG, POISSON = 1e4, 0.45
SEEDS = 20
CRUSHED = (0.5, 0.9, 0.99)
CRITERION = "at rest again within 1e-6 of its size, after a rigid fit, J of every tet at least 0.9999"

Start = Callable[[Floats], Floats]
Block = Callable[[], Scene]


def free_block() -> Scene:
    """Strain and Volume; nothing holds it."""
    mu, lmbda = lame(YOUNG, POISSON)
    X, tets = block(10)
    return Scene(X, tets, (Strain(2 * mu), Volume(3 * lmbda)))


def standing_block(law: Isotropic, cells: int = 4) -> Scene:
    """A block of a law on a held base."""
    X, tets = block(cells)
    return Scene(X, tets, (Hyperelastic(law), Fixed(vertices_at(X, 2, 0.0))))


def away_from_rest(scene: Scene, solution: Solution) -> float:
    """The largest distance [mm] from the rest shape after the best rigid motion; infinite if a tet is not at rest."""
    rotation, translation = rigid_motion(scene.vertices, solution.positions)
    distances = np.linalg.norm(scene.vertices @ rotation.T + translation - solution.positions, axis=1)
    return float(distances.max()) if solution.volume_ratio.min() >= 0.9999 else np.inf


def scattered_start(seed: int) -> Start:
    """Vertices anywhere in [-1, 1]³."""
    return lambda X: np.random.default_rng(seed).uniform(-1.0, 1.0, X.shape)


def scaled_start(x: float, y: float, z: float) -> Start:
    """Positions times a factor per axis."""
    return lambda X: X * [x, y, z]


def pull_through(X: Floats) -> Floats:
    """The corner at (1, 1, 1) pulled along the diagonal, through the faces opposite of its tets."""
    start = X.copy()
    start[np.argmax(X.sum(axis=1))] -= 0.6
    return start


def start_error(pose: Block, start: Start, attempt: Attempt) -> float:
    """Error of a block let go from a start."""
    scene = pose()
    return away_from_rest(scene, attempt.solve(attempt.prepare(scene), start=start(scene.vertices)))


def crush_error(pose: Block, share: float, attempt: Attempt) -> float:
    """Error of a block whose top and base were pressed together by a share of its height, then let go."""
    scene = pose()
    X = scene.vertices
    plates = np.concatenate([vertices_at(X, 2, height) for height in (0.0, 1.0)])
    energies = tuple(term for term in scene.terms if not isinstance(term, Fixed))
    press = Fixed(plates, X[plates] * [1.0, 1.0, 1.0 - share])
    held = Scene(X, scene.tets, (*energies, press))
    crushed = attempt.solve(attempt.prepare(held), start=X * [1.0, 1.0, 1.0 - share], tolerance=1e-6)
    return away_from_rest(scene, attempt.solve(attempt.prepare(scene), start=crushed.positions))


STARTS: dict[str, tuple[str, Start]] = {
    "flattened to a plane": ("H2", scaled_start(1, 1, 0)),
    "flattened to a line": ("H2", scaled_start(1, 0, 0)),
    "flattened to a point": ("H2", scaled_start(0, 0, 0)),
    "mirrored": ("H3", scaled_start(1, 1, -1)),
    "a vertex pulled through its face": ("H3", pull_through),
    **{f"random start, seed {seed}": ("H1", scattered_start(seed)) for seed in range(SEEDS)},
}
BLOCKS: dict[str, tuple[Block, tuple[str, ...]]] = {
    "Strain + Volume": (free_block, ("projective",)),
    "Corotated": (partial(standing_block, Corotated.from_young(YOUNG, POISSON)), ("fenicsx", "skfem")),
}


def _cases() -> list[HardCase]:
    cases = []
    for label, (pose, solvers) in BLOCKS.items():
        for name, (source, start) in STARTS.items():
            cases.append(
                HardCase(f"{name}, {label}", source, CRITERION, partial(start_error, pose, start), 1e-6, solvers)
            )
        for share in CRUSHED:
            name = f"crushed by {100 * share:g} % and released, {label}"
            cases.append(HardCase(name, "H7", CRITERION, partial(crush_error, pose, share), 1e-6, solvers))
    return cases


CASES = tuple(_cases())
