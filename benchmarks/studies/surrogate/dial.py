"""The dial: whether a face knows its error, and what each accuracy costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm import identities
from ....lhm.base.errors import InputError
from ....lhm.base.limits import STUDIED_PEOPLE
from ....lhm.base.option import option
from ....lhm.template.template import DEFAULT_LEVEL
from ....surrogate import methods as m
from ....surrogate.certified import POLICY
from ....surrogate.methods import Method
from ...contest import BEYOND, KINDS, Case, Contest, collect_rows, draw_case, list_columns, list_failures
from ...harness.study import Row, Table, at_least, at_most

HELD_OUT, EXTERNAL, OUT_OF_RANGE = "held-out", "external", "out of range"
ENOUGH = 200
"""Answers, frames by accuracies, from which on a share of 95 % is judged; fewer decide medians alone."""
ACCURACIES = (0.1, 0.05, 0.02, 0.01, 0.003, 0.001)
"""[mm] that are asked for."""
TRUTH = "PD, from first order, converged"
"""It shares the settled neutral face with the frames that it judges: their told error is to the answer on that."""
CONVERGED = m.simulate(TRUTH, m.start_at_first_order(1e-8), "#000000")
NEAR = (0.8, 1.25)
"""Told over true error is to be in here."""
BANDS = tuple(zip((at_least, at_most), NEAR, strict=True))
LEAST = 1e-3
"""[mm] Smaller true errors are counted apart: there rounding of positions and of the truth shows."""
DIALS = {f"{m.DIAL}, {accuracy:g} mm": accuracy for accuracy in ACCURACIES}


@dataclass(frozen=True)
class Dial(Contest):
    """Told and true errors, and processor time, of frames by accuracy."""

    name = "dial"
    version = 2
    question = "Does a face know its error, and what does an accuracy cost?"
    needs = ("people", "heads", "network")
    cheap = "held-out, person 1"
    columns = list_columns((TRUTH,))
    note = Contest.note + (
        " People whom no training has seen, half of the expressions hard (two to five shapes, up to full weight). "
        "External people are ICT-FaceKit's, with shapes of their own. Out of range are muscles and strain limits that "
        "the network has not seen. The truth is PD converged to 1e-8 from the first order. Errors are means over the "
        "vertices that physics moves by more than 0.05 mm."
    )
    timed = True
    people: ClassVar[str] = "anny"
    """Who is held out, as `people_from_text` has them."""

    faces: int = option(6, "people of each kind: held-out, external, out of range", bound=STUDIED_PEOPLE)
    frames: int = 4
    seed: int = 7000
    external: str = option("", "space of external people, as ict:FILE; default: none")
    level: int = DEFAULT_LEVEL

    def list_cases(self) -> Sequence[str]:
        """Name each person; InputError for none, for no frame, and for a space that cannot be read."""
        if self.faces < 1 or self.frames < 1:
            raise InputError("faces, frames: expected 1 or more")
        if self.external:
            identities.from_text(self.external)
        groups = (HELD_OUT, *((EXTERNAL,) if self.external else ()), OUT_OF_RANGE)
        return [f"{group}, person {number}" for group in groups for number in range(self.faces)]

    def make_case(self, name: str) -> Case:
        """Draw a person; its kind is the group."""
        group, _, number = name.partition(", person ")
        people = "external:" + self.external if group == EXTERNAL else self.people
        kind = BEYOND if group == OUT_OF_RANGE else KINDS[int(number) % len(KINDS)]
        seed = (self.seed, (HELD_OUT, EXTERNAL, OUT_OF_RANGE).index(group), int(number))
        drawn = draw_case(name, people, seed, kind, self.frames, level=self.level)
        return replace(drawn, kind=group)

    def list_methods(self, name: str) -> Sequence[str | Method]:
        """List the dial by accuracy, and methods that tell no error."""
        dials = [replace(m.METHODS[m.DIAL], name=each, bind=m.use_dial(accuracy)) for each, accuracy in DIALS.items()]
        networks = (m.NETWORK, m.NETWORK_AND_DERIVATIVES) if name.startswith(HELD_OUT) else ()
        return [*dials, m.SETTLED, m.DERIVATIVES, m.PD_FIRST_ORDER, *networks]

    def list_truths(self, name: str) -> Sequence[str | Method]:
        """List the simulator's own answer."""
        return (CONVERGED,)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Bound errors by what was asked for and told: their medians, and with ENOUGH frames their shares, too."""
        lines = collect_rows(rows)
        answers = [row for row in _collect_answers(lines) if row["accuracy"]]
        if not answers:
            return []
        gates = [at_most("frames that a method could not make", len(list_failures(lines)), 0)]
        asked = float(np.median([row["true"] / row["accuracy"] for row in answers]))
        gates.append(_count(at_most("true error over the accuracy asked for, median", asked, 1.0), answers))
        counted = [row for row in answers if row["true"] >= LEAST]
        if counted:
            told = float(np.median([row["told"] / row["true"] for row in counted]))
            gates += [_count(gate("told over true error, median", told, bound), counted) for gate, bound in BANDS]
        if len(answers) < ENOUGH:
            return gates
        certain = [row for row in counted if row["certain"]]
        within = float(np.mean([row["true"] <= row["accuracy"] for row in answers]))
        trusted = float(np.mean([row["true"] <= POLICY.doubt * row["told"] for row in counted])) if counted else 1.0
        trust = f"share of frames whose true error is at most {POLICY.doubt:g} times the told one"
        hope = "share of frames whose told error is within 0.8 to 1.25 of the true one"
        sure = f"{hope}, of those that say they are certain"
        of_asked = "share of frames whose true error is within the accuracy asked for"
        return [
            *gates,
            _count(at_least(of_asked, within, 0.95), answers),
            _count(at_least(trust, trusted, 0.95), counted),
            _count(at_least(hope, _share_near(answers), 0.95, answer=False), counted),
            _count(at_least(sure, _share_near(certain), 0.95, answer=False), certain),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what is told against what is true, and the price of each accuracy."""
        every = _collect_answers(collect_rows(rows))
        answers = [row for row in every if row["accuracy"]]
        if not answers:
            return ""
        ratios = np.array([row["told"] / row["true"] for row in answers if row["true"] >= LEAST])
        low, middle, high = np.percentile(ratios, [5.0, 50.0, 95.0])
        certain = [row for row in answers if row["certain"]]
        prices = {a: find_median(answers, "ms", accuracy=a) for a in ACCURACIES}
        listed = "; ".join(f"{accuracy:g} mm in {ms:.0f} ms" for accuracy, ms in prices.items())
        ms, error = (find_median(every, key, method=m.PD_FIRST_ORDER) for key in ("ms", "true"))
        dearer = [f"{a:g}" for a in ACCURACIES if prices[a] > ms and error <= a]
        return (
            f"Told over true error is {middle:.2f} in the median, {low:.2f} to {high:.2f} from 5 to 95 % of "
            f"{len(answers)} answers, of {len(answers) // len(ACCURACIES)} frames of {len(rows)} people"
            f"{'' if len(answers) >= ENOUGH else f': too few to judge a share of 95 %, which takes {ENOUGH}'}. "
            f"It is within 0.8 to 1.25 on {100 * _share_near(answers):.0f} % of all, and on "
            f"{100 * _share_near(certain):.0f} % of the {100 * len(certain) / len(answers):.0f} % that say they are "
            f"certain. In the median a frame costs: {listed}."
        ) + (f" {m.PD_FIRST_ORDER} is cheaper than the dial at {', '.join(dearer)} mm: {ms:.0f} ms." if dearer else "")

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate each group of people by accuracy, then all together."""
        every = [row for row in _collect_answers(collect_rows(rows)) if row["accuracy"]]
        body = []
        for group in (*dict.fromkeys(row["group"] for row in every), "all"):
            for accuracy in ACCURACIES:
                there = [row for row in every if group in (row["group"], "all") and row["accuracy"] == accuracy]
                means = [float(np.mean([row[key] for row in there])) for key in ("told", "true", "certain")]
                body.append((group, accuracy, *means, _share_near(there), find_median(there, "ms")))
        head = ("people", "asked for [mm]", "told [mm]", "true [mm]", "certain", "near", "ms")
        return [Table("The dial by people and accuracy", head, body)]

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw told against true error; and error against time, one curve through all methods."""
        lines = collect_rows(rows)
        return {
            "Told against true error of every frame; grey: a factor of 1.25.": _draw_told(_collect_answers(lines)),
            "Error against time of a frame, medians: methods that tell no error, and the dial.": to_svg(
                plot_dial(lines)
            ),
        }


def _collect_answers(lines: Sequence[Mapping]) -> list[dict]:
    """Collect each frame's true mean error [mm], over all vertices where none moves, and milliseconds.

    The dial's rows have the accuracy that was asked for, and what it told.
    """
    return [
        {
            "group": line["kind"], "method": line["method"], "accuracy": DIALS.get(line["method"]),
            "told": line["told"].get("error"), "certain": line["told"].get("certain"), "ms": 1e3 * line["frame_s"],
            "true": to["mean"] if to["vertices"] else to["everywhere"],
        }
        for line in lines
        if (to := line["to"].get(TRUTH))
    ]  # fmt: skip


def find_median(answers: Sequence[Mapping], key: str, **where: Any) -> float:
    """Find the median of a key of the answers that match."""
    return float(np.median([row[key] for row in answers if where.items() <= row.items()]))


def _count(gate: dict, answers: Sequence[Mapping]) -> dict:
    """Add to a gate of how many answers it is."""
    return gate | {"count": len(answers)}


def _share_near(answers: Sequence[Mapping]) -> float:
    """Return the share of frames whose told error is near the true one; NaN-free: 1 where none is counted."""
    ratios = np.array([row["told"] / row["true"] for row in answers if row["true"] >= LEAST])
    return float(np.mean((ratios >= NEAR[0]) & (ratios <= NEAR[1]))) if len(ratios) else 1.0


def _draw_told(answers: Sequence[Mapping]) -> str:
    figure, axis = subplots(figsize=(5.6, 5.0))
    for group in dict.fromkeys(row["group"] for row in answers):
        there = [row for row in answers if row["group"] == group and row["accuracy"]]
        true, told = ([max(row[key], 1e-6) for row in there] for key in ("true", "told"))
        axis.scatter(true, told, s=16, label=group)
    ends = np.array([1e-5, 0.3])
    axis.plot(ends, ends, color="#444444", lw=1.0)
    axis.fill_between(ends, NEAR[0] * ends, NEAR[1] * ends, color="#999999", alpha=0.3, lw=0)
    axis.set(xscale="log", yscale="log", xlabel="true mean error [mm]", ylabel="told [mm]", xlim=ends, ylim=ends)
    axis.tick_params(axis="x", pad=9)  # both axes begin at the same power of ten
    axis.legend()
    return to_svg(figure)


def plot_dial(lines: Sequence[Mapping]):
    """Plot error against time of a frame, of long rows."""
    figure, axis = subplots(figsize=(6.4, 4.2))
    answers = _collect_answers(lines)
    others = dict.fromkeys(row["method"] for row in answers if not row["accuracy"])
    places = [[find_median(answers, key, method=name) for key in ("ms", "true")] for name in others]
    for name, place in zip(others, places, strict=True):
        axis.scatter(*place, marker=m.METHODS[name].mark, color=m.METHODS[name].colour, label=name)
    points = [[find_median(answers, key, accuracy=accuracy) for key in ("ms", "true")] for accuracy in ACCURACIES]
    every = sorted([*places, *points])
    best = [place for k, place in enumerate(every) if all(place[1] < other[1] for other in every[:k])]
    axis.plot(*np.transpose(best), "--", color="#999999", lw=1.0, zorder=0, label="what no other method beats")
    axis.plot(*np.transpose(points), "o-", color=m.METHODS[m.DIAL].colour, label="the dial, asked for 0.1 to 0.001 mm")
    axis.set(xscale="log", yscale="log", xlabel="a frame, processor time [ms]", ylabel="true mean error [mm]")
    axis.margins(0.15)
    figure.legend(loc="outside lower center", ncol=2)
    return figure
