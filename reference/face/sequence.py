"""Frames of one head one after another: prepared once, each started from the last, with inertia where asked for.

Short dynamic sequences begin with velocities from one long run, carried onto other identities: the paper starts its
sequences of 16 with velocities from a run of 2,048 frames with fixed dynamics. They are kept in each skin vertex' own
frame of the neutral face and in head sizes per second, so that a cheek that swings outward swings outward on every head
whose skin has the same triangles.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...lhm.base.checks import finite
from ...lhm.base.errors import InputError, SceneError
from ...lhm.base.mesh import Floats, Surface
from ...lhm.head.head import LayeredHead
from ..projective import ProjectivePrepared, Tangent
from ..scene import Scene
from ..solution import Solution, volume_ratio
from ..solve import Prepared, prepare
from ..terms import Contact, Target
from .bones import carry_wraps
from .dynamics import Recurrence, base_lag, check_rotation, check_turns, find_pivot
from .face import Face
from .tissue import Stack

TOLERANCE = 2.5e-5
"""Gradient norm relative to that of the targets' springs each 1 mm long."""
FARTHEST = 60.0
"""[mm] A velocity that would carry some vertex farther over a sequence is none of a face."""
LENGTH = 16
"""Frames of a sequence."""


@dataclass(frozen=True, eq=False)
class SequenceState:
    """The state from which the next frame follows, in mm; a sequence that goes on from it is the same.

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


@dataclass(frozen=True, eq=False)
class _LastFrame:
    """A frame's scene and solution, the state before it, and how the head was turned, if that was said."""

    prepared: Prepared
    scene: Scene
    solution: Solution
    before: SequenceState | None
    turned: Floats | None


class Sequence:
    """Simulates a face's expressions in their order, `time_step` [s] apart; `frame` is called for each.

    Expressions are those of the head without p; the first frame starts from the face as it has settled under p.
    In statics a frame depends on its expression alone, the last frame is only where to begin. With `dynamic` the skin
    has the inertia of Eq. 9 (see `dynamics`), by p's frequency and damping where it is loose flesh (see `inertia`);
    bones that are prescribed stay so. A `base` that turns about `pivot` (see `base`) shakes what is loose; expressions
    and answers are in the head's own frame.
    `tolerance` is the gradient norm relative to that of springs of statics each 1 mm long: unlike one
    relative to a frame's own start it asks the same of every frame.
    `options` go to `prepare` of the solver. Raises what that, settling and `facial_scene` raise, and InputError for a
    time step at which the frequency cannot be followed.
    """

    def __init__(
        self,
        face: Face,
        *,
        time_step: float = 1.0 / 60.0,
        dynamic: bool = False,
        tolerance: float = TOLERANCE,
        max_iterations: int | None = None,
        solver: str = "projective",
        options: Mapping[str, Any] | None = None,
    ):
        if not (np.isfinite(tolerance) and 0.0 < tolerance < 1.0):
            raise SceneError(f"tolerance: expected a number in (0, 1), got {tolerance}")
        self.face, self.head, self.time_step = face, face.head, float(time_step)
        self.recurrence = Recurrence.from_head(face.head, face.on_wraps, time_step) if dynamic else None
        self.state: SequenceState | None = None
        self._tolerance, self._limit = tolerance, max_iterations
        self._solver, self._options = solver, dict(options or {})
        self._stack = Stack.from_head(face.head, face.choices.get("layers", (1, 1)), face.choices.get("without", ()))
        self._prepared: dict[bool, Prepared] = {}
        self._pivot = find_pivot(face.head)
        self._spring_norm = 0.0
        self._last_frame: _LastFrame | None = None
        self._tangent: Tangent | None = None

    def begin(self, targets: Floats, *, velocity: Floats | None = None, base: Floats | None = None) -> Solution:
        """Put the head at rest in an expression [mm], shape (skin vertices, 3), but moving at `velocity` [mm/s].

        The two frames before the first are then T₋₁ = this statics' answer, T₋₂ = T₋₁ - h velocity, on the skin wrap.
        `base`: how the head was turned in the room in these two, the earlier first, (2, 3, 3), or one (3, 3) for both;
        not turned if None. In statics neither has an effect. Returns the statics' solution.
        """
        turned = check_turns("base", np.eye(3) if base is None else base)
        skin = self.head.skin.vertices
        moving = 0.0 * skin if velocity is None else finite("velocity", velocity, skin.shape, error=SceneError)
        solution, scene = self._solve(targets, dynamic=False)
        wrap = solution.positions[: len(self.head.bone)]
        before = wrap - self.time_step * (self.head.wrap_from_skin @ moving)
        self.state = SequenceState(solution.positions, _target(scene).positions, before, turns=turned)
        return solution

    def frame(self, targets: Floats, *, base: Floats | None = None) -> Solution:
        """Simulate the next frame, towards an expression [mm], shape (skin vertices, 3).

        The first begins at rest in its own expression.
        `base`: the head's rotation in the room, shape (3, 3), or None as in the last frame (at first, not turned);
        one that goes on from frame to frame is `begin` with what it was before. Statics do not depend on it.
        Raises what `facial_scene` and the solver raise, and InputError for a base that is no rotation; then, and where
        an answer is not finite, the state stays.
        """
        turned = None if base is None else check_rotation("base", base)
        if self.recurrence is not None and self.state is None:
            self.begin(targets, base=turned)
        dynamic = self.recurrence is not None
        solution, scene = self._solve(targets, dynamic=dynamic, base=turned)
        if np.isfinite(solution.positions).all():
            self._last_frame = _LastFrame(self._prepared[dynamic], scene, solution, self.state, turned)
            self.state = self._state_after(self._last_frame)
        return solution

    def _state_after(self, frame: _LastFrame) -> SequenceState:
        """Return the state that a frame's solution leaves."""
        n = len(self.head.bone)
        positions, sought, before = frame.solution.positions, _target(frame.scene).positions, frame.before
        if before is None:
            return SequenceState(positions, sought, positions[:n])
        drift = self._beyond(positions, sought) - self._beyond(before.positions, before.sought)
        now = before.turns[1] if frame.turned is None else frame.turned
        return SequenceState(positions, sought, before.positions[:n], drift, np.stack([before.turns[1], now]))

    def refine(self, tolerance: float) -> Solution:
        """Solve the last frame on to a smaller tolerance, from its answer. SceneError before there is a frame."""
        frame = self._frame_before()
        options: dict[str, Any] = {"start": frame.solution.positions, "absolute": tolerance * self._spring_norm}
        if self._solver == "projective":
            options["untangle"] = False
        solution = frame.prepared.solve(frame.scene, max_iterations=self._limit, **options)
        if np.isfinite(solution.positions).all():
            self._last_frame = replace(frame, solution=solution)
            self.state = self._state_after(self._last_frame)
        return solution

    def estimate_left(self) -> tuple[Floats, bool] | None:
        """Estimate how far the last frame's skin is from converged [mm], shape (skin vertices, 3); None where unknown.

        By Newton's step with the Hessian of the neutral face, whose factor costs a second once; also returns whether
        the step is near its end. Other solvers than PD have none. SceneError before there is a frame.
        """
        frame = self._frame_before()
        prepared = frame.prepared
        if not isinstance(prepared, ProjectivePrepared):
            return None
        if self._tangent is None:
            scene = self.face.neutral_scene()
            springs = replace(_target(scene), stiffness=_target(frame.scene).stiffness)
            scene = replace(scene, terms=tuple(springs if term is _target(scene) else term for term in scene.terms))
            self._tangent = prepared.tangent(replace(frame.solution, positions=self.face.settled().positions), scene)
        wrap = slice(len(self.head.bone))
        correction, is_near = prepared.estimate_left(frame.solution.positions, self._tangent, wrap, frame.scene)
        return self.head.skin_from_wrap @ correction[wrap], is_near

    def _frame_before(self) -> _LastFrame:
        if self._last_frame is None:
            raise SceneError("the sequence has no frame yet")
        return self._last_frame

    def skin(self, targets: Floats, solution: Solution) -> Floats:
        """The skin [mm], shape (skin vertices, 3), of a frame's expression and solution."""
        return self.face.expression_skin(targets, solution.positions)

    def _solve(self, targets: Floats, *, dynamic: bool, base: Floats | None = None) -> tuple[Solution, Scene]:
        scene = self.face.expression_scene(targets)
        # Dynamics take the statics' k, too: k/γ resists a residual in one frame, but k alone when it stays for many.
        springs = np.broadcast_to(_target(scene).stiffness, _target(scene).vertices.shape)
        self._spring_norm = float(np.linalg.norm(springs))
        absolute = self._tolerance * self._spring_norm
        if dynamic and self.recurrence is not None and self.state is not None:
            scene = self._with_inertia(scene, self.recurrence, self.state, base)
        if dynamic not in self._prepared:
            self._prepared[dynamic] = prepare(scene, solver=self._solver, **self._options)
        prepared = self._prepared[dynamic]
        start = self._start(scene, _target(scene))
        return self._minimise(prepared, scene, start, absolute), scene

    def _with_inertia(self, scene: Scene, recurrence: Recurrence, state: SequenceState, base: Floats | None) -> Scene:
        """Give the scene targets by Eq. 9, the base's motion in them, and their stiffness over γ."""
        static = _target(scene)
        last, before = state.positions[: len(static.vertices)], state.before
        sought = recurrence.target(static.positions, last, before)
        now = state.turns[1] if base is None else base
        behind = base_lag(now, last - self._pivot, before - self._pivot, state.turns)
        if behind is not None:
            sought = sought + recurrence.driven_by(behind)
        moving = replace(static, positions=sought, stiffness=recurrence.stiffness(static.stiffness))
        return replace(scene, terms=tuple(moving if term is static else term for term in scene.terms))

    def _minimise(self, prepared: Prepared, scene: Scene, start: Floats, absolute: float) -> Solution:
        """Solve a scene: from a sound frame to a sound one there is nothing to untangle, which costs as much."""
        options: dict[str, Any] = {"start": start, "max_iterations": self._limit, "absolute": absolute}
        last = self._last()
        sound = last is not None and (volume_ratio(scene, last.positions) > 0).all()
        if sound and self._solver == "projective":
            solution = prepared.solve(scene, **options | {"untangle": False})
            if (solution.volume_ratio > 0).all():
                return solution
        return prepared.solve(scene, **options)

    def _start(self, scene: Scene, target: Target) -> Floats:
        """The last frame, and on it the change that the expression makes and what the last change had beyond that.

        With contact the last frame alone: beyond it surfaces might cross.
        """
        ahead = self._carry(target.positions)
        start = np.array(scene.vertices)
        last = self._last()
        if scene.of(Contact):
            return start if last is None else last.positions
        if last is not None:
            if last.positions.shape != start.shape:
                raise SceneError(f"start: {len(last.positions)} vertices before, {len(start)} in this scene")
            start[:] = last.positions
            ahead += self._beyond(start, last.sought) + last.drift
        start[: len(ahead)] = ahead
        return start

    def _last(self) -> SequenceState | None:
        """Return the next frame's start: the last frame, or the neutral face settled under p."""
        settled = self.face.settled()
        if self.state is not None or not settled.displacement.any():
            return self.state
        positions, n = settled.positions, len(self.head.bone)
        return SequenceState(positions, self.head.wrap_targets(settled.skin), positions[:n])

    def _beyond(self, positions: Floats, sought: Floats) -> Floats:
        """Return the distance [mm] of the wraps' vertices from where the expression alone takes them."""
        ahead = self._carry(sought)
        return positions[: len(ahead)] - ahead

    def _carry(self, wrap_targets: Floats) -> Floats:
        """The scene's vertices of the wraps [mm] where an expression takes them without physics."""
        rest = self.head.wrap_targets(self.face.settled().skin)
        return self._stack.interpolate(*carry_wraps(self.head, self.face.on_wraps, rest, wrap_targets))


def _target(scene: Scene) -> Target:
    """The term that draws the skin wrap to the expression: the first of its kind."""
    return scene.of(Target)[0]


@dataclass(frozen=True, eq=False)
class Velocities:
    """The skin's velocities of a run's frames from the second on, shape (frames, skin vertices, 3).

    `local` [1/s] holds them in each vertex' neutral frame (see `vertex_frames`), over `head_size`.
    """

    local: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.local)

    @classmethod
    def from_skins(cls, head: LayeredHead, skins: Iterable[Floats | None], time_step: float) -> Velocities:
        """Take (T_k - T_{k-1}) / time_step of a head's simulated skins [mm], each (skin vertices, 3), in order.

        None stands for a frame without an answer. InputError where there are no two frames in a row.
        """
        frames = vertex_frames(head.skin) / (time_step * head_size(head))
        local, last = [], None
        for skin in skins:
            if skin is not None and last is not None:
                local.append(np.einsum("nij,ni->nj", frames, skin - last).astype(np.float32))
            last = skin
        if not local:
            raise InputError("velocities: two frames in a row are needed")
        return cls(np.array(local))

    @classmethod
    def from_sequence(cls, sequence: Sequence, targets: Iterable[Floats]) -> Velocities:
        """Run a dynamic sequence through expressions [mm], each (skin vertices, 3), and take its velocities.

        A frame whose answer is not finite has none, nor has the next. InputError for a sequence without dynamics.
        """
        if sequence.recurrence is None:
            raise InputError("velocities: expected a dynamic sequence")
        solved = ((expression, sequence.frame(expression)) for expression in targets)
        skins = (sequence.skin(*pair) if np.isfinite(pair[1].positions).all() else None for pair in solved)
        return cls.from_skins(sequence.head, skins, sequence.time_step)

    def on(self, head: LayeredHead, number: int) -> Floats:
        """Frame `number`'s velocity on another head of the same skin triangles [mm/s], shape (skin vertices, 3).

        InputError for a head whose skin has another count of vertices, and for a number that is none of these frames.
        """
        if not 0 <= number < len(self):
            raise InputError(f"velocity {number}: there are {len(self)}")
        if self.local.shape[1] != len(head.skin.vertices):
            raise InputError(f"velocities: of a skin of {self.local.shape[1]} vertices, not {len(head.skin.vertices)}")
        there = np.asarray(self.local[number], dtype=np.float64)
        return head_size(head) * np.einsum("nij,nj->ni", vertex_frames(head.skin), there)


def is_plausible(velocity: Floats, time_step: float, *, frames: int = LENGTH, farthest: float = FARTHEST) -> bool:
    """Whether no vertex would go farther [mm] at this velocity [mm/s], shape (n, 3), over so many frames."""
    return bool(np.linalg.norm(velocity, axis=1).max() * time_step * frames <= farthest)


def head_size(head: LayeredHead) -> float:
    """The root mean square distance [mm] of the skin wrap from its middle."""
    x = head.skin_wrap.vertices
    return float(np.sqrt(np.mean(np.sum((x - x.mean(axis=0)) ** 2, axis=1))))


def vertex_frames(skin: Surface) -> Floats:
    """Each vertex' own frame, shape (n, 3, 3): columns along its first edge in the surface, across it, and normal.

    Two surfaces of the same triangles agree on which edge is first. A vertex without triangles has the axes' frame.
    """
    x, triangles = skin.vertices, skin.triangles
    start, edge = np.unique(triangles.ravel(), return_index=True)
    following = np.roll(triangles, -1, axis=1).ravel()[edge]
    normal = skin.vertex_normals[start]
    along = x[following] - x[start]
    along -= np.sum(along * normal, axis=1, keepdims=True) * normal
    length = np.linalg.norm(along, axis=1, keepdims=True)
    sound = (length[:, 0] > 0.0) & (np.abs(np.linalg.norm(normal, axis=1) - 1.0) < 1e-6)
    along = along / np.where(length > 0.0, length, 1.0)
    frames = np.broadcast_to(np.eye(3), (len(x), 3, 3)).copy()
    frames[start[sound]] = np.stack([along, np.cross(normal, along), normal], axis=2)[sound]
    return frames
