"""Error of the surrogate and of the baselines on frames that training has not seen, and time per frame."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats
from ...reference import Parameters
from .baselines import Ridge
from .runtime import BoundHypernetwork, HypernetworkSurrogate
from .samples import Samples


@dataclass(frozen=True)
class VertexErrors:
    """Distances to the simulator's vertices [mm] over all frames, and the mean of each frame."""

    mean: float
    p95: float
    max: float
    per_frame: tuple[float, ...]

    @classmethod
    def of(cls, answers, samples: Samples) -> VertexErrors:
        """Of answers [mm], shape (N, n, 3)."""
        distance = np.linalg.norm(np.asarray(answers, dtype=np.float64) - samples.simulated, axis=2)
        per_frame = tuple(float(value) for value in distance.mean(axis=1))
        return cls(float(distance.mean()), float(np.percentile(distance, 95.0)), float(distance.max()), per_frame)


@dataclass(frozen=True)
class Evaluation:
    """Errors against the simulator [mm] and median times [ms] on one thread.

    blendshapes is T = S_t; `gain` is its mean error over the surrogate's; bind_ms is L(p, h) of one identity and
    material, frame_ms a frame of the surrogate (with its blendshapes), blend_ms one of the blendshapes alone.
    """

    frames: int
    identities: int
    surrogate: VertexErrors
    ridge: VertexErrors
    blendshapes: VertexErrors
    bind_ms: float
    frame_ms: float
    blend_ms: float

    @property
    def gain(self) -> float:
        """How many times larger the blendshapes' mean error is than the surrogate's."""
        return self.blendshapes.mean / self.surrogate.mean


def evaluate(surrogate: HypernetworkSurrogate, test: Samples, training: Samples, *, expressions: Floats) -> Evaluation:
    """Run every test frame through the run time; `training` frames fit the ridge regression.

    expressions: the 52 shapes' displacements [mm] of any identity, shape (52, n, 3), for the times of a frame.
    Raises InputError if both splits share an identity, and what `HypernetworkSurrogate.bind` raises.
    """
    shared = np.intersect1d(test.identity, training.identity)
    if shared.size:
        raise InputError(f"evaluate: identity {shared[0]} is in training and test; the errors would mean nothing")
    answers, binding = np.empty_like(test.blended), []
    for k in range(len(test)):
        begin = time.perf_counter()
        rig = _bind(surrogate, test, k, expressions)
        binding.append(time.perf_counter() - begin)
        answers[k] = rig.frame(test.weights[k], blended=test.blended[k])
    rig = _bind(surrogate, test, 0, expressions)
    return Evaluation(
        frames=len(test),
        identities=len(np.unique(test.identity)),
        surrogate=VertexErrors.of(answers, test),
        ridge=VertexErrors.of(Ridge.fit(training).predict(test), test),
        blendshapes=VertexErrors.of(test.blended, test),
        bind_ms=1e3 * float(np.median(binding)),
        frame_ms=_median_ms(rig.frame, test),
        blend_ms=_median_ms(rig.blend, test),
    )


def _bind(surrogate: HypernetworkSurrogate, samples: Samples, k: int, expressions: Floats) -> BoundHypernetwork:
    values = dict(zip(samples.parameter_names, samples.parameters[k], strict=True))
    # The neutral skin only enters frames without `blended`.
    skin = samples.reference
    return surrogate.bind(skin, samples.codes[k], Parameters(**values), expressions=expressions)


def _median_ms(step, samples: Samples, repeats: int = 200) -> float:
    times = []
    for k in range(repeats):
        weights = samples.weights[k % len(samples)]
        begin = time.perf_counter()
        step(weights)
        times.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(times))
