"""The plot of a release."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .plots import pyplot, svg


def released(traces: Mapping[str, Mapping], names: Sequence[str]) -> str:
    """What is left of the first displacement against time, a line per name, as SVG text."""
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(9, 4.5))
    for name in names:
        style = "-" if name.startswith("FEM") else "--"
        axis.plot(traces[name]["times"], traces[name]["left"], style, lw=1.3, label=name)
    axis.set(xlabel="time [s]", ylabel="share of the first displacement")
    axis.axhline(0.0, color="#bbbbbb", lw=0.8)
    axis.grid(alpha=0.25)
    axis.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.tight_layout()
    return svg(plt, figure)
