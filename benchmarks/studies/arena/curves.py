"""Error over processor time or work, a panel per problem and a line per solver and setting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

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


Over = Literal["seconds", "work"]
TITLES: Mapping[Over, str] = {"seconds": "set-up and solve [s] of a processor", "work": "iterations"}


@dataclass(frozen=True)
class Panel:
    """The values of rows under a title, over set-up and solve [s] or over work."""

    title: str
    rows: Sequence[Mapping[str, Any]]
    over: Over = "seconds"

    @classmethod
    def by_case(cls, rows: Sequence[tuple[str, Mapping[str, Any]]]) -> list[Panel]:
        """Make a panel of each case, of cases and values."""
        return [
            cls(case, [values for name, values in rows if name == case]) for case in dict.fromkeys(c for c, _ in rows)
        ]


def plot_curves(panels: Sequence[Panel], *, floor: float = FLOOR):
    """Draw largest errors [mm] of solves from rest, none below `floor`; settings after a solver's first are dotted."""
    wide = min(WIDE, len(panels))
    deep = -(-len(panels) // wide)
    figure, axes = subplots(deep, wide, figsize=(13 / 3 * wide, 3.8 * deep + 0.8), squeeze=False)
    labels: dict[str, Any] = {}
    for axis, panel in zip(axes.ravel(), panels, strict=False):
        firsts: dict[str, str] = {}
        for values in panel.rows:
            if values["start"] != REST or not values[panel.over]:
                continue
            title = values["solver"]
            dotted = firsts.setdefault(title, values["setting"]) != values["setting"]
            line = _plot_row(axis, values, panel.over, floor, dotted)
            if line is not None:
                labels.setdefault(title, line)
        axis.set(xscale="log", yscale="log", title=panel.title, ylim=(floor, TOP), xlabel=TITLES[panel.over])
        axis.tick_params(axis="x", pad=9)  # the lowest tick of y stands in the corner
    for axis in axes.ravel()[len(panels) :]:
        axis.set_axis_off()
    for axis in axes[:, 0]:
        axis.set_ylabel("largest error [mm]")
    figure.legend(list(labels.values()), list(labels), loc="outside lower center", ncol=5, frameon=False)
    return figure


def _plot_row(axis, values: Mapping[str, Any], over: Over, floor: float, dotted: bool):
    """One solver's line, for the legend; None where all errors are above TOP."""
    title, ready = values["solver"], float(np.median(values["set_up_s"])) if over == "seconds" else 0.0
    colour = COLOURS.get(title) or get_method(title).colour
    curve = zip(values[over], values["error_mm"], strict=True)
    points = [(ready + x, max(error, floor)) for x, error in curve if error <= TOP]
    if not points:
        return None
    style = {"lw": 0.8, "ls": ":"} if dotted else {"lw": 1.4}
    marker = "o" if len(points) == 1 else None
    return axis.plot(*zip(*points, strict=True), color=colour, marker=marker, ms=4, **style)[0]
