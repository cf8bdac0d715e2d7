"""Plots of the simulator's results as SVG text."""

from __future__ import annotations

from collections.abc import Mapping

from .plots import pyplot, svg
from .work_precision import ARAP, FACE, IGL, NEWTON, OURS

COLOURS = {OURS: "#1f77b4", "PD, Anderson": "#9467bd", "PD, plain": "#999999", NEWTON: "#d62728", IGL: "#2ca02c"}
LEAST_ERROR = 1e-7
"""[mm], below which the tight runs' own error shows."""


def work_precision(precision: Mapping) -> str:
    """Largest error [mm] against seconds with preparation: medians over expressions, thin lines the single runs."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.4), sharey=True)
    for axis, energy in zip(axes, (FACE, ARAP), strict=True):
        for curve in precision["curves"]:
            if curve["energy"] == energy:
                points = [
                    (seconds + curve["prepare_seconds"], error)
                    for seconds, error in zip(curve["seconds"], curve["error_mm"], strict=True)
                    if error > LEAST_ERROR
                ]
                axis.plot(*zip(*points, strict=True), color=COLOURS.get(curve["label"], "#555555"), lw=0.7, alpha=0.4)
        for row in precision["medians"]:
            if row["energy"] == energy:
                points = [
                    (seconds, accuracy)
                    for seconds, accuracy in zip(row["total"], precision["accuracies_mm"], strict=True)
                    if seconds is not None
                ]
                if points:
                    colour = COLOURS.get(row["label"], "#555555")
                    axis.plot(*zip(*points, strict=True), "o-", color=colour, label=row["label"], lw=2, ms=4)
        axis.axhline(0.1, color="#bbbbbb", lw=0.8, ls=":")
        axis.set(xscale="log", yscale="log", title=energy, xlabel="time with preparation [s]", ylim=(LEAST_ERROR, None))
        axis.grid(alpha=0.25, which="major")
        axis.legend(frameon=False, fontsize=9)
    axes[0].set_ylabel("largest error of a vertex [mm]")
    figure.tight_layout()
    return svg(plt, figure)


def scaling(found: Mapping) -> str:
    """Seconds and megabytes against tets, with the fitted exponents in the legend."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(10, 4))
    panels = (
        (axes[0], "seconds", {"prepare_seconds": "preparation", "solve_seconds": "solve to 0.01 mm"}),
        (axes[1], "MB", {"megabytes": "memory of scene and solver", "factor_mb": "factor of the PD matrix"}),
    )
    tets = [row["tets"] for row in found["rows"]]
    for axis, unit, figures in panels:
        for key, label in figures.items():
            values = [row[key] for row in found["rows"]]
            if None not in values:
                slope = found["exponents"].get(key)
                axis.plot(tets, values, "o-", label=label if slope is None else f"{label}: tets^{slope:.2f}")
        axis.set(xscale="log", yscale="log", xlabel="tets", ylabel=unit)
        axis.set_xticks(tets, [f"{count:,}" for count in tets])
        axis.set_xticks([], minor=True)
        axis.grid(alpha=0.25, which="both")
        axis.legend(frameon=False, fontsize=9)
    figure.tight_layout()
    return svg(plt, figure)


def sequence(warm: Mapping) -> str:
    """Milliseconds and iterations of each frame of the sequence."""
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(8, 3))
    rows = warm["rows"]
    frames = range(1, len(rows) + 1)
    axis.plot(frames, [1e3 * row["seconds"] for row in rows], label="wall time")
    axis.plot(frames, [1e3 * row["cpu_seconds"] for row in rows], label="processor time", ls="--")
    axis.set(xlabel="frame (60 Hz)", ylabel="ms", ylim=(0, None))
    right = axis.twinx()
    right.plot(frames, [row["iterations"] for row in rows], color="#999999", lw=0.9)
    right.set(ylabel="iterations (grey)", ylim=(0, None))
    axis.legend(frameon=False, fontsize=9, loc="upper right")
    figure.tight_layout()
    return svg(plt, figure)
