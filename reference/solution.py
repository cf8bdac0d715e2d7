"""A solver's answer: positions, why it stopped, how it got there, stresses when asked, and a file of them."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from pathlib import Path

import numpy as np

from ..lhm.base.checks import finite
from ..lhm.base.errors import InputError, SceneError
from ..lhm.base.files.atomic import replaced
from ..lhm.base.mesh import Floats, Ints, tet_volumes
from .clock import Clock, Seconds
from .scene import Scene
from .terms import Hyperelastic

SUFFIXES = (".vtu", ".vtk")


class Reason(str, Enum):
    """Why a solver stopped; each value says what to change."""

    CONVERGED = "converged: the gradient norm fell to what was asked"
    MAX_ITERATIONS = "iteration limit: raise max_iterations, loosen tolerance, or start nearer to the answer"
    ROUNDING = "rounding: the gradient norm is above what was asked, but rounding lets it fall no further"
    STAGNATED = "stagnated: no step lowers the energy further; the tolerance is below what rounding allows"
    LINE_SEARCH = "line search failed: apply the load or the motion in smaller steps"
    LINEAR_SOLVER = "the linear solver failed: use a direct one, or look for a part that nothing holds"
    NOT_FINITE = "the energy is not finite at the start: start without inverted tets, and without pairs at distance 0"
    INVERTED = (
        "cells of a hyperelastic law are inside out: no answer; load in steps, each from the last, or refine there"
    )
    CONTACT = (
        "surfaces cross, or pass through each other as what is held moves: hold them apart, or move in smaller steps"
    )
    INTERRUPTED = "interrupted by the caller"

    def __str__(self) -> str:
        return self.value

    def at_rounding(self, scene: Scene, norm: float) -> Reason:
        """Return ROUNDING for a solve that found no step at a gradient norm [mN] of rounding's size, else the same."""
        found_none = self in (Reason.STAGNATED, Reason.LINE_SEARCH)
        return Reason.ROUNDING if found_none and norm <= scene.rounding() else self

    def if_inverted(self, scene: Scene, inverted: np.ndarray) -> Reason:
        """Return INVERTED for a balance of forces in which cells (m,) of a hyperelastic law are, else the same."""
        balanced = self in (Reason.CONVERGED, Reason.ROUNDING)
        if balanced and any(inverted[scene.tets_of(term)].any() for term in scene.of(Hyperelastic)):
            return Reason.INVERTED
        return self


@dataclass(frozen=True, eq=False)
class History:
    """Per iteration, the start first: time [s], energy [µJ], gradient norm [mN].

    Time is all that has gone into the answer since `solve` was called: other attempts and first guesses too, each once,
    but neither callbacks nor compilation.
    """

    time: Floats
    energy: Floats
    gradient_norm: Floats


@dataclass(frozen=True)
class Times:
    """Seconds of preparation, which later solves share, and of this solve; compilation in both beside them."""

    preparation: float
    solve: float
    compilation: float


@dataclass(frozen=True, eq=False)
class Stresses:
    """Stresses [kPa] of the tets, shape (m, 3, 3), reactions and contact forces [mN], (n, 3); see `Solution`."""

    first_piola: Floats
    cauchy: Floats
    reactions: Floats
    contact_forces: Floats

    @classmethod
    def from_points(cls, P: Floats, F: Floats, volume: Floats, reactions: Floats, contact_forces: Floats) -> Stresses:
        """Average P [kPa] and F over each tet's q points, shape (m, q, 3, 3), of volumes [mm³], shape (m, q).

        P over the volume at rest, Cauchy's stress P Fᵀ / J over the deformed one.
        """
        deformed = np.einsum("mq,mq->m", volume, np.linalg.det(F))
        with np.errstate(divide="ignore", invalid="ignore"):
            cauchy = np.einsum("mq,mqij,mqkj->mik", volume, P, F) / deformed[:, None, None]
        mean = np.einsum("mq,mqij->mij", volume, P) / volume.sum(axis=1)[:, None, None]
        return cls(mean, cauchy, reactions, contact_forces)


def von_mises(cauchy: Floats) -> Floats:
    """√(3/2) ‖dev σ‖ [kPa], shape (m,), of stresses (m, 3, 3)."""
    mean = np.trace(cauchy, axis1=1, axis2=2)[:, None, None] / 3.0
    return np.sqrt(1.5) * np.linalg.norm(cauchy - mean * np.eye(3), axis=(1, 2))


@dataclass(frozen=True, eq=False)
class Solution:
    """A solver's answer.

    positions [mm], shape (n, 3); `converged` is whether `reason` is CONVERGED or ROUNDING; `iterations` made, by all
    attempts; energy [µJ], with the potential of dead loads; volume_ratio is J = det F per tet, shape (m,), where the
    tets of a prism have its F; least_ratio (m,) is the least J inside quadratic tets, None for linear ones; `detail`
    holds counts that only one solver has, such as linear iterations; `times` is None unless a solver made it. Stresses
    [kPa], one per tet, and reactions [mN] are worked out by the same solver when they are first asked for, from its own
    nodes and integration points.
    """

    positions: Floats
    reason: Reason
    iterations: int
    energy: float
    history: History
    volume_ratio: Floats
    detail: dict[str, float] = field(default_factory=dict)
    recovery: Callable[[], Stresses] | None = field(default=None, repr=False)
    times: Times | None = None
    least_ratio: Floats | None = None

    @property
    def inverted(self) -> np.ndarray:
        """Mask of tets that are inside out somewhere, shape (m,)."""
        return (self.volume_ratio if self.least_ratio is None else self.least_ratio) <= 0.0

    @property
    def converged(self) -> bool:
        """Whether the gradient fell to what was asked, or as far as rounding lets it; `reason` tells which."""
        return self.reason in (Reason.CONVERGED, Reason.ROUNDING)

    @property
    def is_balanced(self) -> bool:
        """Whether forces balance, be it in cells that are inside out."""
        return self.converged or self.reason is Reason.INVERTED

    @property
    def first_piola(self) -> Floats:
        """P, force per area at rest [kPa], shape (m, 3, 3): the mean over each tet of all its solids' terms."""
        return self._recovered.first_piola

    @property
    def cauchy(self) -> Floats:
        """σ = P Fᵀ / J, force per present area [kPa], shape (m, 3, 3): the mean over each deformed tet."""
        return self._recovered.cauchy

    @property
    def von_mises(self) -> Floats:
        """Von Mises' equivalent of `cauchy` [kPa], shape (m,)."""
        return von_mises(self.cauchy)

    @property
    def reactions(self) -> Floats:
        """Forces [mN], shape (n, 3), by which Fixed terms hold their components in place; zero elsewhere.

        With all loads, springs' pulls and contact forces they add up to nothing. Nodes on edges give half to each end.
        """
        return self._recovered.reactions

    @property
    def contact_forces(self) -> Floats:
        """Forces [mN], shape (n, 3), by which Contact and Gaps push vertices; zero elsewhere.

        What pushes an obstacle pushes its carriers; those of one that stands still push nothing of the scene.
        """
        return self._recovered.contact_forces

    @cached_property
    def _recovered(self) -> Stresses:
        if self.recovery is None:
            raise SceneError("stress: this solution was not made by a solver")
        return self.recovery()


OnIteration = Callable[[int, Floats, float, float], "bool | None"]
"""Called with iteration, positions, energy and gradient norm; returning True stops the solve."""


class Recorder:
    """Collects the history of one solve; time spent in the callback or on compilation does not count."""

    def __init__(self, on_iteration: OnIteration | None = None):
        self._callback = on_iteration
        self._clock = Clock()
        self._rows: list[tuple[float, float, float]] = []

    @property
    def has_listener(self) -> bool:
        """Whether a callback asks for positions."""
        return self._callback is not None

    def record(self, positions: Floats, energy: float, gradient_norm: float) -> bool:
        """Add an iteration; return whether the callback asks to stop."""
        self._rows.append((self._clock.read().work, energy, gradient_norm))
        if self._callback is None:
            return False
        away = Clock()
        stop = bool(self._callback(len(self._rows) - 1, positions, energy, gradient_norm))
        self._clock.pause(away.read().work)
        return stop

    def history(self) -> History:
        """Return the record so far."""
        rows = np.array(self._rows, dtype=np.float64).reshape(-1, 3)
        return History(rows[:, 0], rows[:, 1], rows[:, 2])

    def times(self, preparation: Seconds) -> Times:
        """Return the times of the solve so far, and of its preparation."""
        solve = self._clock.read()
        return Times(preparation.work, solve.work, preparation.compilation + solve.compilation)


def volume_ratio(scene: Scene, positions: Floats) -> Floats:
    """Return J = det F per tet, shape (m,); the tets of a prism have its F."""
    if not len(scene.prisms):
        return tet_volumes(positions, scene.tets) / scene.volumes
    ratios, alone = np.empty(len(scene.tets)), np.ones(len(scene.tets), dtype=bool)
    alone[scene.prisms] = False
    ratios[alone] = tet_volumes(positions, scene.tets[alone]) / scene.volumes[alone]
    ratios[scene.prisms] = scene.prism_cells.volume_ratio(positions)[:, None]
    return ratios


def least_quadratic_ratio(scene: Scene, positions: Floats, ends: Ints, nodes: Floats) -> Floats:
    """Return the least J of quadratic tets, shape (m,), at their corners, middles of edges and centre.

    nodes (k, 3) [mm] lie between two vertices, `ends` (k, 2), each; positions (n, 3) [mm] are the vertices'.
    """
    n, pairs = len(positions), [(i, j) for i in range(4) for j in range(i)]
    keys = ends.min(axis=1) * n + ends.max(axis=1)
    order = np.argsort(keys)
    middle = np.empty((len(scene.tets), 4, 4, 3))
    for i, j in pairs:
        low, high = np.sort(scene.tets[:, [i, j]], axis=1).T
        middle[:, i, j] = middle[:, j, i] = nodes[order[np.searchsorted(keys[order], low * n + high)]]
    corner, eye = positions[scene.tets], np.eye(4)
    places = [*eye, *(0.5 * (eye[i] + eye[j]) for i, j in pairs), np.full(4, 0.25)]
    least = np.full(len(scene.tets), np.inf)
    for shares in places:  # derivatives of x by the shares λ, with shape functions λi (2 λi - 1) and 4 λi λj
        slopes = (4.0 * shares - 1.0)[:, None] * corner
        for i, j in pairs:
            slopes[:, i] += 4.0 * shares[j] * middle[:, i, j]
            slopes[:, j] += 4.0 * shares[i] * middle[:, i, j]
        volumes = np.linalg.det(slopes[:, 1:] - slopes[:, :1]) / 6.0
        least = np.minimum(least, volumes / scene.volumes)
    return least


@dataclass(frozen=True)
class Limits:
    """When a solve ends: at a gradient norm of `tolerance` times its start's or, if given, of `absolute` [mN].

    Or after so many iterations, None for what a solver takes as its own. Raises SceneError for what is out of range.
    """

    tolerance: float = 1e-6
    absolute: float | None = None
    iterations: int | None = None

    def __post_init__(self):
        if not 0.0 < self.tolerance < 1.0:
            raise SceneError(f"tolerance must lie between 0 and 1, got {self.tolerance}")
        if self.absolute is not None and not (np.isfinite(self.absolute) and self.absolute > 0.0):
            raise SceneError(f"absolute: expected a gradient norm above 0 mN, got {self.absolute}")
        if self.iterations is not None and not self.iterations >= 0:
            raise SceneError(f"max_iterations must be at least 0, got {self.iterations}")

    def threshold(self, scene: Scene, first: float) -> float:
        """Return the gradient norm [mN] at which to stop, from the first one; a start at rest is its own answer."""
        asked = self.tolerance * first if self.absolute is None else self.absolute
        return max(asked, first) if scene.is_rest(first) else asked


def first_positions(scene: Scene, start: Floats | None) -> Floats:
    """Return where a solve begins [mm], shape (n, 3): a start, or rest; SceneError for another shape."""
    shape = scene.vertices.shape
    return np.array(scene.vertices if start is None else finite("start", start, shape, error=SceneError))


def write_solution(path: str | os.PathLike[str], scene: Scene, solution: Solution) -> None:
    """Write a .vtu or .vtk file [mm, kPa, mN] of the scene at rest with its solution, whole or not at all.

    Per vertex `displacement`, `reaction` and `contact_force`, per tet `J`, `inverted` (0 or 1), `von_mises`, `cauchy`
    and `first_piola` (nine components, row by row); NaN for what is not finite, as Cauchy's stress of a flat tet.
    Raises InputError for another suffix, a solution of another scene, and a place that cannot be written.
    """
    import meshio

    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: unknown kind of file; expected one of {', '.join(SUFFIXES)}")
    if solution.positions.shape != scene.vertices.shape or len(solution.volume_ratio) != len(scene.tets):
        raise InputError(
            f"solution: of {len(solution.positions)} vertices and {len(solution.volume_ratio)} tets, the scene has "
            f"{len(scene.vertices)} and {len(scene.tets)}"
        )
    tensors = {"cauchy": solution.cauchy, "first_piola": solution.first_piola}
    quantities = {"J": solution.volume_ratio, "inverted": 1.0 * solution.inverted, "von_mises": solution.von_mises}
    quantities |= {name: tensor.reshape(-1, 9) for name, tensor in tensors.items()}
    mesh = meshio.Mesh(
        scene.vertices,
        [("tetra", scene.tets)],
        point_data={
            "displacement": solution.positions - scene.vertices,
            "reaction": solution.reactions,
            "contact_force": solution.contact_forces,
        },
        cell_data={name: [np.where(np.isfinite(values), values, np.nan)] for name, values in quantities.items()},
    )
    with replaced(path) as temporary, redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        mesh.write(temporary, file_format=path.suffix.lower()[1:])
