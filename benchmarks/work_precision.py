"""Error against time: projective dynamics, Newton on the same energy, and libigl's ARAP on its own."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from ..lhm import expressions
from ..lhm.mesh import Floats
from ..reference import Parameters, Scene, facial_scene, prepare
from ..reference.projective.solver import Method
from . import arap
from .throughput import default_head
from .traces import TIGHT, Stopwatch, Trace, farthest, traced

ACCURACIES = tuple(float(f"{digit}e{power}") for power in range(0, -7, -1) for digit in (3, 1))[1:]
"""[mm], from 1 to 1e-6."""
BELOW = 0.1
"""[mm] at and below which our solver is to be ahead."""
OURS = "PD, L-BFGS"
NEWTON = "FEniCSx Newton"
IGL = "libigl ARAP"
LABELS = {"lbfgs": OURS, "plain": "PD, plain", "anderson": "PD, Anderson"}
FACE, ARAP = "the face's energy (Eq. 15)", "ARAP's energy, same tets"
PLAIN_ENOUGH = 0.003
"""Plain projective dynamics is stopped here [mm]: it needs thousands of iterations for more."""
PLAIN_LIMIT = 1500


@dataclass(frozen=True, eq=False)
class Curve:
    """One solver on one scene: seconds of preparation, and its trace."""

    energy: str
    expression: str
    label: str
    prepare_seconds: float
    trace: Trace

    def row(self) -> dict:
        """As a row of the results: errors [mm] over seconds of the solve, and times to each of `ACCURACIES`."""
        return {
            "energy": self.energy,
            "expression": self.expression,
            "label": self.label,
            "prepare_seconds": self.prepare_seconds,
            "seconds": list(self.trace.seconds),
            "error_mm": list(self.trace.error),
            "seconds_to": [self.trace.seconds_to(accuracy) for accuracy in ACCURACIES],
        }


def measure_precision(names: Sequence[str], tell: Callable[[str], None]) -> dict:
    """Curves of every solver on every expression of the default head; medians; what was not installed."""
    space, code, head = default_head()
    curves: list[dict] = []
    agreement: dict[str, float] = {}
    skipped = [] if arap.installed() else [f"{IGL}: libigl is not installed (softdeca[bench])"]
    if importlib.util.find_spec("dolfinx") is None:
        skipped.append(f"{NEWTON}: dolfinx is not installed")
    for name in names:
        targets = expressions.blend(space, code, expressions.parsed(name))[0]
        face = facial_scene(head, Parameters(), targets)
        handles = arap.Handles.of(head, face, targets)
        for energy, scene in ((FACE, face), (ARAP, handles.scene(face))):
            tell(f"{name}, {energy}: a tight run")
            truth = prepare(scene).solve(tolerance=TIGHT).positions
            for method in get_args(Method):
                tell(f"{name}, {energy}: {LABELS.get(method, method)}")
                curves.append(_projective(energy, name, scene, method, truth).row())
            if importlib.util.find_spec("dolfinx") is not None:
                tell(f"{name}, {energy}: {NEWTON}")
                curve, apart = _newton(energy, name, scene, truth)
                curves.append(curve.row())
                agreement[f"{NEWTON}, {name}, {energy}"] = apart
        if arap.installed():
            tell(f"{name}, {ARAP}: {IGL}")
            answer, prepared, trace, own = arap.solved_by_igl(scene, handles, truth)
            curves.append(Curve(ARAP, name, IGL, prepared, trace).row() | {"own_error_mm": own.tolist()})
            agreement[f"{IGL}, {name}, {ARAP}"] = farthest(answer, truth)
    return {"accuracies_mm": list(ACCURACIES), "curves": curves, "agreement_mm": agreement, "skipped": skipped} | {
        "handles": len(handles.vertices),
        "most_of_igl": arap.MAX_ITERATIONS,
        "medians": medians(curves),
    }


def _projective(energy: str, name: str, scene: Scene, method: str, truth: Floats) -> Curve:
    watch = Stopwatch()
    prepared = prepare(scene, method=method)
    seconds = watch.lap()[0]
    if method == "plain":
        _, trace = traced(prepared, truth, enough=PLAIN_ENOUGH, max_iterations=PLAIN_LIMIT)
    else:
        _, trace = traced(prepared, truth)
    return Curve(energy, name, LABELS.get(method, method), seconds, trace)


def _newton(energy: str, name: str, scene: Scene, truth: Floats) -> tuple[Curve, float]:
    # Forms are compiled once per kind of scene and machine: no part of a preparation.
    prepare(scene, solver="fenicsx")
    watch = Stopwatch()
    prepared = prepare(scene, solver="fenicsx")
    seconds = watch.lap()[0]
    solution, trace = traced(prepared, truth)
    return Curve(energy, name, NEWTON, seconds, trace), farthest(solution.positions, truth)


def medians(curves: Sequence[Mapping]) -> list[dict]:
    """Per energy and solver, the median over expressions of the seconds to each accuracy, None where one has none.

    `solve` counts from prepared scenes, `total` with preparation.
    """
    found: dict[tuple[str, str], list[Mapping]] = {}
    for curve in curves:
        found.setdefault((curve["energy"], curve["label"]), []).append(curve)
    return [
        {
            "energy": energy,
            "label": label,
            "prepare_seconds": float(np.median([curve["prepare_seconds"] for curve in group])),
            "solve": [_median([c["seconds_to"][k] for c in group]) for k in range(len(ACCURACIES))],
            "total": [_median([_plus(c["seconds_to"][k], c["prepare_seconds"]) for c in group])
                      for k in range(len(ACCURACIES))],
        }
        for (energy, label), group in found.items()
    ]  # fmt: skip


def _plus(seconds: float | None, more: float) -> float | None:
    return None if seconds is None else seconds + more


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if len(known) == len(values) else None


def lead(rows: Sequence[Mapping], energy: str, rival: str, key: str = "total") -> tuple[float | None, list[float]]:
    """Our time over a rival's, worst over the accuracies at and below 0.1 mm, and those [mm] at which we are behind.

    An accuracy that the rival never reaches is won if we do reach it; one that we alone miss is an infinite ratio;
    one that neither reaches is left out. None if there is no rival.
    """
    by_label = {row["label"]: row[key] for row in rows if row["energy"] == energy}
    if rival not in by_label or OURS not in by_label:
        return None, []
    ratios: dict[float, float] = {}
    for accuracy, mine, other in zip(ACCURACIES, by_label[OURS], by_label[rival], strict=True):
        if accuracy > BELOW or (mine is None and other is None):
            continue
        ratios[accuracy] = np.inf if mine is None else 0.0 if other is None else mine / max(other, 1e-9)
    return max(ratios.values(), default=None), [accuracy for accuracy, ratio in ratios.items() if ratio > 1.0]
