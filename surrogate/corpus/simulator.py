"""The simulator of one face of a corpus: settled and linearised once, then asked for expressions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...lhm.base.errors import SceneError, SoftdecaError
from ...lhm.base.geometry.bvh import TriangleTree
from ...lhm.base.mesh import Floats, Floats32, Surface
from ...lhm.head import LayeredHead
from ...reference import Scene, SettledFace, Solution, settle
from ...reference.face.derivatives import QUICK_ACCURACY, Analysis, FaceDerivatives, differentiate, spring_norm
from ...reference.face.settle import TARGET_OPTIONS
from .face import MOVED, Derivatives, Face, Person
from .mixture import INFOS, ParameterSet
from .people import People
from .plan import CorpusPlan
from .shard import ACCEPTED

UNDIFFERENTIATED = ("frequency", "damping", "strain_limit")


@dataclass(frozen=True, eq=False)
class Answer:
    """One frame: T - S (n, 3) [mm], and columns of `shard.Statics` on its solve."""

    corrected: np.ndarray
    status: str
    moved: tuple[float, float] = (0.0, 0.0)
    iterations: int = 0
    residual: float = 0.0
    smallest_volume_ratio: float = 0.0
    inverted: int = 0
    crossings: int = 0

    @classmethod
    def failed(cls, status: str, skin: Surface) -> Answer:
        """Make the answer of a frame that failed."""
        return cls(np.zeros(skin.vertices.shape, dtype=np.float16), status)


def settle_neutral(people: People, head: LayeredHead, parameters: ParameterSet) -> SettledFace:
    """Settle the neutral face under a parameter set; SceneError where it does not come to rest."""
    neutral = settle(head, parameters.parameters(head, people.mean), **TARGET_OPTIONS)
    if not neutral.converged:
        raise SceneError(str(neutral.reason))
    if reason := reject_moved(neutral.displacement):
        raise SceneError(reason)
    return neutral


def reject_moved(displacements: np.ndarray, farthest: float = MOVED) -> str:
    """Say why displacements [mm] are not kept in a corpus; empty where they are."""
    return "" if (np.abs(displacements) <= farthest).all() else f"a vertex moves farther than {farthest:g} mm"


@dataclass(frozen=True, eq=False)
class FaceSimulator:
    """The face of one person at rest under one parameter set, prepared for expressions.

    first_order (52, scene's vertices, 3) [mm]: how the tets move with each shape, from which expressions start.
    """

    plan: CorpusPlan
    person: Person
    parameters: ParameterSet
    linear: FaceDerivatives
    first_order: Floats

    @classmethod
    def of(
        cls, plan: CorpusPlan, people: People, person: Person, head: LayeredHead, parameters: ParameterSet
    ) -> FaceSimulator:
        """Settle and linearise a person's face; SceneError where it does not come to rest."""
        neutral = settle_neutral(people, head, parameters)
        linear = differentiate(neutral, accuracy=QUICK_ACCURACY, like=_last.get(people.name))
        _last.clear()
        _last[people.name] = linear.analysis
        return cls(plan, person, parameters, linear, linear.vertices_by_shapes(person.shapes))

    @property
    def head(self) -> LayeredHead:
        """The person's head."""
        return self.linear.face.head

    @property
    def neutral(self) -> SettledFace:
        """The settled face."""
        return self.linear.face

    def neutral_under(self, law: str) -> SettledFace:
        """Settle the face by another law; each law once."""
        if law not in self._by_law:
            self._by_law[law] = settle(self.head, self.neutral.parameters, law=law, **TARGET_OPTIONS)
        return self._by_law[law]

    @cached_property
    def _by_law(self) -> dict[str, SettledFace]:
        return {}

    @cached_property
    def derivatives(self) -> Derivatives:
        """Offset and responses of T - S."""
        offset = self.linear.offset + self.neutral.displacement
        responses = self.linear.skin_by_shapes(self.person.shapes, self.first_order) - self.person.shapes
        return Derivatives(offset, responses, self.linear.is_exact)

    def face(self, identity: int) -> Face:
        """Return the face as a corpus keeps it, of person number `identity`."""
        return Face(identity, self.person, self.parameters, self.neutral.displacement, self.derivatives)

    @cached_property
    def parameter_responses(self) -> dict[str, Floats]:
        """dT/du at w = 0 [mm], shape (n, 3), by each static parameter that varies, mapped to u in [-1, 1].

        But for the strain limit: where it is 1 the energy has kinks.
        """
        along = {name: self._along(name) for name in self.parameters.names if name not in UNDIFFERENTIATED}
        return self.linear.skin_by_parameters(along) if along else {}

    def _along(self, name: str) -> float | Floats:
        """Return the change of a parameter [its unit] per unit of its value mapped to [-1, 1]."""
        info, value = INFOS[name], np.asarray(getattr(self.neutral.parameters, name))
        change = value * np.log(info.high / info.low) if info.log else np.full(value.shape, info.high - info.low)
        return 0.5 * change if value.ndim else float(0.5 * change)

    def expression(self, weights: Floats | Floats32) -> Floats:
        """Blend S [mm], shape (n, 3), of weights (52,)."""
        return self.person.skin.vertices + np.tensordot(weights, self.person.shapes, axes=1)

    def scene(self, weights: Floats | Floats32) -> Scene:
        """Make the scene of an expression."""
        return self.neutral.scene(self.expression(weights))

    def solve(self, weights: Floats | Floats32) -> Solution:
        """Solve an expression, begun at the first-order answer.

        By the PD matrix, whose factor stays in a core's cache; where that fails, in the tangent's metric.
        """
        scene = self.scene(weights)
        start = self.linear.answer.positions + np.tensordot(weights, self.first_order, axes=1)
        stop = self.plan.tolerance * spring_norm(scene)
        spent = 0
        for metric in (None, self.linear.tangent):
            solution = self.linear.prepared.solve(
                scene, start=start, absolute=stop, max_iterations=self.plan.max_iterations, metric=metric,
                untangle=False,
            )  # fmt: skip
            spent += solution.iterations
            if solution.converged:
                break
            start = solution.positions if np.isfinite(solution.positions).all() else start
        return replace(solution, iterations=spent)

    def corrected(self, weights: Floats | Floats32, positions: Floats) -> Floats:
        """Return T - S [mm], shape (n, 3), of a scene's positions."""
        expression = self.expression(weights)
        return self.neutral.skin_after(expression, positions) - expression

    def static(self, weights: Floats | Floats32) -> Answer:
        """Simulate one static frame; a failure is a status."""
        try:
            return self.answer(weights, self.solve(weights))
        except SoftdecaError as error:
            return Answer.failed(f"scene: {error}", self.person.skin)

    def answer(self, weights: Floats | Floats32, solution: Solution) -> Answer:
        """Make the answer that a corpus keeps of a solution."""
        corrected = self.corrected(weights, solution.positions).astype(np.float16)
        inverted = solution.volume_ratio <= 0.0
        moved = np.linalg.norm(corrected[self._in_face].astype(np.float64), axis=1)
        crossings, wrap = 0, self.head.skin_wrap
        if np.isfinite(solution.positions).all():
            tree = TriangleTree(solution.positions[: len(wrap.vertices)], wrap.triangles)
            crossings = len(tree.self_crossings())
        return Answer(
            corrected=corrected,
            status=self._status(solution, inverted, corrected),
            moved=(float(moved.mean()), float(np.percentile(moved, 95.0))),
            iterations=solution.iterations,
            residual=float(solution.history.gradient_norm[-1]) / self._springs,
            smallest_volume_ratio=float(solution.volume_ratio.min()),
            inverted=int(np.count_nonzero(inverted)),
            crossings=crossings,
        )

    @cached_property
    def _in_face(self) -> np.ndarray:
        """Whether each skin vertex is of the face, shape (n,); all where the head does not tell."""
        n = len(self.head.bone)
        mask = np.asarray(self.head.regions.get("face", np.ones(n, dtype=bool)), dtype=np.float64)
        return np.asarray(self.head.skin_from_wrap @ mask) > 0.5

    @cached_property
    def _springs(self) -> float:
        return spring_norm(self.linear.prepared.scene)

    def _status(self, solution: Solution, inverted: np.ndarray, corrected: np.ndarray) -> str:
        soft = np.count_nonzero(inverted[: len(self.head.soft.tets)])
        if not solution.converged:
            return f"solver: {solution.reason}"
        if soft or inverted.mean() > self.plan.inverted_share:
            return f"{np.count_nonzero(inverted)} inverted tets, {soft} of them in soft tissue"
        return reject_moved(corrected) or ACCEPTED


_last: dict[str, Analysis] = {}
"""The last face of a process: what was analysed of its matrices, the same for all heads of a template, serves again."""
