"""One identity of a corpus: fit the head, then simulate each frame by projective dynamics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..lhm.errors import SoftdecaError
from ..lhm.head import LayeredHead
from ..lhm.identities import IdentitySpace
from ..lhm.mesh import Floats, Surface
from ..reference import Parameters, Prepared, Solution, facial_scene, prepare
from .plan import CorpusPlan
from .shard import ACCEPTED, Shard

Fit = Callable[[Surface], LayeredHead]
"""Makes a head of a neutral skin; picklable, such as functools.partial(fit_head, template)."""


def simulate_identity(plan: CorpusPlan, identity: int, space: IdentitySpace, fit: Fit) -> Shard:
    """All frames of one identity; a frame that fails, or the fit, becomes a status with its reason."""
    code, skin = plan.sample_identity(space, identity)
    frames = plan.frames_of(identity)
    weights = np.stack([plan.weights(frame.expression) for frame in frames])
    moved = np.tensordot(weights, space.expression_deltas(code), axes=1).astype(np.float32)
    parameters = [plan.parameters(frame.parameter_set) for frame in frames]
    try:
        simulate = _Simulator(plan, fit(skin))
    except SoftdecaError as error:
        found = [_Found.failed(f"head: {error}", skin)] * len(frames)
    else:
        found = [simulate(p, skin.vertices + delta) for p, delta in zip(parameters, moved, strict=True)]
    return Shard(
        skin=np.array(skin.vertices),
        code=np.asarray(code, dtype=np.float64),
        expressions=np.array([frame.expression for frame in frames]),
        parameter_sets=np.array([frame.parameter_set for frame in frames]),
        weights=weights,
        parameters=np.stack([p.vector(plan.parameter_names) for p in parameters]),
        moved=moved,
        corrected=np.stack([one.corrected for one in found]),
        status=np.array([one.status.encode("ascii", "replace")[:200] for one in found]),
        iterations=np.array([one.iterations for one in found]),
        gradient_ratio=np.array([one.gradient_ratio for one in found]),
        smallest_volume_ratio=np.array([one.smallest_volume_ratio for one in found]),
        inverted=np.array([one.inverted for one in found]),
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """One frame of a shard: see `Shard`."""

    corrected: np.ndarray
    status: str
    iterations: int = 0
    gradient_ratio: float = 0.0
    smallest_volume_ratio: float = 0.0
    inverted: int = 0

    @classmethod
    def failed(cls, status: str, skin: Surface) -> _Found:
        return cls(np.zeros(skin.vertices.shape, dtype=np.float16), status)


class _Simulator:
    """Solves frames of one head; keeps the last factorisation while the parameters stay the same."""

    def __init__(self, plan: CorpusPlan, head: LayeredHead):
        self._plan, self._head = plan, head
        self._prepared: tuple[Parameters, Prepared] | None = None

    def __call__(self, parameters: Parameters, blended: Floats) -> _Found:
        try:
            scene = facial_scene(self._head, parameters, blended)
            if self._prepared is None or self._prepared[0] != parameters:
                self._prepared = parameters, prepare(scene, solver="projective")
            solution = self._prepared[1].solve(
                scene, tolerance=self._plan.tolerance, max_iterations=self._plan.max_iterations
            )
        except SoftdecaError as error:
            return _Found.failed(f"scene: {error}", self._head.skin)
        wrap = solution.positions[: len(self._head.skin_wrap.vertices)]
        corrected = (self._head.skin_after(blended, wrap) - blended).astype(np.float16)
        norms = solution.history.gradient_norm
        return _Found(
            corrected=corrected,
            status=self._status(solution, corrected),
            iterations=solution.iterations,
            gradient_ratio=float(norms[-1] / norms[0]) if norms[0] > 0 else 0.0,
            smallest_volume_ratio=float(solution.volume_ratio.min()),
            inverted=int(np.count_nonzero(solution.volume_ratio <= 0.0)),
        )

    def _status(self, solution: Solution, corrected: np.ndarray) -> str:
        inverted = solution.volume_ratio <= 0.0
        soft = np.count_nonzero(inverted[: len(self._head.soft.tets)])
        if not solution.converged:
            return f"solver: {solution.reason}"
        if soft or inverted.mean() > self._plan.inverted_share:
            return f"{np.count_nonzero(inverted)} inverted tets, {soft} of them in soft tissue"
        if not np.isfinite(corrected).all():
            return "positions beyond the range of float16"
        return ACCEPTED
