"""The strategy "augmented Lagrangian": minimise the condensed energy, correct the pressure it starts from, and repeat.

Each minimisation is Newton's with line search and projection, so that large motions and crushed elements do no harm;
Newton's method on displacement and pressure at once follows as soon as its full steps work, and converges fast.
"""

from __future__ import annotations

import numpy as np

from ...lhm.mesh import Floats
from ..solution import Reason
from .condensed import Condensed, CondensedState
from .newton import AnyState, Newton, Work
from .run import Attempt, Run
from .saddle import saddle_of
from .shared import anywhere, norm

MAX_ITERATIONS = 300
ROUNDS = 40
FIRST_SHARE, SHARE = 1e-2, 5e-2  # of a round's first gradient norm, that ends it; the first round begins far away
NEAR = 0.1  # of the pressure's norm: with smaller corrections steps of displacement and pressure at once are tried
FALL = 0.5  # of the residual's norm or of the displacement that follows, which such a step has to reach
QUICK, HARDER = 2, 10.0  # where so few iterations leave more than FALL of the volumes, kappa grows
SMALLEST_FRACTION = 1 / 64  # of the motion of the held vertices, in one load step
LOAD_STEP_TOLERANCE = 1e-2


class MultiplierDescent:
    """A run on a mixed problem, for energies without follower loads.

    `linear_solver` is as in `saddle_of`; with `warm` the pressure begins where the condensed problem's last solve
    ended.
    """

    def __init__(self, run: Run, condensed: Condensed, *, warm: bool, linear_solver: str = "cg"):
        self._run, self._condensed, self._comm = run, condensed, condensed.comm
        self._nodes = run.numbering.nodes
        held = (run.held | condensed.problem.unsupported[:, None])[: self._nodes.owned]
        self._held = np.flatnonzero(held)
        self._assemblies = condensed.problem.assemblies
        self._saddle = saddle_of(linear_solver, condensed.matrix, self._held)
        self._newton = Newton(condensed, self._held, self._saddle, self._saddle.direct, self._report, Work())
        self._iterations, self._per_volume, self._first = 0, 0.0, 0.0
        self._limit = run.record.left(MAX_ITERATIONS)
        self._warm = warm

    def attempt(self) -> Attempt:
        """Lift what is held to its place, in as few load steps as keep the energy finite, and descend."""
        condensed = self._condensed
        condensed.begin(None if self._warm else np.zeros(condensed.matrix.pressures))
        try:
            state, reason = self._descend()
        finally:
            self._saddle.release()
        record = self._run.record
        record.add(
            self._iterations,
            linear_solves=self._saddle.factored,
            linear_iterations=self._saddle.iterations,
            assemblies=condensed.problem.assemblies - self._assemblies,
        )
        record.detail["load_share"] = int(reason is Reason.CONVERGED)
        return Attempt(reason, self._run.numbering, state.u, condensed.problem.pressures.spread(state.p), state.energy)

    def settle(self, u: Floats, p: Floats, share: float) -> tuple[Floats, Floats, Reason, int]:
        """See `balance.Descent`: what is held stays where it is."""
        self._condensed.begin(p)
        self._iterations = 0
        try:
            state = self._condensed.at(u, share)
            reason = Reason.NOT_FINITE
            if np.isfinite(state.energy):
                state, reason = self._rounds(state)
        finally:
            self._saddle.release()
        made, self._iterations = self._iterations, 0
        return state.u, np.array(state.p), reason, made

    def _report(self, state: AnyState, norm: float) -> bool:
        return self._run.tell(state.u, state.energy, norm)

    def _descend(self) -> tuple[CondensedState, Reason]:
        state = self._condensed.at(self._run.u)
        if not np.isfinite(state.energy):
            self._report(state, np.inf)
            return state, Reason.NOT_FINITE
        while True:
            lifted, fraction = self._lift(state)
            if lifted is None:
                return state, Reason.LINE_SEARCH
            if fraction == 1.0:
                return self._rounds(lifted)
            state, reason = self._round(lifted, lambda first: LOAD_STEP_TOLERANCE * max(first, self._first))
            if reason is not Reason.CONVERGED:
                return state, reason

    def _lift(self, state: CondensedState) -> tuple[CondensedState | None, float]:
        """Move what is held as far to its goal as keeps the energy finite; the state, and the share of the way."""
        begin, goal = (field[: self._nodes.owned] for field in (state.u, self._run.goal))
        jump = np.zeros_like(begin)
        jump.flat[self._held] = goal.flat[self._held] - begin.flat[self._held]
        if not anywhere(self._comm, jump):
            return state, 1.0
        spread, force = self._newton.extension(state, jump)
        fraction = 1.0
        while fraction >= SMALLEST_FRACTION:
            u = begin + fraction * spread
            if fraction == 1.0:
                u.flat[self._held] = goal.flat[self._held]
            lifted = self._condensed.at(self._nodes.spread(u))
            if np.isfinite(lifted.energy):
                self._first = max(self._first, fraction * force)
                return lifted, fraction
            fraction *= 0.5
        return None, 0.0

    def _round(self, state: CondensedState, threshold, *, near: bool = False) -> tuple[CondensedState, Reason]:
        """Minimise the condensed energy."""
        left = self._limit - self._iterations
        after, reason, made = self._newton.minimise(state, threshold=threshold, max_iterations=left, near=near)
        self._iterations += made
        assert isinstance(after, CondensedState)
        return after, reason

    def _rounds(self, state: CondensedState) -> tuple[CondensedState, Reason]:
        """Minimise and correct the pressure in turns, until forces and volumes are in balance."""
        condensed = self._condensed
        self._per_volume = condensed.problem.force_per_volume(state.hessian().getDiagonal().array_r)
        self._first = max(self._first, self._norm(self._newton.free_gradient(state)))
        last = self._run.threshold(self._first)
        before = np.inf
        for turn in range(ROUNDS):
            share = SHARE if turn else FIRST_SHARE
            begin = self._iterations

            def threshold(first: float, share: float = share) -> float:
                return max(share * first, last / 2)

            state, reason = self._round(state, threshold, near=turn > 0)
            if reason not in (Reason.CONVERGED, Reason.STAGNATED):
                return state, reason
            size = self._norm(state.p)
            change = self._norm(state.p - condensed.centre) / max(size, 1e-300)
            away = self._norm(condensed.stretched(state.p))
            if away > FALL * before and self._iterations <= begin + QUICK:
                condensed.harden(HARDER)
            before = away
            state = condensed.beside(state.u, state.p, state.share)
            if change <= NEAR or size == 0.0:
                state, end = self._finish(state, last)
                if end is not None:
                    return state, end
                condensed.centre = np.array(state.p)
            state = condensed.at(state.u, state.share)
        return state, Reason.LINE_SEARCH

    def _finish(self, state: CondensedState, last: float) -> tuple[CondensedState, Reason | None]:
        """Full steps of displacement and pressure while they contract; why to stop for good, if so."""
        condensed, m = self._condensed, self._condensed.matrix.displacements
        residual, norm = self._residual(state)
        converged = False  # only after a step: its factors say whether this is a minimum under the constraint
        while not converged and self._iterations < self._limit:
            state.hessian()
            step = self._saddle.correction(residual)
            if step is None:
                return state, None
            u = state.u + self._nodes.spread(step[:m].reshape(-1, 3))
            after = condensed.beside(u, state.p + step[m:], state.share)
            if not np.isfinite(after.energy):
                return state, None
            residual, norm_after = self._residual(after)
            converged = norm_after <= last
            if not (converged or norm_after <= FALL * norm):
                following = self._saddle.again(residual)
                if not self._norm(following[:m]) <= FALL * self._norm(step[:m]):
                    return state, None
            state, norm = after, norm_after
            self._iterations += 1
            if self._report(state, norm):
                return state, Reason.INTERRUPTED
        return state, Reason.CONVERGED if converged else None

    def _residual(self, state: CondensedState) -> tuple[Floats, float]:
        """Forces [mN] and volumes [mm³], a vector that is zero where held, and its norm as a force [mN]."""
        forces, volumes = self._newton.free_gradient(state), state.strain()
        size = np.hypot(self._norm(forces), self._per_volume * self._norm(volumes))
        return np.concatenate([forces, volumes]), float(size)

    def _norm(self, vector: Floats) -> float:
        return norm(self._comm, vector)
