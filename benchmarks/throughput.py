"""Frames per second of the simulator: cold frames, a sequence, a worker's memory, and the floor of an iteration."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..lhm import expressions, fit_head, identities, load_template
from ..lhm.head import LayeredHead
from ..lhm.identities.space import LinearSpace
from ..lhm.mesh import Floats
from ..lhm.template import DEFAULT_LEVEL
from ..reference import Parameters, Scene, facial_scene, prepare, projective
from ..reference.sequence import TOLERANCE, Sequence
from ..surrogate.corpus.mixture import FEW
from . import floor
from .apart import apart, held_megabytes, peak_megabytes
from .costs import timed
from .traces import ACCURACY, Stopwatch, Trace, farthest, traced_to_itself

REFERENCE = 1e-9
"""Tolerance of tight runs, far below what 0.01 mm needs."""
MARGIN = 0.5
"""Of the tolerance that the hardest frame of a kind needs, what all of that kind are run with."""
RATE = 60.0
"""[Hz] of the sequence."""
CHECKED_EVERY = 12
"""Frames of the sequence between two that are compared with a tight run."""
DEFAULT_P = "default p"
HALVINGS = 4
"""Of the sequence's own tolerance, to be tried at most."""
KINDS = {
    DEFAULT_P: (),
    "the corpus' p at random": FEW,
    "every p at random": tuple(info.name for info in Parameters.infos()),
}
"""Which parameters are drawn, each over its whole range; the others are default."""


@dataclass(frozen=True, eq=False)
class ColdFrame:
    """An expression of a head of its own with parameters of its own."""

    seed: int
    head: LayeredHead
    parameters: Parameters
    targets: Floats


def default_head(seed: int = 0, level: int = DEFAULT_LEVEL) -> tuple[LinearSpace, Floats, LayeredHead]:
    """The identity space, code and fitted head of one seed of the default space."""
    space = identities.Anny()
    code, skin = space.sample(np.random.default_rng(seed))
    return space, code, fit_head(load_template(space, level=level), skin)


def cold_frames(seeds: Collection[int], kinds: Collection[str] = tuple(KINDS)) -> dict[str, list[ColdFrame]]:
    """By kind, a lively frame of talk of each seed's head, with parameters of that kind."""
    frames: dict[str, list[ColdFrame]] = {kind: [] for kind in kinds}
    for seed in seeds:
        space, code, head = default_head(seed)
        weights = expressions.conversation(np.random.default_rng([seed, 2]), 120)
        targets = expressions.blend(space, code, weights[np.argmax(weights.sum(axis=1))])[0]
        for kind in kinds:
            rng = np.random.default_rng([seed, 1])
            drawn = Parameters(**{name: Parameters.info(name).sample(rng) for name in KINDS[kind]})
            frames[kind].append(ColdFrame(seed, head, drawn, targets))
    return frames


def measure_cold(kind: str, frames: list[ColdFrame], tell: Callable[[str], None]) -> dict:
    """Time of scene, preparation and solve to 0.01 mm, at the tolerance that the hardest frame needs for that."""
    traces, truths = [], []
    for frame in frames:
        tell(f"tight runs: {kind}, identity {frame.seed}")
        solution, trace = traced_to_itself(prepare(_scene(frame)), tolerance=REFERENCE)
        traces.append(trace)
        truths.append(solution.positions)
    tolerance = _sufficient(traces)
    tell(f"cold frames: {kind}")
    rows = [_cold_row(*pair, tolerance) for pair in zip(frames, truths, strict=True)]
    return {"kind": kind, "tolerance": tolerance, "rows": rows}


def _scene(frame: ColdFrame) -> Scene:
    return facial_scene(frame.head, frame.parameters, frame.targets)


def _sufficient(traces: list[Trace]) -> float:
    needed = [trace.tolerance_for(ACCURACY) for trace in traces]
    return _rounded_down(MARGIN * min(REFERENCE if need is None else need for need in needed))


def _rounded_down(value: float) -> float:
    power = math.floor(math.log10(value))
    return float(f"{math.floor(value / 10.0**power)}e{power}")


def _cold_row(frame: ColdFrame, truth: Floats, tolerance: float) -> dict:
    solution, cost = timed(partial(_scene, frame), tolerance)
    return {"seed": frame.seed, **cost, "error_mm": farthest(solution.positions, truth)}


def measure_warm(frames: int, tell: Callable[[str], None]) -> dict:
    """Time per frame of talk at 60 Hz on the default head, each started from the last; every twelfth is checked.

    The tolerance is that of `Sequence`, halved until the checked frames are within 0.01 mm.
    """
    space, code, head = default_head()
    weights = expressions.conversation(np.random.default_rng(3), frames, rate=RATE)
    targets = expressions.blend(space, code, weights)
    checked = range(0, frames, CHECKED_EVERY)
    tell("a sequence: tight runs")
    prepared = prepare(facial_scene(head, Parameters(), targets[0]))
    truths: dict[int, Floats] = {}
    for t in checked:
        start = None if t == 0 else truths[t - CHECKED_EVERY]
        truths[t] = prepared.solve(
            facial_scene(head, Parameters(), targets[t]), start=start, tolerance=REFERENCE
        ).positions
    for halvings in range(HALVINGS + 1):
        tolerance = TOLERANCE / 2**halvings
        tell(f"a sequence: its frames, at tolerance {tolerance:.1e}")
        rows, errors = _sequence_rows(head, targets, truths, tolerance)
        if max(errors) <= ACCURACY:
            break
    return {"tolerance": tolerance, "rows": rows, "errors_mm": errors}


def _sequence_rows(
    head: LayeredHead, targets: Floats, truths: Mapping[int, Floats], tolerance: float
) -> tuple[list[dict], list[float]]:
    """Time and iterations of each frame but the first, and the errors [mm] of those that have a truth."""
    running = Sequence(head, Parameters(), time_step=1.0 / RATE, tolerance=tolerance)
    running.frame(targets[0])
    rows, errors = [], []
    for t in range(1, len(targets)):
        watch = Stopwatch()
        solution = running.frame(targets[t])
        wall, cpu = watch.lap()
        inverted = int(np.count_nonzero(solution.volume_ratio <= 0.0))
        rows.append({"seconds": wall, "cpu_seconds": cpu, "iterations": solution.iterations, "inverted_tets": inverted})
        if t in truths:
            errors.append(farthest(solution.positions, truths[t]))
    return rows, errors


def worker_memory() -> dict[str, float]:
    """Memory [MB] of a process that fits a head and simulates a frame of it: with its libraries, the fit, and at all.

    To be called in a process of its own.
    """
    loaded = held_megabytes()
    frame = cold_frames([0], [DEFAULT_P])[DEFAULT_P][0]
    fitted = peak_megabytes()
    prepare(_scene(frame)).solve(max_iterations=30)
    return {"loaded": loaded, "fit": fitted, "peak": peak_megabytes()}


def measure_floor(tell: Callable[[str], None]) -> dict:
    """What an iteration on the default head must read, at what bandwidth, and how long it takes beside that."""
    tell("the floor of an iteration")
    frame = cold_frames([0], [DEFAULT_P])[DEFAULT_P][0]
    prepared = projective.prepare(_scene(frame))
    solution = prepared.solve(tolerance=1e-5)
    iteration = float(np.median(np.diff(solution.history.time)))
    factor, tets, bandwidth = floor.factor_bytes(prepared), floor.tet_bytes(prepared), floor.bandwidth()
    # Forward and backward substitution each read the factor once, for all three components together.
    least = (2 * factor + tets) / bandwidth
    return {
        "bandwidth_gb_s": bandwidth / 1e9,
        "factor_mb": factor / 1e6,
        "tets_mb": tets / 1e6,
        "floor_ms": 1e3 * least,
        "ratio": iteration / least,
        "split_ms": floor.split(prepared, solution.positions, iteration),
        "evaluations_per_iteration": solution.detail["evaluations"] / max(solution.iterations, 1),
    }


def measure_throughput(seeds: Collection[int], frames: int, tell: Callable[[str], None]) -> dict:
    """All figures of speed on the default template."""
    cold = [measure_cold(kind, found, tell) for kind, found in cold_frames(seeds).items()]
    warm = measure_warm(frames, tell)
    tell("the memory of a worker")
    return {"cold": cold, "warm": warm, "worker_mb": apart(worker_memory), "floor": measure_floor(tell)}
