"""The first screen of the report, by rows of the contest `faces`: what is compared, errors, costs, and where they end.

Each pair of an error and a time is one `Summary`, and so of the same frames. A sentence or a method whose rows are
missing is left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...animation.plots import subplots, to_svg, widen_axis
from ...surrogate import methods as m
from ..contest import Summary, summarise
from .study import Table

ASKED = (
    "S is a face by blendshapes; T is the face that a simulation of its tissue makes of S under parameters p. PD is "
    "the fast simulator, FEniCSx solves the same energy by finite elements, and its quadratic tets (P2) are the "
    "converged answer. The network predicts T after training, derivatives are PD to first order, network + "
    "derivatives adds to these what the network knows beyond, and PD from first order goes on to PD's answer. Rivals: "
    "the neutral face settled once with blendshapes, and blendshapes that scaled bones carry."
)
TRUTHS = (m.PD, m.PD_TETS, m.FENICSX_P2)
SOLVERS = (m.PD, m.PD_TETS, m.FENICSX, m.FENICSX_NEO_HOOKEAN, m.FENICSX_P2)
REAL_TIME = 1.0 / 60.0
"""[s] that a frame may take where many are made."""
Lines = Sequence[Mapping[str, Any]]
"""Rows of `contest`, in long form."""


def find_simulator(line: Mapping[str, Any]) -> str:
    """Name the simulator on whose cells a method's face is: the one that a network has learned."""
    return m.PD_TETS if line["cells"] == "tets" else m.PD


def summarise_own(lines: Lines) -> dict[str, Summary]:
    """Summarise each method beside its own simulator."""
    found: dict[str, Summary] = {}
    for truth in (m.PD, m.PD_TETS):
        own = [line for line in lines if find_simulator(line) == truth and line["method"] not in TRUTHS]
        found |= summarise(own, "method", truth)
    return found


def summarise_far(lines: Lines) -> dict[str, Summary]:
    """Summarise methods beside quadratic tets, those alone that made all frames that have these."""
    found = summarise(lines, "method", m.FENICSX_P2)
    frames = max((each.frames for each in found.values()), key=len, default=frozenset())
    return {name: each for name, each in found.items() if each.frames == frames}


def write_sentences(lines: Lines) -> list[str]:
    """Write, in order, how far the simulator, then each method is off, what each costs, and where the network loses."""
    tell = (_tell_truth, _tell_errors, tell_larger, _tell_costs, _tell_losses)
    sentences = [each(lines) for each in tell]
    return [text for text in sentences if text]


def _tell_truth(lines: Lines) -> str:
    far, sentences = summarise_far(lines), []
    if m.PD in far:
        tets = f" (by tets {_percent(far[m.PD_TETS].share)})" if m.PD_TETS in far else ""
        sentences.append(
            f"The simulator misses converged finite elements by {_percent(far[m.PD].share)} of the motion beyond "
            f"scaled bones{tets}, on {_count(far[m.PD])}."
        )
    to_pd = summarise(lines, "method", m.PD)
    if apart := measure_apart(lines):
        sentences.append(f"FEniCSx with the same energy is at most {max(apart):.1e} mm from it on {len(apart)} frames.")
    if m.FENICSX_NEO_HOOKEAN in to_pd:
        law = to_pd[m.FENICSX_NEO_HOOKEAN]
        sentences.append(f"A neo-Hookean law in place of that energy moves the skin by {_percent(law.share)}.")
    return " ".join(sentences)


def measure_apart(lines: Lines) -> list[float]:
    """Measure how far [mm] FEniCSx' skin is from PD's at most, on each frame."""
    return [line["to"][m.PD]["farthest"] for line in lines if line["method"] == m.FENICSX and m.PD in line["to"]]


def _tell_errors(lines: Lines) -> str:
    found = {name: each for name, each in summarise_own(lines).items() if name not in SOLVERS}
    if not found:
        return ""
    ordered = sorted(found, key=lambda name: found[name].share)
    told = "; ".join(f"{name} {_percent(found[name].share)} ({found[name].mean:.3f} mm)" for name in ordered)
    most = max(found.values(), key=lambda each: len(each.frames))
    return f"Each method misses its simulator by, on {_count(most)}: {told}."


def tell_larger(lines: Lines) -> str:
    """Tell whether the network is farther from its simulator than that one from quadratic tets, on the same frames."""
    own = [line for line in lines if line["method"] == m.NETWORK and m.FENICSX_P2 in line["to"]]
    if not own:
        return ""
    simulator = find_simulator(own[0])
    network = summarise(own, "method", simulator).get(m.NETWORK)
    far = summarise(lines, "method", m.FENICSX_P2).get(simulator)
    if network is None or far is None or far.frames != network.frames:
        return ""
    larger = "network" if network.share > far.share else "simulator"
    return (
        f"On {_count(far)} the network misses its simulator by {_percent(network.share)}, and that one misses "
        f"converged finite elements by {_percent(far.share)}: the {larger}'s error is the larger."
    )


def find_front(found: Mapping[str, Summary], seconds: str) -> list[str]:
    """List the methods than which no other is both faster and nearer, the fastest first; `seconds`: first or frame.

    One that misses all of the motion is no choice.
    """
    moving = [name for name in found if found[name].share < 1.0]
    ordered = sorted(moving, key=lambda name: (getattr(found[name], seconds), found[name].share))
    return [name for k, name in enumerate(ordered) if all(found[name].share < found[o].share for o in ordered[:k])]


def _tell_costs(lines: Lines) -> str:
    """Name the front of error and time, to converged finite elements where these are there, else to the simulator."""
    far = summarise_far(lines)
    found, whom = (far, "converged finite elements") if far else (summarise_own(lines), "the simulator")
    if len(found) < 2:
        return ""
    sentences = []
    for seconds, what in (("frame", "a frame of a face that is ready"), ("first", "the first frame of a new face")):
        front = ", ".join(
            f"{name} ({_format_seconds(getattr(found[name], seconds))}, {_percent(found[name].share)})"
            for name in find_front(found, seconds)
        )
        sentences.append(f"No method is both faster and nearer to {whom} than these, for {what}: {front}.")
    ready = {name: each for name, each in found.items() if each.frame <= REAL_TIME}
    if ready:
        best = min(ready, key=lambda name: ready[name].share)
        sentences.append(
            f"For many frames of a face pick {best}: {_format_seconds(ready[best].frame)} each after "
            f"{_format_seconds(ready[best].first)}."
        )
    return " ".join(sentences)


def find_losses(lines: Lines, by: str, truth: str) -> list[tuple[str, str, float, float]]:
    """Find groups in which the network is no nearer to a truth than a simple rival on faces of the same cells.

    Each is the group, the rival, its share and the network's.
    """
    cells = {line["cells"] for line in lines if line["method"] == m.NETWORK}
    alike = [line for line in lines if line["cells"] in cells or line["method"] == m.CARRIED]
    lost = []
    for group in dict.fromkeys(line[by] for line in lines):
        found = summarise([line for line in alike if line[by] == group], "method", truth)
        rivals = [name for name in (m.SETTLED, m.CARRIED) if name in found]
        rival = min(rivals, key=lambda name: found[name].share, default=None)
        if rival and m.NETWORK in found and found[rival].share <= found[m.NETWORK].share:
            lost.append((group, rival, found[rival].share, found[m.NETWORK].share))
    return lost


def _tell_losses(lines: Lines) -> str:
    of_network = [line for line in lines if line["method"] == m.NETWORK]
    if not of_network:
        return ""
    lost = [
        f"{kind} ({rival} misses {_percent(share)}, network {_percent(own)})"
        for kind, rival, share, own in find_losses(lines, "kind", find_simulator(of_network[0]))
    ]
    if lost:
        return f"The network loses to a simple rival on these kinds of p: {', '.join(lost)}."
    return f"The network beats the simple rivals on each of {len({line['kind'] for line in of_network})} kinds of p."


def tabulate(lines: Lines) -> list[Table]:
    """Tabulate errors to each method's simulator, and to quadratic tets, with seconds of the same frames."""
    cells = {line["method"]: line["cells"] for line in lines}
    head = ["method", "cells", "misses of the motion", "mean [mm]", "first frame of a new face [s]",
            "each frame after it [s]", "frames"]  # fmt: skip
    note = (
        "Its simulator is PD on the same cells. Shares are of the motion that scaled bones do not explain. Seconds are "
        "processor time of the same frames as the errors, a median; the first frame has head and bind."
    )
    tables = []
    for caption, found in (
        ("Error to each method's simulator, and cost", summarise_own(lines)),
        ("Error to converged finite elements, and cost", summarise_far(lines)),
    ):
        body = [
            (name, cells[name], each.share, each.mean, each.first, each.frame, len(each.frames))
            for name, each in sorted(found.items(), key=lambda item: item[1].share)
        ]
        tables += [Table(caption, head, body, note)] if body else []
    return tables


def tabulate_kinds(lines: Lines) -> Table:
    """Tabulate shares by kind of p, each method beside its simulator."""
    kinds = list(dict.fromkeys(line["kind"] for line in lines))
    found = {kind: summarise_own([line for line in lines if line["kind"] == kind]) for kind in kinds}
    names = dict.fromkeys(name for each in found.values() for name in each)
    body = [(name, *(found[kind][name].share if name in found[kind] else None for kind in kinds)) for name in names]
    return Table("Share of the motion that each method misses, by kind of p", ["method", *kinds], body)


CAPTION = (
    "Share of the motion that a method misses, against processor time. Hollow marks: a frame of a face that is ready. "
    "Filled marks: the first frame of a new face, with head and bind. Squares solve, circles use the network or "
    "derivatives, triangles are simple rivals."
)


def draw_figure(lines: Lines) -> str:
    """Draw error against seconds, to each method's simulator and to converged elements: SVG; empty without methods."""
    panels = {
        "to its simulator": summarise_own(lines),
        "to converged elements": summarise_far(lines),
    }
    shown = {
        title: {name: (each.share, each.frame, each.first) for name, each in found.items()}
        for title, found in panels.items()
        if len(found) > 1
    }
    return draw_costs(shown) if shown else ""


def draw_costs(panels: Mapping[str, Mapping[str, tuple[float, float, float]]]) -> str:
    """Draw methods in panels by title, as SVG: share of the motion, and seconds of a frame and of a face's first."""
    drawn, axes = subplots(1, len(panels), figsize=(3.0 + 4.5 * len(panels), 4.4))
    labelled: set[str] = set()
    for axis, (title, found) in zip(np.atleast_1d(axes), panels.items(), strict=True):
        for name, (share, frame, first) in found.items():
            method, height = m.get_method(name), max(100 * share, 1e-4)
            label = None if name in labelled else name
            labelled.add(name)
            axis.plot(frame, height, method.mark, mec=method.colour, mfc="white", ms=8)
            if np.isfinite(first):
                axis.plot([frame, first], [height] * 2, color=method.colour, lw=1.2, alpha=0.5)
            axis.plot(first, height, method.mark, color=method.colour, ms=8, label=label)
        axis.set(xscale="log", yscale="log", xlabel="seconds", ylabel="missed of the motion [%]", title=title)
        widen_axis(axis, [max(100 * share, 1e-4) for share, *_ in found.values()])
    drawn.legend(loc="outside right upper", fontsize=10)
    return to_svg(drawn)


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if share < 0.1 else f"{100 * share:.0f} %"


def _count(summary: Summary) -> str:
    faces = len({case.partition(",")[0] for case, _ in summary.frames})
    return f"{len(summary.frames)} frames of {faces} {'face' if faces == 1 else 'faces'}"


def _format_seconds(value: float) -> str:
    if not np.isfinite(value):
        return "a head's and a bind's time that was not measured"
    return f"{value:.2g} s" if value >= 0.01 else f"{1e3 * value:.2g} ms"
