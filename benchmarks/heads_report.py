"""What a campaign over many heads has shown: gates, distributions, failures; and its page."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields

import numpy as np

from ..lhm import HeadReport
from ..lhm.check import Figure
from . import plots
from .gates import at_most
from .heads_gallery import Shown
from .report import machine_rows, rendered

FAILURES_PER_HEAD = 1e-3
WORST = 5
_PLOTTED = (
    "smallest_dihedral",
    "share_below_5_degrees",
    "aspect_95",
    "aspect_max",
    "least_thickness",
    "mean_thickness",
    "wrap_to_skin_mean",
    "wrap_to_skin_95",
    "wrap_to_skin_max",
    "skin_to_wrap_mean",
    "lip_path",
    "lid_detour",
    "fit_seconds",
    "check_seconds",
)
_SECONDS = {
    "fit": "fit_seconds",
    "fit_cpu": "fit_cpu_seconds",
    "check": "check_seconds",
    "check_cpu": "check_cpu_seconds",
}


def summary(rows: Sequence[Mapping]) -> dict:
    """Gates, distributions by figure, and failures by seed, of the rows of a campaign; rows go along.

    A head fails if it could not be fitted or misses a gate. A distribution is {unit, bound, missed, min, p5, median,
    mean, p95, max, worst}, where worst are the seeds nearest to the wrong side of the bound (else the largest).
    """
    unfit = [row for row in rows if row["error"]]
    missing = [row for row in rows if row["problems"]]
    failed = len(unfit) + len(missing)
    gate = at_most(
        f"heads of {len(rows)} that could not be fitted or miss a gate", failed, FAILURES_PER_HEAD * len(rows)
    )
    return {
        "gates": [gate],
        "fitted": len(rows) - len(unfit),
        "failures": [{"seed": row["seed"], "reason": row["error"]} for row in unfit]
        + [{"seed": row["seed"], "reason": "; ".join(row["problems"])} for row in missing],
        "distributions": _distributions([row for row in rows if not row["error"]]),
        "heads": list(rows),
    }


def _distributions(rows: Sequence[Mapping]) -> dict[str, dict]:
    found = {}
    for item in fields(HeadReport):
        values = [(row["figures"][item.name], row["seed"]) for row in rows if row["figures"][item.name] is not None]
        if values:
            found[item.name] = _distribution(Figure(item.name, None, **item.metadata), values)
    for key, name in _SECONDS.items():
        if rows:
            values = [(row["seconds"][key], row["seed"]) for row in rows]
            found[name] = _distribution(Figure(name, None, "s", None, None), values)
    return found


def _distribution(figure: Figure, values: Sequence[tuple[float, int]]) -> dict:
    x = np.array([value for value, _ in values], dtype=float)
    small_is_bad = figure.direction in ("at least", "above")
    worst = sorted(values, key=lambda pair: (pair[0] if small_is_bad else -pair[0], pair[1]))[:WORST]
    missed = sum(Figure(figure.name, v, figure.unit, figure.direction, figure.bound).missed for v, _ in values)
    return {
        "unit": figure.unit,
        "limit": figure.limit,
        "bound": figure.bound,
        "missed": missed,
        "min": float(x.min()),
        "p5": float(np.quantile(x, 0.05)),
        "median": float(np.median(x)),
        "mean": float(x.mean()),
        "p95": float(np.quantile(x, 0.95)),
        "max": float(x.max()),
        "worst": [seed for _, seed in worst],
    }


def page(results: Mapping, shown: Sequence[Shown] = ()) -> str:
    """The self-contained report of one campaign, and the heads of its gallery."""
    spread = results["distributions"]
    panels = []
    for name in _PLOTTED:
        if name in spread:
            panels.append((name.replace("_", " "), spread[name]["unit"], _values(results, name), spread[name]["bound"]))
    reasons = Counter(failure["reason"].partition(":")[0] for failure in results["failures"])
    return rendered(
        "heads.html",
        results,
        gate_rows=[(g["what"], g["value"], g["bound"], g["passed"]) for g in results["gates"]],
        failure_rows=[(f["seed"], f["reason"]) for f in results["failures"]],
        reason_rows=sorted(reasons.items(), key=lambda pair: -pair[1]),
        figure_rows=[_figure_row(name, row) for name, row in spread.items()],
        shown=[
            (row.name, row.notes, [_encoded(row.faces), _encoded(row.layers)], list(row.figures.items()))
            for row in shown
        ],
        histograms=plots.histograms(panels) if panels else "",
        machine_rows=machine_rows(results["machine"]),
    )


def _encoded(png: bytes) -> str:
    """A picture as it stands within a page."""
    return base64.b64encode(png).decode()


def _figure_row(name: str, row: Mapping) -> list:
    unit = f" [{row['unit']}]" if row["unit"] else ""
    seeds = ", ".join(str(seed) for seed in row["worst"])
    cells = [name.replace("_", " ") + unit, row["limit"] or None, row["missed"] if row["limit"] else None]
    return cells + [row[key] for key in ("min", "p5", "median", "mean", "p95", "max")] + [seeds]


def _values(results: Mapping, name: str) -> list[float]:
    fitted = [row for row in results["heads"] if not row["error"]]
    for key, seconds in _SECONDS.items():
        if seconds == name:
            return [row["seconds"][key] for row in fitted]
    return [row["figures"][name] for row in fitted if row["figures"][name] is not None]
