"""Constants of the solver as values, with their reasons; `prepare(scene, solver="skfem", policy=...)` takes others."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NewtonPolicy:
    """Newton's method on an energy; see `newton`."""

    armijo: float = 1e-4  # of the predicted decrease, that a step has to reach
    halvings: int = 40  # of a step
    near: float = 0.1  # of the first gradient norm: below it rounding may hide that the energy falls
    # Shares of a vertex' stiffness on the diagonal of a semidefinite matrix, tried until it is definite.
    shifts: tuple[float, ...] = (0.0, 1e-10, 1e-7, 1e-4, 1e-1)


@dataclass(frozen=True)
class DescentPolicy:
    """The way down; see `descent`. Shares are of the first gradient norm unless another thing is named."""

    met: float = 1e-3  # ends the descent on a wide barrier
    smallest_part: float = 1 / 64  # of the motion of what is held, made at once
    relaxed: float = 1e-2  # between two parts of a motion the free vertices need to follow only roughly
    relaxing_iterations: int = 20


@dataclass(frozen=True)
class SkfemPolicy:
    """All constants of the solver."""

    newton: NewtonPolicy = NewtonPolicy()
    descent: DescentPolicy = DescentPolicy()
    max_iterations: int = 200


POLICY = SkfemPolicy()
"""The constants as they were measured."""
