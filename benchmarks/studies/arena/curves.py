"""Error over processor time, a panel per problem and a line per solver and setting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ....animation.plots import subplots
from ....surrogate.methods import get_method
from .runs import REST

FLOOR, TOP = 1e-9, 100.0
"""[mm] below and above which nothing is drawn."""
WIDE = 3
"""Panels side by side."""
COLOURS = {
    "FElupe": "#444444",
    "sfepy": "#ff9896",
    "torch-fem": "#e377c2",
    "JAX-FEM": "#f7b6d2",
    "MuJoCo flex": "#0b5d1e",
    "Newton VBD": "#ff7f0e",
    "libigl ARAP": "#2ca02c",
}
"""Colours of solvers that METHODS has not; others are black."""


def plot_curves(rows: Sequence[tuple[str, Mapping[str, Any]]]):
    """Draw the largest errors [mm] of solves from rest; rows are the problem and values. Later settings are dotted."""
    cases = list(dict.fromkeys(case for case, _ in rows))
    wide = min(WIDE, len(cases))
    deep = -(-len(cases) // wide)
    figure, axes = subplots(deep, wide, figsize=(13 / 3 * wide, 3.8 * deep + 0.8), squeeze=False)
    labels: dict[str, Any] = {}
    for axis, case in zip(axes.ravel(), cases, strict=False):
        firsts: dict[str, str] = {}
        for name, values in rows:
            if name == case and values["start"] == REST and values["seconds"]:
                title = values["solver"]
                dotted = firsts.setdefault(title, values["setting"]) != values["setting"]
                line = _plot_row(axis, values, dotted)
                if line is not None:
                    labels.setdefault(title, line)
        axis.set(
            xscale="log", yscale="log", title=case, ylim=(FLOOR, TOP), xlabel="set-up and solve [s] of a processor"
        )
        axis.tick_params(axis="x", pad=9)  # the lowest tick of y stands in the corner
    for axis in axes.ravel()[len(cases) :]:
        axis.set_axis_off()
    for axis in axes[:, 0]:
        axis.set_ylabel("largest error [mm]")
    figure.legend(list(labels.values()), list(labels), loc="outside lower center", ncol=5, frameon=False)
    return figure


def _plot_row(axis, values: Mapping[str, Any], dotted: bool):
    """One solver's line, for the legend; None where all errors are above TOP."""
    curve = zip(values["seconds"], values["error_mm"], strict=True)
    points = [(values["set_up_s"] + seconds, max(error, FLOOR)) for seconds, error in curve if error <= TOP]
    if not points:
        return None
    colour = COLOURS.get(values["solver"]) or get_method(values["solver"]).colour
    style = {"lw": 0.8, "ls": ":"} if dotted else {"lw": 1.4}
    marker = "o" if len(points) == 1 else None
    return axis.plot(*zip(*points, strict=True), color=colour, marker=marker, ms=4, **style)[0]
