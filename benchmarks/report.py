"""One self-contained HTML page from a results file and its pictures; it computes nothing that is not in them."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence

from . import plots
from .harness.page import machine_rows, rendered


def page(results: Mapping, pictures: Mapping[str, bytes], view: str) -> str:
    """The report of one study; pictures are PNG, by name; `view` is the page of the head in 3D, which it holds."""
    cases = results["cases"]
    form = [case["skin"]["PD to neo-Hookean"]["mean"] for case in cases]
    return rendered(
        "report.html",
        results,
        view=view,
        pictures={name: base64.b64encode(png).decode() for name, png in pictures.items()},
        agreement=max(case["comparisons"]["PD to FEniCSx, same energy"]["relative"] for case in cases),
        model_form={"min": min(form), "max": max(form)},
        two_minima=[(case["name"], case["another_minimum_mm"]) for case in cases if case["another_minimum_mm"]],
        failed=[gate["what"] for gate in results["gates"] if not gate["passed"]],
        work_precision=plots.work_precision(cases),
        surrogate_errors=_surrogate_errors(results["surrogate"]),
        gate_rows=[(g["what"], g["value"], g["bound"], g["passed"]) for g in results["gates"]],
        head_rows=[(row["figure"], row["value"], row["unit"], row["limit"]) for row in results["head"]],
        verification_rows=[
            (r["problem"], r["solver"], r["value"], r["reference"], r["error"], r["bound"], r["passed"])
            for r in results["verification"]
        ],
        solver_rows=[row for case in cases for row in _solver_rows(case)],
        difference_rows=[row for case in cases for row in _difference_rows(case)],
        surrogate_rows=_surrogate_rows(results["surrogate"]),
        machine_rows=machine_rows(results["machine"])
        + [(f"seconds: {name}", float(value)) for name, value in results["seconds"].items()],
    )


def _solver_rows(case: Mapping) -> list[Sequence]:
    rows: list[Sequence] = []
    for run in case["runs"]:
        norms = run["history"]["gradient_norm"]
        counts = ", ".join(f"{name} {value:g}" for name, value in run["detail"].items())
        rows.append(
            (
                case["name"],
                run["label"],
                run["energy_law"],
                run["start"],
                run["iterations"],
                run["compile_seconds"],
                run["prepare_seconds"],
                run["seconds"],
                norms[-1] / norms[0] if norms[0] > 0 else 0.0,
                run["done"],
                counts,
            )
        )
    return rows


def _difference_rows(case: Mapping) -> list[Sequence]:
    return [
        (case["name"], f"{where}: {what}", d["mean"], d["rms"], d["p95"], d["max"], d["relative"])
        for where, group in (("all vertices", "comparisons"), ("skin", "skin"))
        for what, d in case[group].items()
    ]


def _surrogate_rows(tested: Mapping | None) -> list[Sequence]:
    return [
        (s["method"], s["kind"], s["frames"], s["mean"], s["p95"], s["largest"], s["share"], s["frame_ms"])
        for s in (tested["scores"] if tested else [])
    ]


def _surrogate_errors(tested: Mapping | None) -> dict[str, float]:
    """Mean error [mm] over all frames by method."""
    return {s["method"]: s["mean"] for s in (tested["scores"] if tested else []) if s["kind"] == "all"}
