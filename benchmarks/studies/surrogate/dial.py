"""The dial: whether a face knows its error, and what each accuracy costs."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm import identities
from ....lhm.base.errors import InputError, SoftdecaError
from ....lhm.base.limits import STUDIED_PEOPLE
from ....lhm.base.mesh import Floats, Floats32
from ....lhm.base.option import option
from ....lhm.expressions import sample_weights
from ....lhm.template.template import DEFAULT_LEVEL
from ....reference import Face, Parameters
from ....reference.face.correction import predict
from ....reference.face.derivatives import spring_norm
from ....surrogate import CertifiedFace, certify
from ....surrogate.certified import POLICY
from ....surrogate.corpus.mixture import draw
from ....surrogate.corpus.people import People, people_from_text
from ....surrogate.methods import DERIVATIVES, DIAL, METHODS, NETWORK, NETWORK_AND_DERIVATIVES, PD_FIRST_ORDER, SETTLED
from ....surrogate.rigs.rig import Rig
from ....surrogate.ruler import MOVES
from ...harness.study import Column, Row, Study, Table, Task, Values, at_least, at_most
from ..person import CELLS

HELD_OUT, EXTERNAL, BEYOND = "held-out", "external", "out of range"
KINDS = ("materials", "single", "both", "default", "single", "effects")
"""Of held-out and external people's p, in turn; "default" is no p at all."""
FAR = {"muscle_strain_ratio": (0.05, 0.3), "strain_limit": (1.1, 1.2)}
"""What the network has not seen: a muscle's softness always, a strain limit in every other face."""
ENOUGH = 200
"""Answers, frames by accuracies, from which on a share of 95 % is judged; fewer decide medians alone."""
ACCURACIES = (0.1, 0.05, 0.02, 0.01, 0.003, 0.001)
"""[mm] that are asked for."""
TRUTH = 1e-8
"""Gradient norm of the truth, relative to that of the targets' springs each 1 mm long."""
NEAR = (0.8, 1.25)
"""Told over true error is to be in here."""
BANDS = tuple(zip((at_least, at_most), NEAR, strict=True))
LEAST = 1e-3
"""[mm] Smaller true errors are counted apart: there rounding of positions and of the truth shows."""
COLOURS = ("#006d5b", "#b3541e", "#4c3f91")


@dataclass(frozen=True)
class Dial(Study):
    """Told and true errors, and processor time, of frames by accuracy."""

    name = "dial"
    heading = "Does a face know its error, and what does an accuracy cost?"
    question = "Is the error that a frame tells the true one, and what does a frame cost at each accuracy?"
    needs = ("people", "heads", "network")
    cheap = "held-out, person 1, dial"
    columns = (
        Column("accuracy", "asked for [mm]"),
        Column("told", "told, mean [mm]"),
        Column("true", "true, mean [mm]"),
        Column("near", "told / true in 0.8 to 1.25"),
        Column("certain", "certain"),
        Column("ms", "frame, median [ms]", cost=True),
    )
    note = (
        "People whom no training has seen, half of the expressions hard (two to five shapes, up to full weight). "
        "External people are ICT-FaceKit's, with shapes of their own. Out of range are muscles and strain limits that "
        "the network has not seen. The truth is PD converged to 1e-8 from the first order. Errors are means over the "
        "vertices that physics moves by more than 0.05 mm. Milliseconds are processor time of one core."
    )
    timed = True
    people: ClassVar[str] = "anny"
    """Who is held out, as `people_from_text` has them."""

    faces: int = option(6, "people of each kind: held-out, external, out of range", bound=STUDIED_PEOPLE)
    frames: int = 4
    seed: int = 7000
    external: str = option("", "space of external people, as ict:FILE; default: none")
    level: int = DEFAULT_LEVEL

    def tasks(self) -> Sequence[Task]:
        """List each person; InputError for none, for no frame, and for a space that cannot be read."""
        if self.faces < 1 or self.frames < 1:
            raise InputError("faces, frames: expected 1 or more")
        if self.external:
            identities.from_text(self.external)
        groups = (HELD_OUT, *((EXTERNAL,) if self.external else ()), BEYOND)
        return [Task(f"{group}, person {number}", DIAL) for group in groups for number in range(self.faces)]

    def measure(self, task: Task) -> Values:
        """Bind a person's face, and make its frames by every method and accuracy."""
        group, person = task.case.split(", person ")
        face, kind, rng = self._bind(group, int(person))
        frames = [_Frame(face, self._weights(rng, number)) for number in range(self.frames)]
        methods: tuple[str, ...] = (SETTLED, DERIVATIVES, PD_FIRST_ORDER)
        if face.method == NETWORK_AND_DERIVATIVES:
            methods += (NETWORK, NETWORK_AND_DERIVATIVES)
        rigs = {method: METHODS[method].bind(face.face) for method in methods}
        answers = [frame.ask(accuracy) for frame in frames for accuracy in ACCURACIES]
        lean = [row for frame in frames for row in frame.lean(rigs)]
        rows = [_line(accuracy, [row for row in answers if row["accuracy"] == accuracy]) for accuracy in ACCURACIES]
        return {"group": group, "kind": kind, "told": answers, "lean": lean, "rows": rows}

    def _bind(self, group: str, person: int):
        """Return a person's face, the kind of p, and what draws expressions."""
        rng = np.random.default_rng([self.seed, (HELD_OUT, EXTERNAL, BEYOND).index(group), person])
        people = _people("external:" + self.external if group == EXTERNAL else self.people, self.level)
        who = people.person(rng)
        head = people.head(who)
        kind = KINDS[person % len(KINDS)]
        if group == BEYOND:
            kind = "beyond"
            far = list(FAR.items())[: 1 + person % 2]
            parameters = Parameters(**{name: float(rng.uniform(*span)) for name, span in far})
        elif kind == "default":
            parameters = Parameters()
        else:
            parameters = draw(rng, kind, field=False).parameters(head, people.mean)
        face = certify(Face(head, who.shapes, parameters, per="wraps", code=who.code, choices={"cells": CELLS}))
        return face, kind, rng

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Bound errors by what was asked for and told: their medians, and with ENOUGH frames their shares, too."""
        answers = [row for one in rows for row in one.values["told"]]
        counted = [row for row in answers if row["true"] >= LEAST]
        asked = float(np.median([row["true"] / row["accuracy"] for row in answers]))
        gates = [_count(at_most("true error over the accuracy asked for, median", asked, 1.0), answers)]
        if counted:
            told = float(np.median([row["told"] / row["true"] for row in counted]))
            gates += [_count(gate("told over true error, median", told, bound), counted) for gate, bound in BANDS]
        if len(answers) >= ENOUGH:
            gates += _bound_shares(answers, counted)
        for accuracy, rate in ((0.01, 10.0), (0.05, 30.0)):
            ms = [row["ms"] for row in counted if row["accuracy"] == accuracy]
            if ms:
                what = f"frames a second on one core at {accuracy:g} mm, median"
                gates.append(at_least(what, 1e3 / float(np.median(ms)), rate, answer=False))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what is told against what is true, and the price of each accuracy."""
        answers = [row for one in rows for row in one.values["told"]]
        ratios = np.array([row["told"] / row["true"] for row in answers if row["true"] >= LEAST])
        low, middle, high = np.percentile(ratios, [5.0, 50.0, 95.0])
        certain = [row for row in answers if row["certain"]]
        prices = {a: float(np.median([row["ms"] for row in answers if row["accuracy"] == a])) for a in ACCURACIES}
        listed = [
            f"{', '.join(f'{each:g}' for each in alike)} mm in {prices[alike[0]]:.0f} ms"
            for alike in _group_alike(ACCURACIES, list(prices.values()))
        ]
        pd = [line for row in rows for line in row.values["lean"] if line["method"] == PD_FIRST_ORDER]
        ms, error = (float(np.median([line[key] for line in pd])) for key in ("ms", "true"))
        dearer = [f"{a:g}" for a in ACCURACIES if prices[a] > ms and error <= a]
        faces = f"{len(answers)} answers, of {len(answers) // len(ACCURACIES)} frames of {len(rows)} people"
        return (
            f"Told over true error is {middle:.2f} in the median, {low:.2f} to {high:.2f} from 5 to 95 % of {faces}"
            f"{'' if len(answers) >= ENOUGH else f': too few to judge a share of 95 %, which takes {ENOUGH}'}. "
            f"It is within 0.8 to 1.25 on {100 * _share_near(answers):.0f} % of all, and on "
            f"{100 * _share_near(certain):.0f} % of the {100 * len(certain) / len(answers):.0f} % that say they are "
            f"certain. In the median a frame costs: {'; '.join(listed)}."
        ) + (f" {PD_FIRST_ORDER} is cheaper than the dial at {', '.join(dearer)} mm: {ms:.0f} ms." if dearer else "")

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate all people together, by accuracy; then by group."""
        groups = list(dict.fromkeys(row.values["group"] for row in rows))
        head = ("people", "asked for [mm]", "told [mm]", "true [mm]", "near", "near, certain", "certain", "ms")
        body = []
        for group in (*groups, "all"):
            answers = [r for row in rows if group in (row.values["group"], "all") for r in row.values["told"]]
            for accuracy in ACCURACIES:
                subset = [row for row in answers if row["accuracy"] == accuracy]
                line = _line(accuracy, subset)
                near = _share_near([row for row in subset if row["certain"]])
                body.append(
                    (group, accuracy, line["told"], line["true"], line["near"], near, line["certain"], line["ms"])
                )
        return [Table("The dial by people and accuracy", head, body)]

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw told against true error; and error against time, one curve through all methods."""
        return {
            "Told against true error of every frame; grey: a factor of 1.25. Hollow marks are not certain.": (
                _draw_told(rows)
            ),
            "Error against time of a frame, medians: methods that tell no error, and the dial.": to_svg(
                plot_dial([row.values for row in rows])
            ),
        }

    def _weights(self, rng: np.random.Generator, number: int) -> Floats:
        if number % 2 == 0:
            return sample_weights(rng)
        weights, count = np.zeros(52), rng.integers(2, 6)
        low, high = (0.2, 1.0) if rng.random() < 0.5 else (0.1, 0.5)
        weights[rng.choice(51, count, replace=False)] = rng.uniform(low, high, count)
        return weights


class _Frame:
    """One expression of a face: its truth, and which vertices move there."""

    def __init__(self, face: CertifiedFace, weights: Floats):
        self.certified, self.face, self.weights = face, face.face, weights
        self.expression = self.face.blend(weights)
        self.scene = self.face.scene(weights)
        self.start = predict(self.face, weights)
        truth = self._solve(TRUTH)
        if not truth.converged and truth.history.gradient_norm[-1] > 1e2 * TRUTH * spring_norm(self.scene):
            raise SoftdecaError(f"truth: {truth.reason}")
        self.truth = self.face.skin_after(weights, truth.positions)
        self.inverted = int(np.count_nonzero(truth.volume_ratio <= 0.0))
        moves = np.linalg.norm(self.truth - self.expression - self.face.carried, axis=1) > MOVES
        self.counted = moves if moves.any() else np.ones_like(moves)

    def _solve(self, accuracy: float):
        return self.face.derivatives.prepared.solve(
            self.scene, start=self.start, absolute=accuracy * spring_norm(self.scene), untangle=False
        )

    def error(self, skin: Floats | Floats32) -> float:
        """Return the true mean error [mm] of a skin."""
        return float(np.linalg.norm(skin - self.truth, axis=1)[self.counted].mean())

    def ask(self, accuracy: float) -> dict:
        """Return what a frame of an accuracy tells, what is true, and its milliseconds."""
        begin = time.process_time()
        frame = self.certified.frame(self.weights, accuracy)
        ms = 1e3 * (time.process_time() - begin)
        return {
            "accuracy": accuracy, "method": frame.method, "told": frame.error, "true": self.error(frame.skin),
            "certain": frame.certain, "ms": ms, "inverted": self.inverted,
        }  # fmt: skip

    def lean(self, rigs: Mapping[str, Rig]) -> list[dict]:
        """Return errors and milliseconds of methods that tell none, and of PD alone."""
        rows = []
        for method, rig in rigs.items():
            begin = time.process_time()
            skin = rig.frame(self.weights)
            rows.append({"method": method, "true": self.error(skin), "ms": 1e3 * (time.process_time() - begin)})
        return rows


def _line(accuracy: float, answers: Sequence[Mapping]) -> dict:
    """Return a line of the report: the frames of one accuracy."""
    return {
        "accuracy": accuracy,
        "told": float(np.mean([row["told"] for row in answers])),
        "true": float(np.mean([row["true"] for row in answers])),
        "near": _share_near(answers),
        "certain": float(np.mean([row["certain"] for row in answers])),
        "ms": float(np.median([row["ms"] for row in answers])),
    }


def _count(gate: dict, answers: Sequence[Mapping]) -> dict:
    """Add to a gate of how many answers it is."""
    return gate | {"count": len(answers)}


def _bound_shares(answers: Sequence[Mapping], counted: Sequence[Mapping]) -> list[dict]:
    """Bound the shares of answers that are as asked and told; those of `counted` have a true error above LEAST."""
    certain = [row for row in counted if row["certain"]]
    within = float(np.mean([row["true"] <= row["accuracy"] for row in answers]))
    trusted = float(np.mean([row["true"] <= POLICY.doubt * row["told"] for row in counted])) if counted else 1.0
    trust = f"share of frames whose true error is at most {POLICY.doubt:g} times the told one"
    hope = "share of frames whose told error is within 0.8 to 1.25 of the true one"
    sure = f"{hope}, of those that say they are certain"
    return [
        _count(at_least("share of frames whose true error is within the accuracy asked for", within, 0.95), answers),
        _count(at_least(trust, trusted, 0.95), counted),
        _count(at_least(hope, _share_near(answers), 0.95, answer=False), counted),
        _count(at_least(sure, _share_near(certain), 0.95, answer=False), certain),
    ]


def _share_near(answers: Sequence[Mapping]) -> float:
    """Return the share of frames whose told error is near the true one; NaN-free: 1 where none is counted."""
    ratios = np.array([row["told"] / row["true"] for row in answers if row["true"] >= LEAST])
    return float(np.mean((ratios >= NEAR[0]) & (ratios <= NEAR[1]))) if len(ratios) else 1.0


def _draw_told(rows: Sequence[Row]) -> str:
    figure, axis = subplots(figsize=(5.6, 5.0))
    groups = list(dict.fromkeys(row.values["group"] for row in rows))
    for group, colour in zip(groups, COLOURS, strict=False):
        answers = [r for row in rows if row.values["group"] == group for r in row.values["told"]]
        for certain, face in ((True, colour), (False, "none")):
            subset = [row for row in answers if row["certain"] == certain]
            true, said = ([max(row[key], 1e-6) for row in subset] for key in ("true", "told"))
            axis.scatter(true, said, s=16, facecolors=face, edgecolors=colour, label=group if certain else None)
    ends = np.array([1e-5, 0.3])
    axis.plot(ends, ends, color="#444444", lw=1.0)
    axis.fill_between(ends, NEAR[0] * ends, NEAR[1] * ends, color="#999999", alpha=0.3, lw=0)
    axis.set(xscale="log", yscale="log", xlabel="true mean error [mm]", ylabel="told [mm]", xlim=ends, ylim=ends)
    axis.tick_params(axis="x", pad=9)  # both axes begin at the same power of ten
    axis.legend()
    return to_svg(figure)


def plot_dial(people: Sequence[Values]):
    """Plot error against time of a frame, of what `measure` gave of each person."""
    figure, axis = subplots(figsize=(6.4, 4.2))
    lean = [row for person in people for row in person["lean"]]
    places = []
    for method in dict.fromkeys(row["method"] for row in lean):
        of = [row for row in lean if row["method"] == method]
        places.append([float(np.median([row[key] for row in of])) for key in ("ms", "true")])
        axis.scatter(*places[-1], marker=METHODS[method].mark, color=METHODS[method].colour, label=method)
    answers = [row for person in people for row in person["told"]]
    points = []
    for accuracy in ACCURACIES:
        of = [row for row in answers if row["accuracy"] == accuracy]
        points.append([float(np.median([row[key] for row in of])) for key in ("ms", "true")])
    every = sorted([*places, *points])
    best = [place for k, place in enumerate(every) if all(place[1] < other[1] for other in every[:k])]
    axis.plot(*np.transpose(best), "--", color="#999999", lw=1.0, zorder=0, label="what no other method beats")
    axis.plot(*np.transpose(points), "o-", color="#006d5b", label="the dial, asked for 0.1 to 0.001 mm")
    axis.set(xscale="log", yscale="log", xlabel="a frame, processor time [ms]", ylabel="true mean error [mm]")
    axis.margins(0.15)
    figure.legend(loc="outside lower center", ncol=2)
    return figure


def _group_alike(accuracies: Sequence[float], ms: Sequence[float]) -> list[list[float]]:
    """Group neighbouring accuracies whose milliseconds differ by a tenth at most."""
    groups: list[list[float]] = []
    for accuracy, cost in zip(accuracies, ms, strict=True):
        if groups and abs(cost / ms[accuracies.index(groups[-1][0])] - 1.0) <= 0.1:
            groups[-1].append(accuracy)
        else:
            groups.append([accuracy])
    return groups


@lru_cache(maxsize=2)
def _people(text: str, level: int) -> People:
    return people_from_text(text, level=level)
