"""Plots that studies share, as SVG text or PNG."""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence


def learning_curve(curve: Sequence[Mapping[str, float]]) -> bytes:
    """What each point of a training has, errors in mm, against steps: PNG."""
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(6, 3.4))
    steps = [point["step"] for point in curve]
    for name in curve[0]:
        if name not in ("step", "seconds"):
            axis.plot(steps, [point[name] for point in curve], label=name.replace("_mm", "").replace("_", " "))
    axis.set(xlabel="step", ylabel="mean vertex error [mm]", yscale="log")
    axis.grid(alpha=0.25)
    axis.legend(frameon=False)
    figure.tight_layout()
    return png(plt, figure)


def error_against_cost(scores: Sequence) -> bytes:
    """`costs_figure` as PNG."""
    return png(pyplot(), costs_figure(scores))


def costs_figure(scores: Sequence):
    """Mean error [mm] of methods (`evaluate.Score`) against milliseconds at bind and per frame."""
    plt = pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), sharey=True)
    for axis, name, label in zip(
        axes, ("bind_ms", "frame_ms"), ("bind [ms]", "one frame of ten at a time [ms]"), strict=True
    ):
        for score in scores:
            cost = max(getattr(score, name), 1e-3)
            axis.scatter(cost, score.mean, marker="s" if score.simulates else "o")
            axis.annotate(score.method, (cost, score.mean), fontsize=7, xytext=(4, 4), textcoords="offset points")
        axis.set(xlabel=label, xscale="log", yscale="log")
        axis.grid(alpha=0.25)
    axes[0].set_ylabel("mean vertex error [mm]")
    axes[0].set_title("squares: besides, the simulator at bind", fontsize=8)
    figure.tight_layout()
    return figure


def histograms(panels: Sequence[tuple[str, str, Sequence[float], float | None]]) -> str:
    """How often each value occurs, a panel per (name, unit, values, bound); the bound, if any, as a red line."""
    plt = pyplot()
    columns = min(4, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure, axes = plt.subplots(rows, columns, figsize=(3.1 * columns, 2.3 * rows), squeeze=False)
    for axis in axes.ravel()[len(panels) :]:
        axis.set_visible(False)
    for axis, (name, unit, values, bound) in zip(axes.ravel(), panels, strict=False):
        axis.hist(values, bins=min(40, max(5, round(2 * math.sqrt(len(values))))), color="#4c78a8")
        if bound is not None:
            axis.axvline(bound, color="#b3261e", lw=1.2)
        axis.set_title(name, fontsize=9)
        axis.set_xlabel(unit, fontsize=8)
        axis.tick_params(labelsize=7)
        axis.yaxis.get_major_locator().set_params(integer=True)
        axis.spines[["top", "right"]].set_visible(False)
    figure.supylabel("heads", fontsize=9)
    figure.tight_layout()
    return svg(plt, figure)


def pyplot():
    """Matplotlib without a display, loaded when it is needed."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams["svg.fonttype"] = "none"
    return plt


def png(plt, figure) -> bytes:
    """A figure as PNG, closed."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=120)
    plt.close(figure)
    return buffer.getvalue()


def svg(plt, figure) -> str:
    """A figure as SVG text, closed."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg")
    plt.close(figure)
    text = buffer.getvalue()
    return text[text.index("<svg") :]
