"""Constants of the solver as values: one frozen dataclass per strategy and per linear solver, with their reasons.

`prepare(scene, solver="fenicsx", policy=FenicsxPolicy(...))` takes others:

    patient = replace(POLICY, newton=replace(POLICY.newton, longest_step=1.0))
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NewtonPolicy:
    """Newton's method on an energy; see `newton`."""

    smallest_fraction: float = 1 / 64  # of the motion of what is held, in one load step
    exact_below: float = 0.03  # of the first gradient norm: the exact tangent is tried
    sufficient_decrease: float = 1e-4  # of the predicted decrease: Armijo's share
    straight: float = 0.75  # of the predicted decrease (a parabola's is 1/2): beyond it a longer step pays
    longest_step: float = 64.0  # of a full step
    smallest_step: float = 2.0**-30  # of a full step
    loose: float = 1e-2  # least relative residual while steps converge linearly: more digits are wasted
    curvature_share: float = 0.25  # of the negative curvature, that an indefinite Hessian gives up
    successes: int = 2  # iterations with a share of the negative curvature, after which more is tried
    dampings: tuple[float, ...] = (1e-3, 1e-2, 1e-1)  # of the largest diagonal entry, where no direction descends
    mode_iterations: int = 5  # inverse iterations that find the softest motion
    shifts: tuple[float, ...] = (0.0, 1e-10, 1e-6)  # of the largest diagonal entry, where nothing holds a part
    patience: int = 3  # iterations whose gain may be rounding, while the gradient norm falls no more


@dataclass(frozen=True)
class MinimisePolicy:
    """The strategy "minimise"; see `minimise`."""

    max_iterations: int = 100
    load_step_tolerance: float = 1e-2  # of a load step's first gradient norm: only the last step needs more
    drift: float = 1e-9  # of the tangent's largest entry: holds a body that is free to move
    aside: float = 1e-3  # of the largest displacement, to leave an unstable equilibrium by
    rounding: float = 1e-14  # of the largest coordinate: closer to its goal, what is held has arrived


@dataclass(frozen=True)
class LoadStepsPolicy:
    """The strategy "load steps"; see `load_steps`. Shares are of the whole load."""

    max_iterations: int = 1000
    step_iterations: int = 25  # of Newton's method at one share
    smallest_damping: float = 1 / 32  # of a correction
    first_share: float = 1 / 4
    smallest_share: float = 1 / 1024
    drift: float = 1e-9  # of the tangent's largest entry: holds a body that is free to move


@dataclass(frozen=True)
class MultiplierPolicy:
    """The strategy "augmented Lagrangian"; see `multipliers`."""

    max_iterations: int = 300
    rounds: int = 40  # minimisations, each with a corrected pressure
    first_round: float = 1e-2  # of a round's first gradient norm, that ends the first one: it begins far away
    later_rounds: float = 5e-2  # the same for all others
    near: float = 0.1  # of the pressure's norm: after smaller corrections displacement and pressure step at once
    fall: float = 0.5  # of the residual's norm or of the displacement that follows, which such a step has to reach
    quick: int = 2  # iterations: where so few leave more than `fall` of the volumes, kappa grows
    harder: float = 10.0  # times kappa
    settled: float = 1e-10  # of the pressure's norm, below which a correction is rounding or of no account
    corrections: int = 30  # of the pressure at one displacement


@dataclass(frozen=True)
class SaddlePolicy:
    """Linear solvers of the saddle point; see `saddle` and `saddle_block`."""

    # kappa by the shear modulus: p₀'s error falls to a tenth or less per minimisation, in two or three steps each.
    penalty: float = 30.0
    # Unknowns, from which on "cg" is GMRES. Factors, which count the inertia, win below: a block takes .13 s by them
    # and .18 by GMRES at 1,093 unknowns, .52 and .43 at 4,209, 3.8 and 3.3 at 15,468. At 76,000 they take twice the
    # memory.
    large: int = 4_000
    restart: int = 200  # vectors that GMRES keeps
    max_iterations: int = 400  # of GMRES, and of CG on the pressure
    patience: float = 2  # times as slow as the hardest projected system so far: GMRES counts a system as indefinite
    volume_weight: float = 10.0  # of volumes among the residuals: the springs multiply what is left of them
    step: float = 1e-4  # relative residual of a step of displacement and pressure at once
    following: float = 1e-1  # relative residual of the step that follows it


@dataclass(frozen=True)
class LinearPolicy:
    """Conjugate gradients and factors; see `linear.solvers`."""

    max_iterations: int = 1000  # of CG
    setup: int = 16  # iterations that a set-up of multigrid costs
    asymmetry: float = 1e-9  # of a matrix' norm, below which it counts as symmetric
    room: int = 60  # percent of memory beyond MUMPS' estimate: saddle points delay pivots


@dataclass(frozen=True)
class FenicsxPolicy:
    """All constants of the solver, and which strategies and linear solvers a scene gets; see `prepared`."""

    newton: NewtonPolicy = NewtonPolicy()
    minimise: MinimisePolicy = MinimisePolicy()
    load_steps: LoadStepsPolicy = LoadStepsPolicy()
    multipliers: MultiplierPolicy = MultiplierPolicy()
    saddle: SaddlePolicy = SaddlePolicy()
    linear: LinearPolicy = LinearPolicy()
    start_bulk: float = 10.0  # lmbda by mu of a large scene's start: volumes nearly keep, linear tets do not lock yet
    # (2 mu + lmbda) / mu of a law, Poisson's ratio .49987, from which on CG's answer to a share of the forces is far
    # off. By P2 on a block of 2,187 unknowns, stretched by a fifth, MUMPS takes 9 iterations and .5 CPU s at .4999, CG
    # 11 and 3.1 s; at .49999 MUMPS 23 and 1.6 s, where CG creeps. At .49 on 10,125 unknowns both take 1.5 s.
    stiff: float = 4000.0
    # Unknowns, from which on stiff laws take multigrid in spite of it, and no factors tell whether an equilibrium under
    # traction is stable: they take too much memory.
    large_stiff: int = 400_000
    large: int = 10_000  # tets, from which on Newton's steps with a pressure are dear enough to descend at once


POLICY = FenicsxPolicy()
"""The constants as they were measured."""
