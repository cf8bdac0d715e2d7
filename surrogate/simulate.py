"""One identity of a corpus: fit the head, then simulate each frame by projective dynamics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..lhm.errors import SoftdecaError
from ..lhm.head import LayeredHead
from ..lhm.mesh import Floats, Surface
from ..reference import Parameters, Prepared, facial_scene, prepare
from .plan import CorpusPlan, IdentitySpace
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
    count, shape = len(frames), skin.vertices.shape
    corrected = np.zeros((count, *shape), dtype=np.float16)
    status = [""] * count
    iterations, ratio, volume = np.zeros(count, dtype=np.int64), np.zeros(count), np.zeros(count)
    try:
        head = fit(skin)
    except SoftdecaError as error:
        status = [f"head: {error}"] * count
    else:
        simulate = _Simulator(plan, head)
        for k in range(count):
            try:
                corrected[k], status[k], iterations[k], ratio[k], volume[k] = simulate(
                    parameters[k], skin.vertices + moved[k]
                )
            except SoftdecaError as error:
                status[k] = f"scene: {error}"
    return Shard(
        skin=np.array(skin.vertices),
        code=np.asarray(code, dtype=np.float64),
        expressions=np.array([frame.expression for frame in frames]),
        parameter_sets=np.array([frame.parameter_set for frame in frames]),
        weights=weights,
        parameters=np.stack([p.vector(plan.parameter_names) for p in parameters]),
        moved=moved,
        corrected=corrected,
        status=np.array([text.encode("ascii", "replace")[:200] for text in status]),
        iterations=iterations,
        gradient_ratio=ratio,
        smallest_volume_ratio=volume,
    )


class _Simulator:
    """Solves frames of one head; keeps the last factorisation while the parameters stay the same."""

    def __init__(self, plan: CorpusPlan, head: LayeredHead):
        self._plan, self._head = plan, head
        self._prepared: tuple[Parameters, Prepared] | None = None

    def __call__(self, parameters: Parameters, blended: Floats) -> tuple[np.ndarray, str, int, float, float]:
        """T - S_t [mm] as float16, status, iterations, gradient norm over its start, smallest volume ratio."""
        head, plan = self._head, self._plan
        scene = facial_scene(head, parameters, blended)
        if self._prepared is None or self._prepared[0] != parameters:
            self._prepared = parameters, prepare(scene, solver="projective")
        solution = self._prepared[1].solve(scene, tolerance=plan.tolerance, max_iterations=plan.max_iterations)
        wrap = solution.positions[: len(head.skin_wrap.vertices)]
        corrected = (head.skin_after(blended, wrap) - blended).astype(np.float16)
        norms = solution.history.gradient_norm
        smallest = float(solution.volume_ratio.min())
        inverted = int(np.count_nonzero(solution.volume_ratio <= 0.0))
        if not solution.converged:
            status = f"solver: {solution.reason}"
        elif inverted:
            status = f"{inverted} inverted tets"
        elif not np.isfinite(corrected).all():
            status = "positions beyond the range of float16"
        else:
            status = ACCEPTED
        ratio = float(norms[-1] / norms[0]) if norms[0] > 0 else 0.0
        return corrected, status, solution.iterations, ratio, smallest
