"""The page of a study of mesh convergence, from its results alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .plots import pyplot, svg
from .report import machine_rows, rendered

_SOLVES = ("expression surface sub_layers element vertices tets iterations converged energy inverted seconds").split()


def page(results: Mapping) -> str:
    """The self-contained report of one run."""
    found = results["expressions"]
    return rendered(
        "convergence.html",
        results,
        gate_rows=[(g["what"], g["value"], g["bound"], g["passed"]) for g in results["gates"]],
        own_rows=[(e["name"], e["moved_mm"], *_figures(e["own_mesh"])) for e in found],
        across_rows=[
            (e["name"], int(count), *_figures(row), e["order_across"], e["order_across_used"], e["gci_across_mm"])
            for e in found
            for count, row in e["across"].items()
        ],
        along_rows=[
            (e["name"], int(level), *_figures(row), e["order_along_assumed"], e["gci_along_mm"])
            for e in found
            for level, row in e["along"].items()
        ],
        quadratic_rows=[
            (e["name"], what, *_figures(e[key]))
            for e in found
            for key, what in (("quadratic_to_own", "P1, same mesh"), ("quadratic_to_limit", "limit"))
            if e[key]
        ],
        solve_rows=[[row[key] for key in _SOLVES] for row in results["solves"]],
        plot=errors_plot(found),
        machine_rows=machine_rows(results["machine"]) + [("seconds of all solves", results["seconds"])],
    )


def errors_plot(found: Sequence[Mapping]) -> str:
    """RMS error to the limit against relative size, across the layers and along the surface, a line per expression."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(8.6, 3.4), sharey=True)
    for entry in found:
        across = sorted((1.0 / int(count), row["rms"]) for count, row in entry["across"].items())
        along = sorted((0.5 ** int(level), row["rms"]) for level, row in entry["along"].items())
        for axis, points in zip(axes, (across, along), strict=True):
            axis.plot(*zip(*points, strict=True), "o-", label=entry["name"], ms=4)
    for axis, what in zip(axes, ("across: 1 / sub-layers", "along: edges / the head's own"), strict=True):
        axis.set_xscale("log", base=2)
        axis.set(yscale="log", xlabel=what)
        axis.grid(alpha=0.25)
    axes[0].set_ylabel("RMS distance to the limit [mm]")
    axes[0].legend(frameon=False, fontsize=8)
    figure.tight_layout()
    return svg(plt, figure)


def _figures(row: Mapping) -> tuple[float, ...]:
    return tuple(row[key] for key in ("mean", "p95", "max"))
