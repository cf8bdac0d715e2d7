"""A take of ARKit weights simulated on a head, frame after frame: log, results, export, preview; it can go on later."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from ..lhm.base.errors import InputError, SoftdecaError
from ..lhm.base.files.resumable import lock_folder
from ..lhm.base.mesh import Floats
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take, rotations
from ..lhm.head import LayeredHead
from ..reference import Parameters, Reason, Sequence, SettledFace, Solution, settle
from ..reference.face.dynamics import extrapolate_turns, find_pivot
from ..reference.face.sequence import TOLERANCE
from .play import Output, PlayedTake, blend_linearly
from .preview import check_preview
from .store import TakeStore, digest


@dataclass(frozen=True)
class TakeConfig(Output):
    """What is made of a take, and how; `choices` go to `facial_scene`."""

    tolerance: float = TOLERANCE
    choices: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class TakeResult:
    """Frames simulated in all, those that failed with their reason, the files written, and the log's medians.

    `neutral`: why settling the neutral face under p stopped, a Reason's name; without CONVERGED it failed too.
    """

    frames: int
    failed: tuple[tuple[int, str], ...]
    files: tuple[Path, ...]
    median_seconds: float
    median_iterations: float
    neutral: str = Reason.CONVERGED.name


def run_take(
    config: TakeConfig,
    head: LayeredHead,
    deltas: Floats,
    take: Take,
    parameters: Parameters,
    progress: OnProgress,
) -> TakeResult:
    """Simulate what is missing, and write config.out's files: take.vtkhdf or take.glb, preview, log.jsonl.

    deltas: what each expression adds to the head's skin [mm], shape (52, n, 3); take: evenly spaced frames, `rate`
    apart. The neutral face settles under p first, and expressions move that one; with dynamics, the take's head
    rotation shakes it where there is one. A frame that does not converge keeps what was reached, one that cannot be
    simulated its blendshapes; both are listed. InputError if another run works in the folder, if it holds another take,
    and for a take without head rotation that is to be `turned`.
    """
    check_preview(config.preview)
    if config.turned and take.head is None:
        raise InputError("turned: the take has no head rotation")
    with lock_folder(config.out, "simulate"):
        store = TakeStore(config.out, _manifest(config, head, deltas, take, parameters))
        neutral, reason = _neutral(config, head, parameters, store, progress)
        _simulate(config, neutral, deltas, take, store, progress)
        log = store.log()
        # The wrap ends below the neck: of a bust it is the head.
        framed = head.skin_wrap.vertices
        played = PlayedTake(
            head.skin, deltas, find_pivot(head), framed, take, lambda numbers: map(store.moved, numbers)
        )
        files = [played.export(config, progress)]
        if config.preview != "none":
            files.append(played.show(config, "simulated", progress))
    failed = tuple((row["frame"], row["reason"]) for row in log if row["reason"] != "CONVERGED")
    seconds, iterations = (float(np.median([row[key] for row in log])) for key in ("seconds", "iterations"))
    return TakeResult(len(log), failed, (*files, config.out / "log.jsonl"), seconds, iterations, reason)


def _manifest(
    config: TakeConfig, head: LayeredHead, deltas: Floats, take: Take, parameters: Parameters
) -> dict[str, Any]:
    """What decides the frames: a folder whose manifest differs holds another take."""
    values = [np.asarray(getattr(parameters, f.name)) for f in fields(parameters)]
    return {
        "head": digest(head.skin.vertices, head.skin.triangles, head.vertices, head.tets, head.bone),
        "expressions": digest(deltas),
        "weights": digest(take.weights),
        "first time": float(take.times[0]),
        "frames": len(take.times),
        "rate": float(take.rate),
        "parameters": digest(*values),
        "neutral": "settled under p",
        "dynamic": "flesh lags" if config.dynamic else False,
        "head rotation": digest(take.head) if config.dynamic and take.head is not None else None,
        "tolerance": config.tolerance,
        "choices": json.loads(json.dumps(config.choices)),
    }


def _neutral(
    config: TakeConfig, head: LayeredHead, parameters: Parameters, store: TakeStore, progress: OnProgress
) -> tuple[SettledFace, str]:
    """The neutral face settled under p, from the folder where it is there, and why settling stopped."""
    kept = store.neutral()
    if kept is None:
        progress("settling: neutral face", 0.0)
        found = settle(head, parameters, **config.choices)
        kept = {
            "positions": found.positions,
            "displacement": found.displacement,
            "reason": np.array(found.reason.name),
        }
        store.keep_neutral(kept)
        progress("settling: neutral face", 1.0)
    choices = dict(config.choices)
    return SettledFace(head, parameters, kept["positions"], kept["displacement"], choices=choices), str(kept["reason"])


def _simulate(
    config: TakeConfig,
    neutral: SettledFace,
    deltas: Floats,
    take: Take,
    store: TakeStore,
    progress: OnProgress,
) -> None:
    step = 1.0 / take.rate
    head = neutral.head
    sequence = Sequence.from_face(neutral, time_step=step, dynamic=config.dynamic, tolerance=config.tolerance)
    done, sequence.state = store.done()
    count = len(take.times)
    bases = rotations(take.head) if config.dynamic and take.head is not None else np.array([np.eye(3)] * count)
    for number in range(done, count):
        begin = time.perf_counter()
        targets = blend_linearly(head.skin, deltas, take.weights[number])
        skin, record = _frame(sequence, neutral, targets, bases[number:])
        record = {"frame": number, "time": float(take.times[number]), **record}
        record["seconds"] = round(time.perf_counter() - begin, 4)
        if sequence.state is None:
            raise SoftdecaError(f"frame {number}: {record['reason']}; nothing to begin from")
        store.add(number, (skin - head.skin.vertices).astype(np.float32), record, sequence.state)
        progress(f"simulation: frame {number + 1} of {count}", (number + 1) / count)


def _frame(sequence: Sequence, neutral: SettledFace, targets: Floats, bases: Floats) -> tuple[Floats, dict[str, Any]]:
    """The next frame's skin [mm], and its line of the log; bases: how the head is turned in it and in those to come."""
    try:
        if sequence.recurrence is not None and sequence.state is None:
            sequence.begin(targets, base=extrapolate_turns(bases))
        solution = sequence.frame(targets, base=bases[0])
    except SoftdecaError as error:
        return neutral.targets(targets), _record(str(error))
    if not np.isfinite(solution.positions).all():
        return neutral.targets(targets), _record(solution.reason.name, solution)
    return sequence.skin(targets, solution), _record(solution.reason.name, solution)


def _record(reason: str, solution: Solution | None = None) -> dict[str, Any]:
    """Iterations, energy [µJ], residual (gradient norm [mN]), inverted tets, contacts; None where there is none."""
    row: dict[str, Any] = dict.fromkeys(("energy", "residual", "inverted", "contacts_before", "contacts"))
    if solution is not None:
        row["energy"] = _number(solution.energy)
        row["residual"] = _number(solution.history.gradient_norm[-1])
        row["inverted"] = int(np.count_nonzero(solution.volume_ratio <= 0.0))
        row["contacts_before"] = _number(solution.detail.get("contact_pairs_before"))
        row["contacts"] = _number(solution.detail.get("contact_pairs_after"))
    return {"iterations": 0 if solution is None else solution.iterations, "reason": reason, **row}


def _number(value: float | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None
