"""A face: a head under p, with all that a method may ask of it, each computed when it is first asked, once."""

from __future__ import annotations

from collections.abc import Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from ...lhm.base.checks import finite
from ...lhm.base.errors import InputError, quote
from ...lhm.base.geometry.bvh import TriangleTree
from ...lhm.base.mesh import Floats, Floats32, Ints, Surface
from ...lhm.head.head import LayeredHead
from ...lhm.head.skin import check_shapes
from ..scene import Scene
from ..solution import OnIteration
from ..terms import Contact, Gaps, Target
from . import palsy
from .derivatives import (
    QUICK_ACCURACY,
    FaceDerivatives,
    Rested,
    carry_to_skin,
    differentiate,
    rest_among_targets,
)
from .dynamics import OSCILLATION, Swing, find_pivot, measure_looseness
from .facial import PD_ENERGY, FaceLaw, apply_law, check_targets, contact_regions, facial_scene
from .local import at_vertices, from_wraps, on_wraps
from .organs import find_organs
from .parameters import Parameters
from .settle import TARGET_OPTIONS, SettledFace, carry_skin, neutral_scene, settle
from .variation import WIDE, split_apart, vary

PROBE = 0.1
"""Weight of all shapes in an expression that shows which terms of a scene move."""
STEP = 1e-3
"""Weight of a shape in difference quotients."""


@dataclass(frozen=True, eq=False)
class Face:
    """A head under p.

    shapes (52, n, 3) [mm]: what each weight adds to its skin; without them it is asked for skins of expressions alone.
    parameters: local values are one per face of the skin, or `per` triangle of the wraps. code: the person's in an
    identity space, where it is known. `choices` are those of `facial_scene`, less the bones, which hang free in the
    expressions' scenes unless these say otherwise. `settling` are options of `settle`. accuracy: of the neutral answer
    that derivatives are taken at; see `rest_among_targets`. `on_iteration` sees how the face settles, and may end it.

    InputError for shapes of another size, unit or order of vertices, and for derivatives of a face that does not
    settle. What is asked raises what the simulator raises.
    """

    head: LayeredHead
    shapes: Floats = field(default_factory=lambda: np.zeros((0, 0, 3)))
    parameters: Parameters = field(default_factory=Parameters)
    per: Literal["skin", "wraps"] = "skin"
    code: Floats | None = None
    choices: Mapping[str, Any] = field(default_factory=dict)
    settling: Mapping[str, Any] = field(default_factory=lambda: TARGET_OPTIONS)
    accuracy: float = QUICK_ACCURACY
    on_iteration: OnIteration | None = None
    _settled: dict[FaceLaw, SettledFace] = field(default_factory=dict, init=False, repr=False)
    _frames: dict[bytes, FaceDerivatives] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self):
        for name, kind in (("head", LayeredHead), ("parameters", Parameters)):
            if not isinstance(getattr(self, name), kind):
                raise InputError(f"{name}: expected {kind.__name__}, got {type(getattr(self, name)).__name__}")
        if self.per not in ("skin", "wraps"):
            raise InputError(f"per: expected 'skin' or 'wraps', got {quote(self.per)!r}")
        if self.code is not None:
            code = finite("code", self.code, (None,))
            if not code.size:
                raise InputError("code: expected numbers, got none")
            object.__setattr__(self, "code", code)
        none = np.zeros((0, *self.head.skin.vertices.shape))
        shapes = check_shapes(self.shapes, self.head.skin) if np.size(self.shapes) else none
        object.__setattr__(self, "shapes", np.asarray(shapes, dtype=np.float64))

    @property
    def skin(self) -> Surface:
        """The neutral skin without p [mm]."""
        return self.head.skin

    @cached_property
    def on_wraps(self) -> Parameters:
        """The parameters as the simulator takes them, local values per triangle of the wraps."""
        return self.parameters if self.per == "wraps" else on_wraps(self.parameters, self.head)

    def in_contact(self) -> Face:
        """Return the same face with lids, lips and what lines them kept from crossing, and off eyeballs and teeth.

        Of heads in other than the default triangles no eyeballs and teeth are known.
        """
        regions = contact_regions(self.head)
        if not regions:
            return self
        return replace(self, choices={**self.choices, "contact": regions, "organs": find_organs(self.head)})

    def at_vertices(self, name: str) -> Floats:
        """Return a parameter at the skin's vertices, shape (n,), mapped to [-1, 1]; InputError for values per tet."""
        value = getattr(self.parameters, name)
        return from_wraps(name, value, self.head) if self.per == "wraps" else at_vertices(name, value, self.skin)

    def blend(self, weights: Floats | Floats32) -> Floats:
        """Blend the shapes [mm], shape (n, 3), without p: S of weights (52,)."""
        return self.head.skin.vertices + np.tensordot(weights, self.shapes, axes=1)

    def count_crossings(self, skin: Floats | Floats32) -> int:
        """Count the pairs of triangles of a skin [mm], shape (n, 3), that cross, and do not cross in the neutral one.

        One of each pair is of what touches as a face moves: of lids, lips and what lines eyes and mouth.
        """
        tree, some, at_rest = self._tree
        pairs = tree.moved(np.asarray(skin, dtype=np.float64)).crossings_of(some)
        return len(np.setdiff1d(pairs @ [len(self.skin.triangles), 1], at_rest))

    @cached_property
    def _tree(self) -> tuple[TriangleTree, Ints, Ints]:
        """The neutral skin's triangles, those that touch others (k,), and the pairs that cross, as numbers."""
        tree = TriangleTree(self.skin.vertices, self.skin.triangles)
        regions = contact_regions(self.head)
        touching = self.head.on_skin(regions) if regions else np.zeros(len(self.skin.vertices), dtype=bool)
        some = np.flatnonzero(touching[self.skin.triangles].any(axis=1))
        return tree, some, tree.crossings_of(some) @ [len(self.skin.triangles), 1]

    @cached_property
    def carried(self) -> Floats:
        """Displacement of the neutral skin with scaled bones [mm], shape (n, 3)."""
        return carry_skin(self.head, self.on_wraps)

    @cached_property
    def swing(self) -> Swing:
        """The swing of its skin: loose where the head has flesh far from bone, by p's frequency and damping there."""
        # Weights of skin off the wrap's triangles reach a little beyond their corners.
        shares = np.clip(self.head.skin_from_wrap @ measure_looseness(self.head), 0.0, 1.0)
        oscillation = np.stack([self.at_vertices(name) for name in OSCILLATION])
        return Swing.from_shares(shares, find_pivot(self.head), oscillation)

    def settled(self, law: FaceLaw = PD_ENERGY) -> SettledFace:
        """Return how the neutral face settles by a law, once for each."""
        if law not in self._settled:
            self._settled[law] = settle(
                self.head, self.on_wraps, law=law, on_iteration=self.on_iteration, **self.settling, **self.choices
            )
        return self._settled[law]

    def settled_as(self, settled: SettledFace) -> Face:
        """Return the same face, which has settled by a law as this says."""
        face = replace(self)
        face._settled[settled.law] = settled
        return face

    def scene(self, weights: Floats | Floats32, law: FaceLaw = PD_ENERGY) -> Scene:
        """Return the scene of an expression under a law, on the neutral face that this law has settled."""
        return self.expression_scene(self.blend(weights), law)

    def expression_scene(self, expression: Floats, law: FaceLaw = PD_ENERGY) -> Scene:
        """Return the same of an expression that is given by the head's skin [mm] without p, shape (n, 3).

        Raises what `facial_scene` and `apply_law` raise.
        """
        settled = self.settled(law)
        targets = settled.targets(check_targets(self.head, expression))
        choices = {"neutral": settled.skin, **self.choices}
        return apply_law(facial_scene(self.head, self.on_wraps, targets, **choices), law)

    def neutral_scene(self, law: FaceLaw = PD_ENERGY) -> Scene:
        """Return the scene without an expression."""
        return self.expression_scene(self.head.skin.vertices, law)

    def skin_after(self, weights: Floats | Floats32, positions: Floats, law: FaceLaw = PD_ENERGY) -> Floats:
        """Return the skin [mm], shape (n, 3), of an expression and the positions of its scene."""
        return self.expression_skin(self.blend(weights), positions, law)

    def expression_skin(self, expression: Floats, positions: Floats, law: FaceLaw = PD_ENERGY) -> Floats:
        """Return the same of an expression that is given by the head's skin [mm] without p, shape (n, 3)."""
        settled = self.settled(law)
        goal = settled.targets(check_targets(self.head, expression, "expression"))
        if self.activation is not None:
            goal = settled.skin + self.activation * (goal - settled.skin)
        return self.head.skin_after(goal, positions[: len(self.head.bone)])

    @cached_property
    def activation(self) -> Floats | None:
        return palsy.skin_activation(self.head, self.on_wraps)

    @cached_property
    def _rested(self) -> Rested:
        return self._rest(self.neutral_scene())

    def _rest(self, scene: Scene) -> Rested:
        settled = self.settled()
        if not settled.converged:
            raise InputError(f"the face does not settle under these parameters ({settled.reason})")
        return rest_among_targets(scene, settled.positions, self.accuracy, self.on_iteration)

    @cached_property
    def derivatives(self) -> FaceDerivatives:
        """The neutral scene, prepared, with its answer and the factored Hessian there."""
        return differentiate(self._rested, accuracy=self.accuracy, on_iteration=self.on_iteration)

    @cached_property
    def offset(self) -> Floats:
        """T - S at w = 0 [mm], shape (n, 3): how the neutral face settles, and then rests among its targets."""
        settled, (_, answer) = self.settled(), self._rested
        if not answer.converged:
            answer = self.derivatives.answer
        rested = self.expression_skin(self.head.skin.vertices, answer.positions) - settled.skin
        return rested + settled.displacement

    @cached_property
    def goals(self) -> Floats | None:
        """Motion of the springs' ends with each shape [mm], shape (52, springs, 3).

        None where an expression moves more of its scene than the first Target, as places that are held.
        """
        neutral = self.derivatives.prepared.scene
        if self.scene(np.full(len(self.shapes), PROBE)).find_changes(neutral) - {(neutral.first(Target), "positions")}:
            return None
        motions = np.stack([self.head.wrap_from_skin @ shape for shape in self.shapes])
        return palsy.Springs.from_head(self.head, self.on_wraps).move(motions)

    @cached_property
    def first_order(self) -> Floats:
        """Motion of the scene's vertices with each shape [mm], shape (52, scene's vertices, 3)."""
        if self.goals is not None:
            return self.derivatives.tangent.vertices_by_targets(self.goals)
        steps = STEP * np.eye(len(self.shapes))
        changes = (((self.scene(w), 0.5 / STEP), (self.scene(-w), -0.5 / STEP)) for w in steps)
        return self.derivatives.tangent.vertices_by_scenes(changes)

    @cached_property
    def responses(self) -> Floats:
        """d(T - S)/dw at w = 0 [mm], shape (52, n, 3)."""
        drawn = self.shapes if self.activation is None else self.activation * self.shapes
        return carry_to_skin(self.head, self.first_order, drawn) - self.shapes

    def frame(self, weights: Floats | Floats32) -> Floats:
        """Simulate the skin [mm], shape (n, 3), of weights (52,), to `accuracy`; InputError if it does not converge."""
        return self.skin_after(weights, self._differentiate_frame(weights).answer.positions)

    def jvp(self, weights: Floats | Floats32, by: SequenceOf[str]) -> dict[str, Floats]:
        """Differentiate `frame` by parameters that are one number: dT/dp [mm/unit], shape (n, 3), of each name.

        The neutral face settles anew as p changes. One solve a name. InputError for an unknown name, one that varies
        over the face, and a frame that has no derivative; see `vjp`.
        """
        settling, frame = self._settling, self._differentiate_frame(weights)
        _check_exact(settling, frame)
        moved = {}
        for name in by:
            self._check_differentiable(name)
            if np.ndim(getattr(self.parameters, name)):
                raise InputError(f"jvp: parameter {name} varies over the face; vjp takes it")
            *sides, apart = vary(self.on_wraps, name)
            value, share = getattr(self.on_wraps, name), 1.0 / apart
            scenes = [_hold_contact(self._settling_scene(p), settling) for p in sides]
            settles = settling.tangent.vertices_by_scenes([zip(scenes, (share, -share), strict=True)])[0]
            faces = [self._shifted(p, (getattr(p, name) - value) * settles) for p in sides]
            scenes = [_hold_contact(face.scene(weights), frame) for face in faces]
            vertices = frame.tangent.vertices_by_scenes([zip(scenes, (share, -share), strict=True)])[0]
            ahead, behind = (
                face.skin_after(weights, frame.answer.positions + (getattr(face.parameters, name) - value) * vertices)
                for face in faces
            )
            moved[name] = share * (ahead - behind)
        return moved

    def vjp(self, cotangent: Floats, weights: Floats | Floats32, by: SequenceOf[str]) -> dict[str, float | Floats]:
        """Differentiate Σ cotangent · T of T = `frame(weights)` by parameters, whatever their number by two solves.

        An adjoint one of the frame, and one of the neutral face, which settles anew as p changes.
        cotangent (n, 3): the derivative of anything by T [1/mm]. Returns for each name a number, or one per triangle of
        the wraps, (m,), where the parameter varies. Exact but for difference quotients of forces, to some 1e-6; the
        frame itself is to `accuracy`, settling to `settling`.

        InputError for an unknown name, a field per face of the skin or per tet (give it per triangle of the wraps),
        bones that targets place, a frame that is no strict minimum, and bones' scales together with contact.
        """
        settling, frame = self._settling, self._differentiate_frame(weights)
        _check_exact(settling, frame)
        head, settled = self.head, self.settled()
        cotangent = finite("cotangent", cotangent, self.skin.vertices.shape)
        scene = frame.tangent.scene
        elsewhere = self._shifted(self.on_wraps, np.ones_like(settled.positions)).scene(weights)
        if scene.find_changes(_hold_contact(elsewhere, frame)) - {(scene.first(Target), "positions")}:
            raise InputError("vjp: what this face holds follows its settled skin; jvp takes it")
        # T = goal + skin_from_wrap (x - wrap_from_skin goal), where goal and springs' ends go with the settled face.
        by_wrap = head.skin_from_wrap.T @ cotangent
        frames = frame.tangent.adjoint(_pad(by_wrap, scene))
        by_settled = cotangent + head.wrap_from_skin.T @ (frames.by_targets() - by_wrap)
        settles = settling.tangent.adjoint(_pad(head.skin_from_wrap.T @ by_settled, scene))

        def shares(sides: list[Parameters]) -> Floats:
            own = [_hold_contact(self._shifted(p).scene(weights), frame) for p in sides]
            before = [_hold_contact(self._settling_scene(p), settling) for p in sides]
            signs = (1.0, -1.0)
            return frames.by_scenes(zip(own, signs, strict=True)) + settles.by_scenes(zip(before, signs, strict=True))

        derivatives: dict[str, float | Floats] = {}
        for name in by:
            self._check_differentiable(name)
            if not np.ndim(getattr(self.parameters, name)):
                *sides, apart = vary(self.on_wraps, name)
                ahead, behind = (self._shifted(p).skin_after(weights, frame.answer.positions) for p in sides)
                derivatives[name] = float((shares(sides).sum() + np.sum(cotangent * (ahead - behind))) / apart)
                continue
            field = derivatives[name] = np.zeros(len(head.skin_wrap.triangles))
            for triangles, owner in split_apart(head.skin_wrap, name in WIDE):
                *sides, apart = vary(self.on_wraps, name, triangles)
                of_columns = shares(sides)
                owners = np.resize(owner, len(of_columns))
                sums = np.bincount(owners[owners >= 0], of_columns[owners >= 0], len(field))
                field[triangles] = sums[triangles] / apart[triangles]
        return derivatives

    def _check_differentiable(self, name: str) -> None:
        info = Parameters.info(name)
        shape = np.shape(getattr(self.parameters, name))
        if shape and (self.per != "wraps" or shape != (len(self.head.skin_wrap.triangles),)):
            raise InputError(
                f"parameter {name}: to differentiate by it, give one number, or one per triangle of the wraps"
            )
        if shape and (self.choices.get("attached") or self.choices.get("bones") == "soft"):
            raise InputError(f"parameter {name}: attached things and soft bones take its mean; give one number")
        if info.name.endswith(("scale_x", "scale_y", "scale_z")) and self.choices.get("contact"):
            raise InputError(f"parameter {name}: no derivative where it moves teeth that are in contact")

    @cached_property
    def _settling(self) -> FaceDerivatives:
        """The scene in which the neutral face settles, with the factored Hessian there."""
        return differentiate(self._rest(self._settling_scene(self.on_wraps)), accuracy=self.accuracy)

    def _settling_scene(self, parameters: Parameters) -> Scene:
        return neutral_scene(self.head, parameters, **self.choices)

    def _differentiate_frame(self, weights: Floats | Floats32) -> FaceDerivatives:
        """Solve a frame and factor its Hessian; the latest is kept."""
        key = np.asarray(weights, dtype=np.float64).tobytes()
        if key not in self._frames:
            self._frames.clear()
            frame = differentiate(self._rest(self.scene(weights)), accuracy=self.accuracy)
            if not frame.answer.is_balanced:
                raise InputError(f"the frame does not converge ({frame.answer.reason})")
            self._frames[key] = frame
        return self._frames[key]

    def _shifted(self, parameters: Parameters, moved: Floats | float = 0.0) -> Face:
        """Return the face under other p, which has settled as this one, moved by vertices (k, 3) [mm]."""
        settled = self.settled()
        positions = settled.positions + moved
        motion = self.head.skin_from_wrap @ (positions - settled.positions)[: len(self.head.bone)]
        face = replace(self, parameters=parameters, per="wraps")
        return face.settled_as(replace(settled, positions=positions, displacement=settled.displacement + motion))


def _check_exact(*linear: FaceDerivatives) -> None:
    if not all(each.is_exact for each in linear):
        raise InputError("the face is no strict minimum of its energy here, and has no derivative")


def _pad(wrap: Floats, scene: Scene) -> Floats:
    """Extend a field of the skin wrap, the scene's first vertices, by zero."""
    whole = np.zeros_like(scene.vertices)
    whole[: len(wrap)] = wrap
    return whole


def _hold_contact(scene: Scene, linear: FaceDerivatives) -> Scene:
    """Put the pairs that are pressed at an answer in the place of a scene's Contact."""
    others = (term for term in scene.terms if not isinstance(term, Contact))
    return replace(scene, terms=(*others, *linear.tangent.scene.of(Gaps)))
