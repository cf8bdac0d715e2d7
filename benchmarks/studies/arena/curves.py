"""Error over processor time, a panel per problem and a line per solver and setting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ....animation.plots import subplots
from ....surrogate.methods import get_method

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
    "Newton semi-implicit": "#bcbd22",
    "Newton XPBD": "#7f7f7f",
    "PyPBD": "#dbdb8d",
}
"""By solver of another package; others are black."""


def plot_curves(rows: Sequence[tuple[str, Mapping[str, Any]]]):
    """Draw largest errors [mm] over set-up and solve [s], of cases and values; a solver's first setting is full."""
    cases = list(dict.fromkeys(case for case, _ in rows))
    deep = -(-len(cases) // WIDE)
    figure, axes = subplots(deep, WIDE, figsize=(13, 3.8 * deep + 0.8), squeeze=False)
    labels: dict[str, Any] = {}
    for axis, case in zip(axes.ravel(), cases, strict=False):
        firsts: set[str] = set()
        for of, values in rows:
            if of != case or values["start"] != "from rest" or not values["seconds"]:
                continue
            title = values["solver"]
            points = [
                (values["set_up_s"] + seconds, max(error, FLOOR))
                for seconds, error in zip(values["seconds"], values["error_mm"], strict=True)
                if error <= TOP
            ]
            if not points:
                continue
            style = {"lw": 0.8, "ls": ":"} if title in firsts else {"lw": 1.4}
            marker = "o" if len(points) == 1 else None
            colour = COLOURS.get(title) or get_method(title).colour
            (line,) = axis.plot(*zip(*points, strict=True), color=colour, marker=marker, ms=4, **style)
            labels.setdefault(title, line)
            firsts.add(title)
        axis.set(xscale="log", yscale="log", title=case, ylim=(FLOOR, TOP), xlabel="processor time [s]")
    for axis in axes.ravel()[len(cases) :]:
        axis.set_axis_off()
    for axis in axes[:, 0]:
        axis.set_ylabel("largest error on the skin [mm]")
    figure.legend(list(labels.values()), list(labels), loc="outside lower center", ncol=5, frameon=False)
    return figure
