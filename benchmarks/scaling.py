"""How time and memory of the simulator grow with the number of tets, over the levels of the template."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial

import numpy as np

from ..lhm import expressions
from ..reference import Parameters, facial_scene, projective
from .apart import apart, peak_megabytes
from .costs import megabytes
from .floor import factor_bytes
from .throughput import REFERENCE, default_head
from .traces import ACCURACY, Stopwatch, traced_to_itself

GROWING = ("prepare_seconds", "solve_seconds", "iteration_ms", "iterations", "megabytes", "factor_mb")


def measure_scaling(levels: Collection[int], expression: str, tell: Callable[[str], None]) -> dict:
    """A row per level, each in a process of its own, and the fitted exponents of what grows with the tets."""
    rows = []
    for level in levels:
        tell(f"scaling: level {level}")
        rows.append(apart(measure_level, level, expression))
    return {"expression": expression, "rows": rows, "exponents": exponents(rows)}


def measure_level(level: int, expression: str) -> dict:
    """Cost of a cold frame to 0.01 mm on the default head of a level; to be called in a process of its own."""
    space, code, head = default_head(level=level)
    targets = expressions.blend(space, code, expressions.parsed(expression))[0]
    make = partial(facial_scene, head, Parameters(), targets)
    held = megabytes(make)
    peak = peak_megabytes()
    watch = Stopwatch()
    prepared = projective.prepare(make())
    prepare_seconds = watch.lap()[0]
    solution, trace = traced_to_itself(prepared, tolerance=REFERENCE)
    iterations = trace.settled(ACCURACY)
    return {
        "level": level,
        "vertices": len(prepared.scene.vertices),
        "tets": len(prepared.scene.tets),
        "prepare_seconds": prepare_seconds,
        "iterations": iterations,
        "solve_seconds": trace.seconds_to(ACCURACY),
        "iteration_ms": 1e3 * float(np.median(np.diff(trace.seconds))),
        "megabytes": held,
        "peak_mb": peak,
        "factor_mb": factor_bytes(prepared) / 1e6,
        "converged": solution.converged,
    }


def exponents(rows: Sequence[Mapping]) -> dict[str, float]:
    """The slope of log(figure) over log(tets), by least squares, of each figure that all rows have."""
    found = {}
    for key in GROWING:
        values = [row[key] for row in rows]
        if len(rows) > 1 and all(value for value in values):
            found[key] = float(np.polyfit(np.log([row["tets"] for row in rows]), np.log(values), 1)[0])
    return found
