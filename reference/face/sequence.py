"""Frames of one head one after another: prepared once, each started from the last, with inertia where asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ...lhm.base.checks import check_arguments
from ...lhm.base.errors import SceneError
from ...lhm.base.mesh import Floats
from ...lhm.head import LayeredHead
from ..scene import Scene
from ..solution import Solution, volume_ratio
from ..solve import Prepared, prepare
from ..terms import Target
from .base import lag, pivot, rotation, turns
from .bones import carried
from .dynamics import Recurrence
from .inertia import recurrence
from .parameters import Parameters
from .settling import Settled
from .stack import Stack

TOLERANCE = 2.5e-5


@dataclass(frozen=True, eq=False)
class State:
    """All that the next frame depends on, in mm: enough to go on later as if nothing had been between.

    positions (scene's vertices, 3) of the last frame; sought (n, 3): where its skin wrap was drawn to; before (n, 3):
    the skin wrap of the frame before it; drift (wraps' vertices, 3), or zero: by how much its change differs from that
    of the expression without physics, on which the next frame's start is led; turns (2, 3, 3): the head's rotation in
    the room in the frame before and in the last.
    """

    positions: Floats
    sought: Floats
    before: Floats
    drift: Floats = field(default_factory=lambda: np.zeros((1, 3)))
    turns: Floats = field(default_factory=lambda: np.stack([np.eye(3), np.eye(3)]))


class Sequence:
    """Simulates a head's expressions in their order, `time_step` [s] apart; `frame` is called for each.

    In statics a frame depends on its expression alone, the last frame is only where to begin. With `dynamic` the skin
    has the inertia of Eq. 9 (see `dynamics`), by p's frequency and damping where it is loose flesh (see `inertia`);
    bones that are prescribed stay so. A `base` that turns about `pivot` (see `base`) shakes what is loose; expressions
    and answers are in the head's own frame.
    `tolerance` is the gradient norm relative to that of springs of statics each 1 mm long: unlike one
    relative to a frame's own start it asks the same of every frame.
    `options` go to `prepare` of the solver, `choices` to `facial_scene`. Raises what these raise, and InputError for a
    time step at which the frequency cannot be followed. `of` makes one whose neutral face has settled under p.
    """

    @check_arguments
    def __init__(
        self,
        head: LayeredHead,
        parameters: Parameters,
        *,
        time_step: float = 1.0 / 60.0,
        dynamic: bool = False,
        tolerance: float = TOLERANCE,
        max_iterations: int | None = None,
        solver: str = "projective",
        options: Mapping[str, Any] | None = None,
        **choices: Any,
    ):
        if not (np.isfinite(tolerance) and 0.0 < tolerance < 1.0):
            raise SceneError(f"tolerance: expected a number in (0, 1), got {tolerance}")
        self.head, self.parameters, self.time_step = head, parameters, float(time_step)
        self.recurrence = recurrence(head, parameters, time_step) if dynamic else None
        self.state: State | None = None
        self._tolerance, self._limit = tolerance, max_iterations
        self._solver, self._options, self._choices = solver, dict(options or {}), choices
        self._stack = Stack.of(head, choices.get("layers", (1, 1)), choices.get("without", ()))
        self._prepared: dict[bool, Prepared] = {}
        self._neutral = Settled(head, parameters, self._stack.vertices, np.zeros_like(head.skin.vertices))
        self._pivot = pivot(head)

    @classmethod
    @check_arguments
    def of(cls, neutral: Settled, **options: Any) -> Sequence:
        """Frames of a face settled under its p: expressions stay those of the head without p.

        `options` are a sequence's, `choices` among them over those of `neutral`; the first frame starts from its tets.
        """
        sequence = cls(neutral.head, neutral.parameters, **neutral.choices | options)
        sequence._neutral = neutral
        return sequence

    @check_arguments
    def begin(self, targets: Floats, *, velocity: Floats | None = None, base: Floats | None = None) -> Solution:
        """Put the head at rest in an expression [mm], shape (skin vertices, 3), but moving at `velocity` [mm/s].

        The two frames before the first are then T₋₁ = this statics' answer, T₋₂ = T₋₁ - h velocity, on the skin wrap.
        `base`: how the head was turned in the room in these two, the earlier first, (2, 3, 3), or one (3, 3) for both;
        not turned if None. In statics neither has an effect. Returns the statics' solution.
        """
        turned = turns("base", np.eye(3) if base is None else base)
        moving = np.zeros_like(self.head.skin.vertices) if velocity is None else np.asarray(velocity, dtype=np.float64)
        if moving.shape != self.head.skin.vertices.shape or not np.isfinite(moving).all():
            raise SceneError(f"velocity: expected finite values of the skin's shape {self.head.skin.vertices.shape}")
        solution, scene = self._solved(targets, dynamic=False)
        wrap = solution.positions[: len(self.head.bone)]
        before = wrap - self.time_step * (self.head.wrap_from_skin @ moving)
        self.state = State(solution.positions, _target(scene).positions, before, turns=turned)
        return solution

    @check_arguments
    def frame(self, targets: Floats, *, base: Floats | None = None) -> Solution:
        """The next frame, towards an expression [mm], shape (skin vertices, 3); the first begins at rest in its own.

        `base`: the head's rotation in the room, shape (3, 3), or None as in the last frame (at first, not turned);
        one that goes on from frame to frame is `begin` with what it was before. Statics do not depend on it.
        Raises what `facial_scene` and the solver raise, and InputError for a base that is no rotation; then, and where
        an answer is not finite, the state stays.
        """
        turned = None if base is None else rotation("base", base)
        if self.recurrence is not None and self.state is None:
            self.begin(targets, base=turned)
        solution, scene = self._solved(targets, dynamic=self.recurrence is not None, base=turned)
        n = len(self.head.bone)
        if not np.isfinite(solution.positions).all():
            return solution
        positions, sought = solution.positions, _target(scene).positions
        if self.state is None:
            self.state = State(positions, sought, positions[:n])
        else:
            drift = self._beyond(positions, sought) - self._beyond(self.state.positions, self.state.sought)
            now = self.state.turns[1] if turned is None else turned
            turned_by = np.stack([self.state.turns[1], now])
            self.state = State(positions, sought, self.state.positions[:n], drift, turned_by)
        return solution

    @check_arguments
    def skin(self, targets: Floats, solution: Solution) -> Floats:
        """The skin [mm], shape (skin vertices, 3), of a frame's expression and solution."""
        return self._neutral.skin_after(targets, solution.positions)

    def _solved(self, targets: Floats, *, dynamic: bool, base: Floats | None = None) -> tuple[Solution, Scene]:
        scene = self._neutral.scene(targets, **self._choices)
        # Of statics, also in dynamics: there k/γ resists a residual in one frame, but k alone when it stays for many.
        springs = np.broadcast_to(_target(scene).stiffness, _target(scene).vertices.shape)
        asked = self._tolerance * float(np.linalg.norm(springs))
        if dynamic and self.recurrence is not None and self.state is not None:
            scene = self._with_inertia(scene, self.recurrence, self.state, base)
        if dynamic not in self._prepared:
            self._prepared[dynamic] = prepare(scene, solver=self._solver, **self._options)
        prepared = self._prepared[dynamic]
        start = self._start(scene, _target(scene))
        return self._minimised(prepared, scene, start, asked), scene

    def _with_inertia(self, scene: Scene, recurrence: Recurrence, state: State, base: Floats | None) -> Scene:
        """The scene with targets by Eq. 9, the base's motion in them, and their stiffness over γ."""
        static = _target(scene)
        last, before = state.positions[: len(static.vertices)], state.before
        sought = recurrence.target(static.positions, last, before)
        now = state.turns[1] if base is None else base
        behind = lag(now, last - self._pivot, before - self._pivot, state.turns)
        if behind is not None:
            sought = sought + recurrence.driven_by(behind)
        moving = replace(static, positions=sought, stiffness=recurrence.stiffness(static.stiffness))
        return replace(scene, terms=tuple(moving if term is static else term for term in scene.terms))

    def _minimised(self, prepared: Prepared, scene: Scene, start: Floats, absolute: float) -> Solution:
        """The scene's solution: from a sound frame to a sound one there is nothing to untangle, which costs as much."""
        asked: dict[str, Any] = {"start": start, "max_iterations": self._limit, "absolute": absolute}
        last = self._last()
        sound = last is not None and (volume_ratio(scene, last.positions) > 0).all()
        if sound and self._solver == "projective":
            solution = prepared.solve(scene, **asked | {"untangle": False})
            if (solution.volume_ratio > 0).all():
                return solution
        return prepared.solve(scene, **asked)

    def _start(self, scene: Scene, target: Target) -> Floats:
        """The last frame, and on it the change that the expression makes and what the last change had beyond that."""
        ahead = self._carried(target.positions)
        start = np.array(scene.vertices)
        last = self._last()
        if last is not None:
            if last.positions.shape != start.shape:
                raise SceneError(f"start: {len(last.positions)} vertices before, {len(start)} in this scene")
            start[:] = last.positions
            ahead += self._beyond(start, last.sought) + last.drift
        start[: len(ahead)] = ahead
        return start

    def _last(self) -> State | None:
        """What the next frame starts from: the last, or the neutral face settled under p."""
        if self.state is not None or not self._neutral.displacement.any():
            return self.state
        positions, n = self._neutral.positions, len(self.head.bone)
        return State(positions, self.head.wrap_targets(self._neutral.skin), positions[:n])

    def _beyond(self, positions: Floats, sought: Floats) -> Floats:
        """How far [mm] the wraps' vertices are from where the expression alone takes them."""
        ahead = self._carried(sought)
        return positions[: len(ahead)] - ahead

    def _carried(self, wrap_targets: Floats) -> Floats:
        """The scene's vertices of the wraps [mm] where an expression takes them without physics."""
        rest = self.head.wrap_targets(self._neutral.skin)
        return self._stack.between(*carried(self.head, self.parameters, rest, wrap_targets))


def _target(scene: Scene) -> Target:
    """The term that draws the skin wrap to the expression: the first of its kind."""
    return scene.of(Target)[0]
