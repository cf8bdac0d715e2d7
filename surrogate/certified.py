"""One dial: frames of a face by the cheapest method whose own error is within an accuracy, and that error, always told.

    face = certify(Face(head, expressions, Parameters(gravity=2.0)))
    frame = face.frame(weights, accuracy=0.05)
    frame.skin, frame.error, frame.certain, frame.method

The error is to the converged simulator: the mean distance [mm] over the skin vertices that the ruler counts, those that
physics moves by more than 0.05 mm beyond blendshapes and bones (`ruler`); over all of them where it moves none so far.
It is estimated from forces: a frame's tets are placed, and Newton's step says how far their forces would move them (see
`reference.face.correction`). No frame of a corpus is needed, so heads, rigs and parameters that no network has seen are
told as well.

Where a face has contact and a frame's surfaces touch, the simulator parts them, from the frame before, as far as the
accuracy asks. Its error is that of Newton's step with the pushes as they are, raised. Whether surfaces touch is asked
where the frame's tets begin, and where they end.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..lhm.base.checks import finite, number
from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..reference.face.correction import Correction, predict
from ..reference.face.derivatives import spring_norm
from ..reference.face.face import Face
from ..reference.projective.hessian.newton_step import NewtonStep
from .rigs.bound import BoundSurrogate
from .rigs.rig import check_weights
from .ruler import MOVES

ACCURACY = 0.05
"""[mm] of a frame by default: the scale of the head mesh's own discretisation error."""
FINEST, COARSEST = 1e-6, 100.0
"""[mm] Accuracy below which rounding is asked for, and beyond which nothing is."""


@dataclass(frozen=True)
class DialPolicy:
    """When the dial smooths, aims and gives up; counts are of solves."""

    settling: int = 8  # iterations of L-BFGS before an error is first told where tets fold: Newton's step has no end
    most_smoothing: int = 32  # iterations of L-BFGS between two errors; each costs a tenth of telling one
    further: float = 0.1  # share of its error at which a round aims where no accuracy is asked for
    farthest: float = 0.02  # the least such share
    direct: float = 0.2  # an accuracy below this share of the rough error is sought by L-BFGS at once
    margin: float = 0.5  # of an accuracy that a round aims at: the error falls about as the residual does
    apart: float = 1.0  # [mm] mean distance of a frame from its first order; other faces' are farther
    begun: float = 1e-3  # gradient norm, likewise, at which the error of a frame with contact is first told
    converged: float = 1e-6  # gradient norm over that of the targets' springs, each 1 mm long
    most_solves: int = 2000  # of a frame: lids that are pressed into each other find no rest
    doubt: float = 3.0  # what is not certain is off by at most this factor, but for some in a hundred


POLICY = DialPolicy()


@dataclass(frozen=True, eq=False)
class Reached:
    """The tets' vertices [mm], shape (k, 3), as a frame of weights (52,) leaves them: the next begins there."""

    weights: Floats
    positions: Floats


@dataclass(frozen=True, eq=False)
class CertifiedFrame(Reached):
    """A frame and its error.

    skin (n, 3) [mm]. error [mm]: the estimated mean distance to the converged simulator; see the module. errors (n,)
    [mm] are each vertex' own, whether it counts or not. certain: False where the estimate may be far off. method, in
    the order of price: derivatives, network + derivatives, corrected, in contact, converged. seconds: what it took.
    solves: with one of the two matrices.
    """

    skin: Floats32
    error: float
    errors: Floats32
    certain: bool
    method: str
    seconds: float
    solves: int

    @property
    def bound(self) -> float:
        """The bound of the error [mm], but for some in a hundred."""
        return self.error if self.certain else POLICY.doubt * self.error


class CertifiedFace:
    """A face bound to the simulator in some seconds, with a rig of its derivatives; see the module.

    `rig` makes the same face's frames without an estimate, at the price of blendshapes, by `method`.
    """

    def __init__(self, face: Face, rig: BoundSurrogate, method: str):
        self.face, self.rig, self.method = face, rig, method
        self.frame(np.full(len(face.shapes), 0.1), FINEST, seconds=0.0)  # compiles

    @property
    def skin(self) -> Surface:
        """The head's neutral skin without p [mm]."""
        return self.face.skin

    def frame(
        self,
        weights,
        accuracy: float = ACCURACY,
        *,
        seconds: float | None = None,
        after: Reached | None = None,
    ) -> CertifiedFrame:
        """Return a frame of 52 ARKit weights whose error [mm] is at most `accuracy`, by the cheapest method.

        seconds: no further correction begins after so long; the error may then be larger than asked. after: the frame
        before in a take, of this face, whose correction this one begins with; frames without it depend on their weights
        alone. Weights outside [0, 1] are clipped with a warning. InputError for weights and numbers out of range.
        """
        accuracy = number("accuracy", accuracy, least=FINEST, most=COARSEST, unit="mm")
        seconds = None if seconds is None else number("seconds", seconds, least=0.0, unit="s")
        begin = time.perf_counter()
        known = check_weights(weights).astype(np.float64)
        start = self._start(known, after)
        if seconds is None and self.face.derivatives.prepared.touches(start):
            return self._solve_in_contact(known, accuracy, after, begin)
        for frame in self._correct(known, start, accuracy, begin):
            is_late = seconds is not None and frame.seconds >= seconds
            if frame.bound <= accuracy or is_late:
                break
        if not self.face.derivatives.prepared.touches(frame.positions):
            return frame
        if is_late:
            return replace(frame, certain=False)
        return self._solve_in_contact(known, accuracy, after, begin, frame.solves)

    def touches(self, weights: Floats) -> bool:
        """Tell whether surfaces in contact touch where a frame of weights (52,) begins; see `frame`."""
        return self.face.derivatives.prepared.touches(self._start(weights, None))

    def improve(self, weights, *, after: Reached | None = None) -> Iterator[CertifiedFrame]:
        """Yield frames of 52 ARKit weights, each a correction nearer to the simulator, until one has converged.

        Arguments and errors are those of `frame`.
        """
        begin = time.perf_counter()
        known = check_weights(weights).astype(np.float64)
        for frame in self._correct(known, self._start(known, after), None, begin):
            if self.face.derivatives.prepared.touches(frame.positions):
                yield self._guess(frame)
                yield self._solve_in_contact(known, FINEST, after, begin, frame.solves)
                return
            yield frame

    def _guess(self, frame: CertifiedFrame) -> CertifiedFrame:
        """Return the rig's own frame, whose error is not certain, in the place of one whose surfaces touch."""
        if frame.method == self.method:
            return replace(frame, certain=False)
        skin = self.rig.frame(frame.weights.astype(np.float32))
        errors = np.linalg.norm(skin - frame.skin, axis=1)
        counted = find_counted(frame.skin.astype(np.float64), self.face.blend(frame.weights) + self.face.carried)
        error = float(errors[counted].mean())
        return replace(frame, skin=skin, error=error, errors=errors, certain=False, method=self.method)

    def _solve_in_contact(
        self, weights: Floats, accuracy: float, after: Reached | None, begin: float, solves: int = 0
    ) -> CertifiedFrame:
        """Solve a frame whose surfaces touch, from the frame before or the neutral face, to an accuracy [mm]."""
        linear, skin = self.face.derivatives, self.face.head.skin_from_wrap
        scene = self.face.scene(weights)
        start = linear.answer.positions if after is None else after.positions
        share = POLICY.converged if accuracy <= FINEST else POLICY.begun
        wrap = slice(len(self.face.head.bone))
        while True:
            stop = share * spring_norm(scene)
            # Untangling would lead far away from the frame before, some of whose tets may be inverted.
            solution = linear.prepared.solve(
                scene, start=start, absolute=stop, max_iterations=POLICY.most_solves, untangle=False
            )
            left, certain = linear.prepared.estimate_left(solution.positions, linear.tangent, wrap, scene)
            parted, solves = self.face.skin_after(weights, solution.positions), solves + solution.iterations
            errors = np.linalg.norm(skin @ left[wrap], axis=1)
            counted = find_counted(parted + skin @ left[wrap], self.face.blend(weights) + self.face.carried)
            ended = CertifiedFrame(
                weights=weights,
                positions=solution.positions,
                skin=parted.astype(np.float32),
                error=float(errors[counted].mean()),
                errors=errors.astype(np.float32),
                certain=certain and solution.converged,
                method="converged" if share <= POLICY.converged else "in contact",
                seconds=time.perf_counter() - begin,
                solves=solves,
            )
            if ended.bound <= accuracy or share <= POLICY.converged or not solution.converged:
                return ended
            start, share = solution.positions, POLICY.further * share

    def _correct(self, known: Floats, start: Floats, accuracy: float | None, begin: float) -> Iterator[CertifiedFrame]:
        """Yield the best frame so far after each round: Newton's step, L-BFGS to the accuracy, and the error anew."""
        correction = Correction(self.face, known, start)
        correction.smooth(1)
        if accuracy is not None:
            share = accuracy / max(self._estimate_roughly(correction), FINEST)
            if share < POLICY.direct:
                correction.smooth(POLICY.most_smoothing, until=POLICY.margin * share * correction.residual)
        ahead = correction.newton_step()
        if not ahead.is_near and correction.solves < POLICY.settling:
            correction.smooth(POLICY.settling)
            ahead = correction.newton_step()
        guess = self._estimate_error(
            correction, ahead, begin, self.rig.frame(known.astype(np.float32)), correction.skin()
        )
        before, best = guess.skin, replace(guess, method=self.method)
        while True:
            frame = self._estimate_error(correction, ahead, begin, correction.skin(), before)
            if frame.bound <= best.bound or frame.method == "converged":
                best = frame
            yield replace(best, positions=frame.positions, seconds=frame.seconds, solves=frame.solves)
            if correction.residual <= POLICY.converged or correction.solves >= POLICY.most_solves:
                return
            share = POLICY.further if accuracy is None else max(POLICY.margin * accuracy / frame.bound, POLICY.farthest)
            goal, before = share * correction.residual, frame.skin
            correction.take(ahead.step)
            correction.smooth(POLICY.most_smoothing, until=goal)
            ahead = correction.newton_step()

    def _start(self, weights: Floats, after: Reached | None) -> Floats:
        """Return the first order, and on it the correction of the frame before."""
        start = predict(self.face, weights)
        if after is None:
            return start
        if np.shape(after.positions) != start.shape:
            shape = np.shape(after.positions)
            raise InputError(f"after: a frame of another face, with vertices of shape {shape}, not {start.shape}")
        correction = finite("after", after.positions) - predict(
            self.face, check_weights(after.weights).astype(np.float64)
        )
        if (away := float(np.linalg.norm(correction, axis=1).mean())) > POLICY.apart:
            raise InputError(
                f"after: a frame of another face: {away:.2g} mm from this one's first order, "
                f"expected at most {POLICY.apart:g}"
            )
        return start + correction

    def _find_answer(self, correction: Correction, step: Floats) -> tuple[Floats, np.ndarray]:
        """Return the skin (n, 3) [mm] where a step would lead, and which vertices an error counts."""
        answer = correction.skin() + self.face.head.skin_from_wrap @ correction.move_wrap(step)
        return answer, find_counted(answer, correction.expression + self.face.carried)

    def _estimate_roughly(self, correction: Correction) -> float:
        """Estimate the error [mm] within a factor of some, by one solve."""
        answer, counted = self._find_answer(correction, correction.rough_step())
        return float(np.linalg.norm(answer - correction.skin(), axis=1)[counted].mean())

    def _estimate_error(
        self,
        correction: Correction,
        ahead: NewtonStep,
        begin: float,
        skin: Floats | Floats32,
        other: Floats | Floats32,
    ) -> CertifiedFrame:
        """Tell the error of a skin by where Newton's step leads, or where that has no end by another skin if nearer."""
        answer, counted = self._find_answer(correction, ahead.step)
        errors = np.linalg.norm(answer - skin, axis=1)
        has_converged = correction.residual <= POLICY.converged
        if not (ahead.is_near or has_converged):
            # Where tets fold Newton's step leads up to thirty times too far.
            apart = np.linalg.norm(other - skin, axis=1)
            errors = min(errors, apart, key=lambda distances: distances[counted].mean())
        return CertifiedFrame(
            weights=correction.weights,
            positions=correction.positions,
            skin=skin.astype(np.float32),
            error=float(errors[counted].mean()),
            errors=errors.astype(np.float32),
            certain=ahead.is_near or has_converged,
            method="converged" if has_converged else "corrected",
            seconds=time.perf_counter() - begin,
            solves=correction.solves,
        )


def find_counted(skin: Floats, carried: Floats) -> np.ndarray:
    """Return which vertices an error counts, shape (n,): those more than MOVES from carried blendshapes, or all."""
    moves = np.linalg.norm(skin - carried, axis=1) > MOVES
    return moves if moves.any() else np.ones_like(moves)
