"""The page of a study of time per unknown, from its results alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .plots import pyplot, svg
from .report import machine_rows, rendered

_ROWS = (
    "law element level sub_layers unknowns tets prepare_seconds seconds cpu_seconds iterations assemblies "
    "linear_iterations fallback_solves cpu_us_per_unknown peak_mb converged"
).split()
_SLOPES = "law element meshes cpu_seconds cpu_per_linear_iteration linear_iterations peak_mb".split()


def page(results: Mapping) -> str:
    """The self-contained report of one run."""
    return rendered(
        "unknowns.html",
        results,
        gate_rows=[(g["what"], g["value"], g["bound"], g["passed"]) for g in results["gates"]],
        solve_rows=[[row[key] for key in _ROWS] for row in results["rows"]],
        slope_rows=[[row[key] for key in _SLOPES] for row in results["exponents"]],
        floor_rows=[
            [row[key] for key in ("what", "megabytes", "floor_ms", "ms", "ratio")] for row in results["floors"]
        ],
        plot=time_plot(results["rows"]),
        machine_rows=machine_rows(results["machine"]) + [("seconds of all", results["seconds"])],
    )


def time_plot(rows: Sequence[Mapping]) -> str:
    """Processor time per unknown, and memory, against unknowns: a line per energy and element."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(8.6, 3.4))
    for law, element in sorted({(row["law"], row["element"]) for row in rows}):
        of = sorted((row for row in rows if (row["law"], row["element"]) == (law, element)), key=_unknowns)
        sizes = [row["unknowns"] for row in of]
        axes[0].plot(sizes, [row["cpu_us_per_unknown"] for row in of], "o-", label=f"{law}, {element}", ms=4)
        axes[1].plot(sizes, [row["peak_mb"] for row in of], "o-", ms=4)
    for axis, what in zip(axes, ("processor time per unknown [µs]", "most memory [MB]"), strict=True):
        axis.set(xscale="log", yscale="log", xlabel="unknowns", ylabel=what)
        axis.grid(alpha=0.25)
    axes[0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    return svg(plt, figure)


def _unknowns(row: Mapping) -> int:
    return row["unknowns"]
