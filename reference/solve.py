"""prepare / solve: one entry to every solver; a solver's package is imported when it is asked for."""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import Protocol

from ..lhm.base.errors import SceneError
from ..lhm.base.mesh import Floats
from .added import SOLVERS, NotModelledError, added_solvers, all_solvers
from .scene import Scene
from .solution import OnIteration, Solution


class Prepared(Protocol):
    """A prepared scene: work on mesh and stiffnesses is done, `solve` may be called per frame."""

    scene: Scene

    def solve(
        self,
        scene: Scene | None = None,
        *,
        start: Floats | None = None,
        tolerance: float = 1e-6,
        absolute: float | None = None,
        max_iterations: int | None = None,
        on_iteration: OnIteration | None = None,
    ) -> Solution:
        """Solve the prepared scene, or one that differs only in what terms say is `varying`.

        start [mm], shape (n, 3), default rest. tolerance is the gradient norm relative to its start, `absolute` [mN]
        one that is not: what asks the same wherever a solve starts. Raises SceneError if `scene` needs a new
        preparation, or any of these is out of range.
        """
        ...


def prepare(scene: Scene, *, solver: str = "projective", **options) -> Prepared:
    """Do what depends only on mesh and stiffnesses: factorisation, forms, compilation.

    Options of the solvers: projective `method`; fenicsx `element`,
    `linear_solver`; skfem `element`; each also `policy`, its constants. Raises SceneError for an unknown solver or
    option, or a term that the solver cannot model, and MissingDependencyError if the solver's packages are not
    installed.
    """
    if solver not in all_solvers():
        raise SceneError(f"unknown solver {solver!r}; there are {', '.join(all_solvers())}")
    if not isinstance(scene, Scene):
        raise SceneError(f"expected a Scene, got {type(scene).__name__}")
    shipped = solver in SOLVERS
    prepare_it = import_module(f".{solver}", __package__).prepare if shipped else added_solvers()[solver]
    known = tuple(inspect.signature(prepare_it).parameters)[1:]
    for option in options:
        if option not in known:
            raise SceneError(f"solver {solver!r} has no option {option!r}; it has {', '.join(known) or 'none'}")
    try:
        return prepare_it(scene, **options)
    except SceneError as refused:
        if shipped:
            raise
        raise NotModelledError(str(refused)) from None


def solve(
    scene: Scene,
    *,
    solver: str = "projective",
    start: Floats | None = None,
    tolerance: float = 1e-6,
    absolute: float | None = None,
    max_iterations: int | None = None,
    on_iteration: OnIteration | None = None,
    **options,
) -> Solution:
    """Prepare and solve once; see `prepare` and `Prepared.solve` for arguments and errors."""
    return prepare(scene, solver=solver, **options).solve(
        start=start, tolerance=tolerance, absolute=absolute, max_iterations=max_iterations, on_iteration=on_iteration
    )
