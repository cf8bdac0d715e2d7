"""The first screen of the report: the question, error against time of every method, and six sentences.

Each number is that of a row. A sentence or a method whose rows are missing is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...animation.plots import subplots, to_svg, widen_axis
from ...surrogate import methods as m
from .study import Row

ASKED = (
    "SoftDECA simulates a face once, and a network then predicts the simulated face in every frame. This report asks "
    "three questions. Is the fast simulator right? How far is the network from it? What does each method cost?"
)
SOLVERS = (m.PD, m.FENICSX, m.FENICSX_NEO_HOOKEAN)
SHOWN = (*SOLVERS, m.NETWORK, m.NETWORK_AND_DERIVATIVES, m.DERIVATIVES, m.SETTLED, m.CARRIED, m.BLENDSHAPES)
ACCURACY = 0.01
"""[mm] to which solvers are timed."""
FACE_ENERGY = "Eq. 15"
"""In the name of the energy whose faces every method makes."""
OVERALL = "all"
ALL_VERTICES, SKIN = "all vertices", "skin"
"""What a comparison of `agreement` is over."""


@dataclass(frozen=True)
class Point:
    """A method: seconds to the first frame of a new face and of each frame after it, and its mean error [mm]."""

    first: float
    each: float
    error: float


Rows = Mapping[str, Sequence[Row]]
"""The rows that have values, by study."""


def collect_points(rows: Rows) -> dict[str, Point]:
    """Every method that rows know: solvers, then the others, the most exact first.

    Seconds are those of one head (`work-precision`) where it has the method, else of `surrogate`. Errors to the
    simulator's answer are those on unseen people (`surrogate`) where it has the method. A solver stands at 0.01 mm.
    """
    points: dict[str, Point] = {}
    grouped: dict[str, list[Mapping]] = {}
    for row in rows.get("work-precision", ()):
        if FACE_ENERGY in row.values["law"]:
            grouped.setdefault(row.values["solver"], []).append(row.values)
    for name, records in grouped.items():
        if (point := _time_method(records)) is not None:
            points[name] = point
    for method, score in _collect_scores(rows).get(OVERALL, {}).items():
        if method in points:
            points[method] = Point(points[method].first, points[method].each, score["mean"])
        elif score.get("bind_ms") is not None and score.get("frame_ms") is not None:
            bind, frame = 1e-3 * score["bind_ms"], 1e-3 * score["frame_ms"]
            points[method] = Point(bind + frame, frame, score["mean"])
    shown = {name: points[name] for name in points if name in SHOWN}
    return dict(sorted(shown.items(), key=lambda item: (item[0] not in SOLVERS, item[1].error)))


def _time_method(records: Sequence[Mapping]) -> Point | None:
    """Medians over expressions; None for a solver that one of them does not bring to 0.01 mm."""
    ready = float(np.median([np.median(values["set_up_s"]) for values in records]))
    if "to_hundredth_s" not in records[0]:
        each = float(np.median([np.median(values["solve_s"]) for values in records]))
        return Point(ready + each, each, float(np.mean([values["mean_mm"] for values in records])))
    reached = [values["to_hundredth_s"] for values in records]
    if None in reached:
        return None
    each = float(np.median(reached))
    return Point(ready + each, each, ACCURACY)


def _collect_scores(rows: Rows) -> dict[str, dict[str, Mapping]]:
    """The lines of the study `surrogate`, by kind of frames and method."""
    scores: dict[str, dict[str, Mapping]] = {}
    for row in rows.get("surrogate", ()):
        for line in row.values["rows"]:
            scores.setdefault(line["kind"], {})[line["method"]] = line
    return scores


def write_sentences(rows: Rows) -> list[str]:
    """Write at most six; the first says how far the simulator is from converged finite elements."""
    sentences = (
        tell_distance(rows.get("mesh", ())),
        _tell_losses(rows),
        _tell_overall(rows),
        _tell_agreement(rows),
        _tell_law(rows),
        _tell_costs(collect_points(rows)),
    )
    return [text for text in sentences if text]


def tell_distance(rows: Sequence[Row]) -> str:
    """Tell how far the simulator is from converged finite elements, by rows of `mesh`; nothing without them."""
    told = []
    for kind in ("effects", "expressions"):
        prisms, tets = (mean_share(rows, name, kind) for name in (m.PD, m.PD_TETS))
        if prisms is not None and tets is not None:
            told.append(f"{100 * prisms:.0f} % of the motion over {kind} (by tets {100 * tets:.0f} %)")
    return f"The simulator misses converged finite elements by {' and '.join(told)}." if told else ""


def mean_share(rows: Sequence[Row], method: str, kind: str) -> float | None:
    """Average the share of the motion that a method misses to quadratic tets, over rows of a kind or effect."""
    lines = (line for row in rows for line in row.values["rows"] if kind in (line["kind"], line["what"]))
    shares = [line["to"][m.FENICSX_P2]["share"] for line in lines if line["method"] == method and line["to"]]
    return float(np.mean(shares)) if shares else None


def _tell_losses(rows: Rows) -> str:
    lost, compared = [], 0
    for kind, scores in _collect_scores(rows).items():
        rivals = {name: scores[name]["mean"] for name in (m.SETTLED, m.CARRIED) if name in scores}
        if kind == OVERALL or m.NETWORK not in scores or not rivals:
            continue
        compared += 1
        rival = min(rivals, key=lambda name: rivals[name])
        if rivals[rival] <= (mine := scores[m.NETWORK]["mean"]):
            lost.append(f"{kind} ({rival} {rivals[rival]:.3f} mm, network {mine:.3f} mm)")
    for effect, (rival, share, own) in find_lost_effects(rows.get("split", ())).items():
        lost.append(f"{effect} ({rival} leaves {100 * share:.0f} % of the motion, network {100 * own:.0f} %)")
    if lost:
        return f"The network loses to a simple rival on these kinds of frames: {', '.join(lost)}."
    return f"The network beats the simple rivals on all {compared} kinds of frames." if compared else ""


def find_lost_effects(rows: Sequence[Row]) -> dict[str, tuple[str, float, float]]:
    """Find effects of the study `split` on which the nearer rival leaves less than the network: rival, both shares."""
    lost = {}
    frames = [row for row in rows if "share" in row.values]
    for effect in dict.fromkeys(row.case for row in frames):
        records = [row.values for row in frames if row.case == effect]
        own, settled, carried = (
            float(np.mean([values[key] for values in records])) for key in ("share", "share_settled", "share_carried")
        )
        rival, share = (m.SETTLED, settled) if settled <= carried else (m.CARRIED, carried)
        if share <= own:
            lost[effect] = rival, share, own
    return lost


def _tell_overall(rows: Rows) -> str:
    scores = _collect_scores(rows).get(OVERALL, {})
    if not {m.NETWORK, m.SETTLED} <= scores.keys():
        return ""
    people = rows["surrogate"][0].values.get("people")
    whom = f"{people} people" if people else "people"
    errors = {name: score["mean"] for name, score in scores.items() if name in SHOWN}
    best = min(errors, key=lambda name: errors[name])
    return (
        f"On {whom} it has not seen, the network errs by {errors[m.NETWORK]:.3f} mm on average and the simple rival "
        f"{m.SETTLED} by {errors[m.SETTLED]:.3f} mm; {best} is best with {errors[best]:.3f} mm."
    )


def select_comparisons(rows: Iterable[Row], method: str, truth: str, over: str) -> list[Mapping]:
    """Select a method's comparisons with a solver in rows of `agreement`, over ALL_VERTICES or the SKIN."""
    lines = (line for row in rows if row.method == method for line in row.values.get("compared", ()))
    return [line for line in lines if (line["to"], line["over"]) == (truth, over)]


def _tell_agreement(rows: Rows) -> str:
    apart = [line["max"] for line in select_comparisons(rows.get("agreement", ()), m.PD, m.FENICSX, ALL_VERTICES)]
    if not apart:
        return ""
    return (
        f"The fast simulator (PD) and FEniCSx minimise the same energy, and end at most {max(apart):.1e} mm apart "
        f"in {len(apart)} {'case' if len(apart) == 1 else 'cases'}."
    )


def _tell_law(rows: Rows) -> str:
    compared = rows.get("agreement", ())
    skin, everything = (
        select_comparisons(compared, m.FENICSX_NEO_HOOKEAN, m.PD, over) for over in (SKIN, ALL_VERTICES)
    )
    if not skin:
        return ""
    return (
        "A neo-Hookean law instead of PD's energy moves the skin by at most "
        f"{max(line['mean'] for line in skin):.3f} mm on average, "
        f"and a vertex by at most {max(line['max'] for line in everything):.2f} mm."
    )


def _tell_costs(points: Mapping[str, Point]) -> str:
    """Say which solver to pick for a frame, and which method for many frames of a face."""
    solvers = sorted((name for name in (m.PD, m.FENICSX) if name in points), key=lambda name: points[name].each)
    sentences = []
    if len(solvers) > 1:
        best, other = ((name, _format_seconds(points[name].each)) for name in solvers)
        sentences.append(
            f"For a frame to {ACCURACY:g} mm pick {best[0]}, which takes {best[1]}; {other[0]} takes {other[1]}."
        )
    if solvers and m.NETWORK in points:
        first, each, error = points[m.NETWORK].first, points[m.NETWORK].each, points[m.NETWORK].error
        sentences.append(
            f"For many frames of a face pick the network: {_format_seconds(each)} each after "
            f"{_format_seconds(first)}, at {error:.3f} mm."
        )
    return " ".join(sentences)


def _format_seconds(value: float) -> str:
    return f"{value:.2g} s" if value >= 0.01 else f"{1e3 * value:.2g} ms"


def draw_figure(rows: Rows) -> str:
    """Error against seconds, to the first frame of a new face (filled) and of each frame after it (hollow): SVG.

    An empty text where fewer than two methods are there.
    """
    points = collect_points(rows)
    if len(points) < 2:
        return ""
    drawn, axis = subplots(figsize=(12, 4.4))
    for name, point in points.items():
        colour, mark = m.METHODS[name].colour, m.METHODS[name].mark
        axis.plot([point.each, point.first], [point.error] * 2, color=colour, lw=1.2, alpha=0.5)
        axis.plot(point.each, point.error, mark, mec=colour, mfc="white", ms=8)
        axis.plot(point.first, point.error, mark, color=colour, ms=8, label=name)
    for row in rows.get("work-precision", ()):
        name = row.values["solver"]
        if name in points and name in SOLVERS and FACE_ENERGY in row.values["law"]:
            seconds = np.median(row.values["set_up_s"]) + np.array(row.values["seconds"])
            axis.plot(seconds, row.values["error_mm"], color=m.METHODS[name].colour, lw=0.8, ls=":")
    errors = [point.error for point in points.values()]
    if dial := _collect_dial(rows):
        axis.plot(
            *zip(*dial, strict=True), f"{m.METHODS[m.DIAL].mark}-", color=m.METHODS[m.DIAL].colour, ms=5, label=m.DIAL
        )
        errors += [error for _, error in dial]
    axis.set(xscale="log", yscale="log", xlabel="seconds", ylabel="mean error [mm]")
    widen_axis(axis, errors)
    drawn.legend(loc="outside right upper", fontsize=10)
    return to_svg(drawn)


def _collect_dial(rows: Rows) -> list[tuple[float, float]]:
    """Medians of seconds and true error [mm] of a frame, by the accuracy that is asked for."""
    by_accuracy: dict[float, list[Mapping]] = {}
    for row in rows.get("dial", ()):
        for frame in row.values["told"]:
            by_accuracy.setdefault(frame["accuracy"], []).append(frame)
    return [
        (1e-3 * float(np.median([each["ms"] for each in frames])), float(np.median([each["true"] for each in frames])))
        for frames in by_accuracy.values()
    ]


CAPTION = (
    "Mean distance of the skin to the simulator's answer, against time. Hollow marks: a frame of a face that is ready. "
    "Filled marks: the first frame of a new face, with all that it needs. Squares are solvers at 0.01 mm; dotted lines "
    "show their largest error. Diamonds are frames that tell their error, asked for from 0.1 to 0.001 mm. Circles use "
    "the network or derivatives of the simulator. Triangles are simple rivals."
)
