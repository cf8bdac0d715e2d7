"""What the simulator's benchmark has to show, and its page; both read the results alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from . import simulator_plots
from .gates import at_most
from .report import machine_rows, rendered
from .traces import ACCURACY
from .work_precision import ARAP, FACE, IGL, NEWTON, OURS, lead

COLD_SECONDS, WARM_SECONDS = 1.0, 0.2
COLD_PER_HOUR, WARM_PER_HOUR = 4000, 15000
WORKER_MB = 600.0
OVER_FLOOR = 2.0
RIVALS = ((FACE, "PD, plain"), (FACE, NEWTON), (ARAP, NEWTON), (ARAP, IGL))
"""Whom L-BFGS is to be ahead of, on which energy."""


def gates(results: Mapping) -> list[dict]:
    """The statements about the parts that were measured, as `gates.gates` has them."""
    found = []
    if "throughput" in results:
        found += _throughput_gates(results["throughput"])
    if "precision" in results:
        found += _precision_gates(results["precision"])
    if "minimal" in results:
        failures = sum(row["failure"] is not None for row in results["minimal"]["rows"])
        found.append(at_most("pieces of the minimal model that could not be compared", failures, 0))
    if "scaling" in results:
        unfinished = sum(not row["converged"] or row["iterations"] is None for row in results["scaling"]["rows"])
        found.append(at_most("levels of the template at which the solve did not converge", unfinished, 0))
    return found


def _throughput_gates(speed: Mapping) -> list[dict]:
    found = []
    for cold in speed["cold"]:
        kind, rows = cold["kind"], cold["rows"]
        slowest = float(np.max([row["seconds"] for row in rows]))
        found += [
            at_most(f"cold frame, {kind}: slowest, scene to solution [s]", slowest, COLD_SECONDS, answer=False),
            _at_least(f"cold frames per core-hour, {kind}", _per_hour(rows), COLD_PER_HOUR),
            at_most(
                f"cold frame, {kind}: largest error [mm]", float(np.max([row["error_mm"] for row in rows])), ACCURACY
            ),
        ]
    warm = speed["warm"]
    median = float(np.median([row["seconds"] for row in warm["rows"]]))
    found += [
        at_most("warm frame of a sequence, median [s]", median, WARM_SECONDS, answer=False),
        _at_least("warm frames per core-hour", _per_hour(warm["rows"]), WARM_PER_HOUR),
        at_most("warm frame: largest error [mm]", float(np.max(warm["errors_mm"])), ACCURACY),
        at_most("memory of a worker, fit and frame [MB]", speed["worker_mb"]["peak"], WORKER_MB),
        at_most("time of an iteration over its floor (an aim)", speed["floor"]["ratio"], OVER_FLOOR, answer=False),
    ]
    return found


def _precision_gates(precision: Mapping) -> list[dict]:
    found = []
    for energy, rival in RIVALS:
        if any(rival in reason for reason in precision["skipped"]):
            continue
        for key, what in (("total", "with preparation"), ("solve", "prepared")):
            worst, _ = lead(precision["medians"], energy, rival, key)
            name = f"time of {OURS} over {rival}'s, worst accuracy below 0.1 mm, {what}; {energy}"
            # An infinite ratio is no JSON: what was not reached is None.
            found.append(at_most(name, None if worst is None or np.isinf(worst) else worst, 1.0, answer=False))
    newton = [value for name, value in precision["agreement_mm"].items() if name.startswith(NEWTON)]
    if newton:
        found.append(at_most(f"{OURS} to {NEWTON}, both tight [mm]", float(np.max(newton)), ACCURACY))
    return found


def _at_least(what: str, value: float, bound: float) -> dict:
    return {"what": what, "value": value, "bound": f"at least {bound:g}", "passed": value >= bound, "answer": False}


def _per_hour(rows: Sequence[Mapping]) -> float:
    return 3600.0 / float(np.mean([row["seconds"] for row in rows]))


def page(results: Mapping) -> str:
    """The self-contained report of one run."""
    speed, precision = results.get("throughput"), results.get("precision")
    minimal, growth = results.get("minimal"), results.get("scaling")
    return rendered(
        "simulator_report.html",
        results,
        gate_rows=[(g["what"], g["value"], g["bound"], g["passed"]) for g in results["gates"]],
        missed=[g["what"] for g in results["gates"] if not g["passed"]],
        speed=speed,
        cold_rows=_cold_rows(speed) if speed else [],
        warm_rows=_warm_rows(speed["warm"]) if speed else [],
        floor_rows=_floor_rows(speed["floor"], speed["worker_mb"]) if speed else [],
        sequence_plot=simulator_plots.sequence(speed["warm"]) if speed else "",
        work=precision,
        precision_plot=simulator_plots.work_precision(precision) if precision else "",
        lead_rows=_lead_rows(precision) if precision else [],
        median_rows=_median_rows(precision) if precision else [],
        agreement_rows=list(precision["agreement_mm"].items()) if precision else [],
        pieces=minimal,
        piece_rows=_piece_rows(minimal) if minimal else [],
        growth=growth,
        growth_plot=simulator_plots.scaling(growth) if growth else "",
        growth_rows=_growth_rows(growth) if growth else [],
        exponent_rows=[(name.replace("_", " "), value) for name, value in growth["exponents"].items()]
        if growth
        else [],
        machine_rows=machine_rows(results["machine"])
        + [("seeds of the cold frames", ", ".join(map(str, results["seeds"])))]
        + [(f"seconds: {name}", float(value)) for name, value in results["seconds"].items()],
    )


def _cold_rows(speed: Mapping) -> list[Sequence]:
    keys = ("scene_seconds", "prepare_seconds", "solve_seconds", "seconds", "cpu_seconds", "iterations", "error_mm")
    return [
        (cold["kind"], row["seed"], cold["tolerance"], *(row[key] for key in keys), _per_hour([row]))
        for cold in speed["cold"]
        for row in cold["rows"]
    ]


def _warm_rows(warm: Mapping) -> list[Sequence]:
    rows: list[Sequence] = []
    for name, key in (
        ("wall time [s]", "seconds"),
        ("processor time [s]", "cpu_seconds"),
        ("iterations", "iterations"),
    ):
        values = np.array([row[key] for row in warm["rows"]], dtype=float)
        rows.append((name, *(float(v) for v in (np.median(values), values.mean(), values.max()))))
    errors = np.array(warm["errors_mm"])
    return rows + [("error of the checked frames [mm]", *map(float, (np.median(errors), errors.mean(), errors.max())))]


def _floor_rows(floor: Mapping, worker: Mapping) -> list[Sequence]:
    split = floor["split_ms"]
    return [
        ("bandwidth of one core, triad [GB/s]", floor["bandwidth_gb_s"]),
        ("factor [MB], read twice an iteration", floor["factor_mb"]),
        ("tets [MB], read once", floor["tets_mb"]),
        ("floor of an iteration [ms]", floor["floor_ms"]),
        ("an iteration [ms]", split["iteration"]),
        ("ratio", floor["ratio"]),
        ("energy and gradient (local step) [ms]", split["local"]),
        ("solve with A (global step) [ms]", split["solve"]),
        ("the rest: L-BFGS, further evaluations [ms]", split["rest"]),
        ("evaluations per iteration", floor["evaluations_per_iteration"]),
        ("memory of a worker: libraries [MB]", worker["loaded"]),
        ("memory of a worker: peak of the fit [MB]", worker["fit"]),
        ("memory of a worker: peak [MB]", worker["peak"]),
    ]


def _lead_rows(precision: Mapping) -> list[Sequence]:
    rows: list[Sequence] = []
    rivals = {(row["energy"], row["label"]) for row in precision["medians"]} - {(FACE, OURS), (ARAP, OURS)}
    for energy, rival in sorted(rivals):
        for key, what in (("total", "with preparation"), ("solve", "prepared")):
            worst, behind = lead(precision["medians"], energy, rival, key)
            named = ", ".join(f"{accuracy:g}" for accuracy in behind) or "none"
            rows.append((energy, rival, what, worst, named))
    return rows


def _median_rows(precision: Mapping) -> list[Sequence]:
    return [(row["energy"], row["label"], row["prepare_seconds"], *row["total"][::2]) for row in precision["medians"]]


def _piece_rows(minimal: Mapping) -> list[Sequence]:
    keys = ("cpu_seconds", "iterations", "megabytes")
    return [
        (
            row["piece"],
            *(row["kept"].get(key) for key in keys),
            *(row["left_out"].get(key) for key in keys),
            row["mean_mm"],
            row["max_mm"],
            row["failure"] or "",
        )
        for row in minimal["rows"]
    ]


def _growth_rows(growth: Mapping) -> list[Sequence]:
    keys = (
        "level vertices tets factor_mb prepare_seconds iterations iteration_ms solve_seconds megabytes peak_mb".split()
    )
    return [[row[key] for key in keys] for row in growth["rows"]]
