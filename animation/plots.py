"""Plots that studies share, as SVG text or PNG."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping, Sequence

from ..lhm.base.errors import InputError

STYLE = {
    "svg.fonttype": "none",
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "figure.constrained_layout.use": True,
}


def draw_learning_curve(curve: Sequence[Mapping[str, float]]) -> bytes:
    """Draw each point of a training, errors in mm, against steps: PNG. Numbers that some points lack have gaps."""
    figure, axis = subplots(figsize=(6, 3.4))
    named = {name for point in curve for name in point} - {"step", "seconds"}
    for name in sorted(named):
        points = [(point["step"], point[name]) for point in curve if name in point]
        axis.plot(*zip(*points, strict=True), label=name.replace("_mm", "").replace("_", " "))
    axis.set(xlabel="step", ylabel="mean vertex error [mm]", yscale="log")
    axis.legend()
    return to_png(figure)


def subplots(rows: int = 1, columns: int = 1, *, figsize: tuple[float, float] = (6.4, 4.8), **more):
    """A figure and its axes, as pyplot.subplots makes them, in the style that all share; Matplotlib loads here."""
    plt = _pyplot()
    plt.rcParams.update(STYLE)
    return plt.subplots(rows, columns, figsize=figsize, **more)


def widen_axis(axis, values: Sequence[float]) -> None:
    """Let a logarithmic axis y end half a decade beyond positive values, so that it has ticks."""
    axis.set_ylim(min(values) / 3.0, 3.0 * max(values))


def _pyplot():
    """Matplotlib's pyplot, which draws into memory; InputError where MPLBACKEND names what is not installed."""
    try:
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot as plt
    except ValueError as error:
        named = os.environ.get("MPLBACKEND", "")
        raise InputError(f"MPLBACKEND={named}: Matplotlib has no such backend ({str(error)[:40]})") from None
    return plt


def to_png(figure) -> bytes:
    """A figure as PNG, closed."""
    return _save(figure, "png", dpi=120)


def to_svg(figure) -> str:
    """A figure as SVG text, closed."""
    for axis in figure.axes:
        _space(axis)
    text = _save(figure, "svg").decode()
    return text[text.index("<svg") :]


def _save(figure, kind: str, **more) -> bytes:
    import matplotlib.pyplot as plt

    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, **more)
    plt.close(figure)
    return buffer.getvalue()


def _space(axis) -> None:
    """Keep the numbers of a logarithmic axis x out of one another."""
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter

    if axis.get_xscale() != "log":
        return
    low, high = axis.get_xlim()
    if sum(low <= place <= high for place in axis.get_xticks()) > 1:
        axis.xaxis.set_minor_formatter(NullFormatter())
    else:
        axis.xaxis.set_minor_locator(LogLocator(subs=(3.0,)))
        axis.xaxis.set_minor_formatter(LogFormatterSciNotation(minor_thresholds=(math.inf, math.inf)))
