"""Newton's method with a line search on the energy, and the direct solver of its steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix, identity
from scipy.sparse.linalg import splu

from ...lhm.base.geometry import cholesky
from ...lhm.base.mesh import Floats
from ..solution import Reason
from .energy import Energy
from .policy import POLICY, NewtonPolicy
from .unknowns import Unknowns

OnStep = Callable[[Floats, float, float], bool]
"""Called with positions, energy and gradient norm, the start first; returning True stops the iteration."""


@dataclass(frozen=True, eq=False)
class Scales:
    """A scene's scales: a length [mm] that no step exceeds, a vertex' stiffness [mN/mm], a gradient's rounding [mN]."""

    length: float
    stiffness: float
    rounding: float


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Positions with their energy [µJ], and its gradient [mN] by degree of freedom and by unknown."""

    x: Floats
    value: float
    forces: Floats
    gradient: Floats


def minimise(
    energy: Energy,
    x: Floats,
    unknowns: Unknowns,
    *,
    scales: Scales,
    threshold: Callable[[float], float],
    max_iterations: int,
    on_step: OnStep,
    policy: NewtonPolicy = POLICY.newton,
) -> tuple[Floats, Reason, int]:
    """Minimise over the unknowns from x, where the energy must be finite and bodies have their shapes.

    Returns positions, why it stopped and the iterations made. `threshold` gives the gradient norm [mN] to stop at
    from the one at the start.
    """
    state = _state(energy, unknowns, x, energy.value(x))
    first = float(np.linalg.norm(state.gradient))
    goal = threshold(first)
    iteration = 0
    while True:
        norm = float(np.linalg.norm(state.gradient))
        stop = on_step(state.x, state.value, norm)
        if stop:
            return state.x, Reason.INTERRUPTED, iteration
        if norm <= goal:
            return state.x, Reason.CONVERGED, iteration
        if iteration == max_iterations:
            return state.x, Reason.MAX_ITERATIONS, iteration
        near = norm < policy.near * first or norm <= scales.rounding
        after = _step(energy, state, unknowns, scales, policy, near=near)
        if isinstance(after, Reason):
            return state.x, Reason.STAGNATED if near and after is Reason.LINE_SEARCH else after, iteration
        state = after
        iteration += 1


def _step(
    energy: Energy, state: Evaluation, unknowns: Unknowns, scales: Scales, policy: NewtonPolicy, *, near: bool
) -> Evaluation | Reason:
    """A step by the exact Hessian where it is positive definite, else by the projected one, halved until Armijo's rule.

    Near the answer energy differences drown in rounding: there a full step that halves the gradient is taken as it is.
    """
    matrix = unknowns.hessian(state.x, state.forces, energy.exact_hessian(state.x))
    step = solve_definite(matrix, -state.gradient)
    if step is None:
        matrix = unknowns.projected_hessian(state.x, state.forces, energy.projected_hessian(state.x))
        step = solve_semidefinite(matrix, -state.gradient, scale=scales.stiffness, shifts=policy.shifts)
    if step is None:
        return Reason.LINEAR_SOLVER
    if near:
        x = unknowns.move(state.x, step)
        value = energy.value_ahead(state.x, x)
        full = _state(energy, unknowns, x, value) if np.isfinite(value) else None
        if full is not None and np.linalg.norm(full.gradient) <= 0.5 * np.linalg.norm(state.gradient):
            return full
    slope = float(state.gradient @ step)
    length = min(1.0, scales.length / float(np.abs(step).max()))
    for _ in range(policy.halvings):
        x = unknowns.move(state.x, length * step)
        value = energy.value_ahead(state.x, x)
        if value < state.value and value <= state.value + policy.armijo * length * slope:
            return _state(energy, unknowns, x, value)
        length /= 2
    return Reason.LINE_SEARCH


def _state(energy: Energy, unknowns: Unknowns, x: Floats, value: float) -> Evaluation:
    forces = energy.gradient(x)
    return Evaluation(x, value, forces, unknowns.gradient(x, forces))


def solve_definite(matrix: csc_matrix, right: Floats) -> Floats | None:
    """The solution, shape (size,), or None if the matrix is not positive definite to working precision.

    By CHOLMOD where the system has it, else by SuperLU: without pivoting, LU of a symmetric matrix is LDLᵀ, and the
    signs of D count the negative eigenvalues (Sylvester).
    """
    solve = _cholmod(matrix) if cholesky.has_cholmod() else _superlu(matrix)
    if solve is None:
        return None
    solution = solve(right)
    solution += solve(right - matrix @ solution)
    return solution if np.isfinite(solution).all() else None


def _cholmod(matrix: csc_matrix) -> Callable[[Floats], Floats] | None:
    try:
        factor = cholesky.CholmodFactor(matrix)
    except np.linalg.LinAlgError:
        return None
    return lambda right: factor(right[:, None])[:, 0]


def _superlu(matrix: csc_matrix) -> Callable[[Floats], Floats] | None:
    options = {"SymmetricMode": True, "Equil": False}
    try:
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError:
        return None
    if not np.array_equal(factors.perm_r, factors.perm_c) or factors.U.diagonal().min() <= 0:
        return None
    return factors.solve


def solve_semidefinite(
    matrix: csc_matrix, right: Floats, *, scale: float, shifts: tuple[float, ...] = POLICY.newton.shifts
) -> Floats | None:
    """For a semidefinite matrix: the first of `shifts` of `scale` that makes it definite is added to the diagonal.

    None as above.
    """
    for shift in shifts:
        solution = solve_definite(matrix + shift * scale * identity(matrix.shape[0], format="csc"), right)
        if solution is not None:
            return solution
    return None
