"""The simulator's benchmark: speed, error against time, what pieces cost, and growth; run -> JSON -> HTML."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..lhm.errors import InputError
from ..lhm.files.alone import alone_in
from ..lhm.files.atomic import write_whole
from ..lhm.progress import OnProgress
from ..lhm.template import LEVELS
from . import machine
from .minimal_model import measure_minimal
from .scaling import measure_scaling
from .simulator_report import gates, page
from .throughput import measure_throughput
from .traces import Stopwatch
from .work_precision import measure_precision

PARTS = ("throughput", "precision", "minimal", "scaling")


@dataclass(frozen=True)
class SimulatorConfig:
    """Which parts to measure, on what, and where the report goes; InputError for an unknown part or too few frames.

    `seeds` are those of the cold frames' identities and parameters, `frames` the length of the sequence at 60 Hz.
    """

    parts: tuple[str, ...] = PARTS
    out: Path = Path("out/simulator")
    seeds: tuple[int, ...] = (0, 1, 2)
    frames: int = 49
    precision: tuple[str, ...] = ("jawOpen", "mouthSmileLeft+mouthSmileRight", "mouthPucker")
    minimal: tuple[str, ...] = (
        "jawOpen*0.7+mouthSmileLeft+mouthSmileRight",
        "mouthPressLeft+mouthPressRight+mouthRollLower+mouthRollUpper+eyeBlinkLeft+eyeBlinkRight",
    )
    scaling: str = "jawOpen*0.7+mouthSmileLeft+mouthSmileRight"
    levels: tuple[int, ...] = tuple(LEVELS)

    def __post_init__(self):
        unknown = [part for part in self.parts if part not in PARTS]
        if unknown or not self.parts:
            raise InputError(f"parts: {', '.join(unknown) or 'none'}; there are {', '.join(PARTS)}")
        if self.frames < 13 or not self.seeds:
            raise InputError(
                f"frames: {self.frames}, expected 13 or more; seeds: {len(self.seeds)}, expected 1 or more"
            )


def run_simulator(config: SimulatorConfig, progress: OnProgress) -> dict:
    """Measure the parts; write results.json, its plots and index.html into the folder; return the results."""
    with alone_in(config.out, "benchmark"):
        before = machine.describe()
        watch = Stopwatch()
        results: dict = {
            "title": "the projective-dynamics simulator",
            "parts": list(config.parts),
            "seeds": list(config.seeds),
            "seconds": {},
        }
        for number, part in enumerate(config.parts):
            results[part] = _measure(config, part, _teller(progress, number / len(config.parts)))
            results["seconds"][part] = watch.lap()[0]
        results["machine"] = before | {"load_at_end": round(os.getloadavg()[0], 2)}
        results["gates"] = gates(results)
        write_whole(config.out / "results.json", json.dumps(results, indent=1, allow_nan=False).encode())
        write_whole(config.out / "index.html", page(results).encode())
    return results


def _measure(config: SimulatorConfig, part: str, tell: Callable[[str], None]) -> dict:
    if part == "throughput":
        return measure_throughput(config.seeds, config.frames, tell)
    if part == "precision":
        return measure_precision(config.precision, tell)
    if part == "minimal":
        return measure_minimal(config.minimal, tell)
    return measure_scaling(config.levels, config.scaling, tell)


def _teller(progress: OnProgress, done: float) -> Callable[[str], None]:
    return lambda text: progress(f"simulator: {text}", done)
