"""Plots that studies share, as SVG text or PNG."""

from __future__ import annotations

import io
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from ..lhm.base.errors import InputError

STYLE = {
    "svg.fonttype": "none",
    "axes.grid": True,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "figure.constrained_layout.use": True,
}
NARROW = 3.9
"""Width [inch] of a figure on a phone, where its letters are as large as those of the page."""
_narrow: ContextVar[bool] = ContextVar("narrow", default=False)


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


LEAST_SECONDS = 1e-3
"""Where a method without a bind stands."""


def plot_costs(scores: Sequence):
    """Mean error [mm] of methods (`evaluate.Score`) against seconds before the first frame, and of one frame."""
    figure, axes = subplots(1, 2, figsize=(10, 4.2), sharey=True)
    axes[0].set_title("a person's head and the bind; squares: the simulator runs", fontsize=8)
    axes[0].set(xlabel="before the first frame [s]", ylabel="mean error of moving vertices [mm]")
    axes[1].set(xlabel="one frame, with its blendshapes [ms]")
    for score in scores:
        before = 1e-3 * ((score.head_ms or 0.0) + score.bind_ms)
        for axis, cost in zip(axes, (max(before, LEAST_SECONDS), score.frame_ms), strict=True):
            axis.scatter(cost, score.mean, marker="s" if score.simulates else "o")
            # Above the mark and centred, since a name beside one leaves the axes.
            axis.annotate(score.method, (cost, score.mean), (0, 6), textcoords="offset points", ha="center", fontsize=7)
    for axis in axes:
        axis.set(xscale="log", yscale="log")
        low, high = axis.get_xlim()
        axis.set_xlim(low / 4.0, high * 4.0)
        axis.margins(y=0.15)
    return figure


def draw_histograms(panels: Sequence[tuple[str, str, Sequence[float], float | None]]) -> str:
    """Draw how often each value occurs, a panel per (name, unit, values, bound); the bound, if any, as a red line."""
    columns = min(4, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure, axes = subplots(rows, columns, figsize=(3.1 * columns, 2.3 * rows), squeeze=False)
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
    return to_svg(figure)


def subplots(rows: int = 1, columns: int = 1, *, figsize: tuple[float, float] = (6.4, 4.8), **more):
    """A figure and its axes, as pyplot.subplots makes them, in the style that all share; Matplotlib loads here.

    Within `narrow` the figure is as wide as a phone, and its panels stand one below the other.
    """
    plt = _pyplot()
    plt.rcParams.update(STYLE)
    if not _narrow.get():
        return plt.subplots(rows, columns, figsize=figsize, **more)
    stacked, tall = rows * columns, max(figsize[1] / rows, 0.6 * NARROW)
    more.pop("width_ratios", None)
    figure, axes = plt.subplots(stacked, 1, figsize=(NARROW, stacked * tall), **more)
    if stacked == 1:
        return figure, axes
    shape = (rows, columns) if rows > 1 and columns > 1 or not more.get("squeeze", True) else (stacked,)
    return figure, np.reshape(axes, shape)


@contextmanager
def narrow_figures() -> Iterator[None]:
    """Draw figures for a screen of 390 pixels."""
    token = _narrow.set(True)
    try:
        yield
    finally:
        _narrow.reset(token)


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
    if _narrow.get():
        _fold(figure)
    text = _save(figure, "svg").decode()
    return text[text.index("<svg") :]


def _save(figure, kind: str, **more) -> bytes:
    import matplotlib.pyplot as plt

    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, **more)
    plt.close(figure)
    return buffer.getvalue()


def _fold(figure) -> None:
    """Wrap the words of a narrow figure, and put its legends below."""
    import textwrap

    def fold(text: str, width: int) -> str:
        return "\n".join(textwrap.wrap(text, width)) if len(text) > width and "$" not in text else text

    for legend in list(figure.legends):
        handles, labels = legend.legend_handles, [text.get_text() for text in legend.get_texts()]
        title = legend.get_title().get_text()
        legend.remove()
        columns = 1 if max(map(len, labels), default=0) > 20 else 2
        figure.legend(handles, labels, loc="outside lower center", ncol=columns, title=fold(title, 40) or None)
    for axis in figure.axes:
        axis.set_title(fold(axis.get_title(), 42), fontsize=9)
        axis.set_xlabel(fold(axis.get_xlabel(), 38))
        axis.set_ylabel(fold(axis.get_ylabel(), 36))
        names = [label.get_text() for label in axis.get_yticklabels()]
        if any(len(name) > 12 and "$" not in name for name in names):
            axis.set_yticks(axis.get_yticks(), [_chop(name) for name in names], fontsize=7)
        _thin(axis)


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


def _thin(axis) -> None:
    """Leave out upright names under an axis, all but every so many, where they would stand in one another."""
    labels = axis.get_xticklabels()
    step = math.ceil(len(labels) / 22)  # upright names that stand under a narrow figure
    if step > 1 and any(label.get_rotation() == 90 for label in labels):
        names = [label.get_text() for label in labels[::step]]
        axis.set_xticks(axis.get_xticks()[::step], names, rotation=90, fontsize=7)


def _chop(name: str) -> str:
    """A name of a row in lines of about 16 letters, broken after a plus or a comma too."""
    lines = [""]
    for piece in re.findall(r"[^+, ]+[+, ]*", name):
        if lines[-1] and len(lines[-1]) + len(piece.rstrip()) > 18:
            lines.append("")
        lines[-1] += piece
    return "\n".join(line.rstrip() for line in lines)
