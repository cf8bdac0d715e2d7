"""What several processes of mpirun gain: FEniCSx' phases on one head."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import InputError
from ....lhm.base.option import option
from ....reference import Parameters, apply_law, facial_scene
from ...harness.study import Column, Row, Task, Values, at_most
from ..measures import NEO_HOOKEAN, PD_ENERGY
from ..person import OfPerson
from .phases import PHASES, compare_phases


@dataclass(frozen=True)
class Ranks(OfPerson):
    """Counts of processes, the first of which is 1, on both energies of one head."""

    name = "ranks"
    heading = "What do several processes gain?"
    question = "How does FEniCSx' time fall with the number of processes of mpirun, and do their answers agree?"
    columns = (
        Column("processes", "processes"),
        Column("tets", "tets"),
        *(Column(phase, f"{phase.replace('_', ' ')} [s]", cost=True) for phase in PHASES),
        Column("gain", "whole: times as fast as one process"),
        Column("iterations", "iterations", cost=True),
        Column("linear_iterations", "CG iterations", cost=True),
        Column("off", "off one process' answer, of the largest displacement"),
        Column("peak_mb", "the largest process [MB]", cost=True),
    )
    note = (
        "All solves end at a gradient norm of 1e-12 of their start. Energy, gradient and hessian are those of a state "
        "near rest. The first solve makes multigrid's levels and solves one system; the next solves another with new "
        "values."
    )
    timed = True

    processes: tuple[str, ...] = option(
        ("1", "2", "4"), "counts to compare, the first is 1; repeat", name="--processes"
    )
    expression: str = "jawOpen*0.5"
    rounds: int = 2
    repeats: int = 5

    @property
    def counts(self) -> tuple[int, ...]:
        """Counts of processes; InputError for other than 1 and others."""
        return parse_counts(self.processes)

    def tasks(self) -> Sequence[Task]:
        """List an energy of the head each; InputError for options out of range."""
        self.check([self.expression])
        if self.rounds < 1 or self.repeats < 1:
            raise InputError(f"rounds: {self.rounds}, repeats: {self.repeats}; expected 1 or more")
        return [Task(case, f"{', '.join(map(str, self.counts))} processes") for case in (NEO_HOOKEAN, PD_ENERGY)]

    def measure(self, task: Task) -> Values:
        """Measure a row per count of processes."""
        person = self.person()
        scene = facial_scene(person.head, Parameters(), person.shape(self.expression), bones="prescribed")
        scene = apply_law(scene, "neo-Hookean") if task.case == NEO_HOOKEAN else scene
        return {"rows": compare_phases(scene, self.counts, self.rounds, self.repeats)}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that there is one answer, and that all converged."""
        lines = [line for row in rows for line in row.values["rows"]]
        what = "distance to one process' answer, of the largest displacement"
        return [
            at_most(what, max(line["off"] for line in lines), 1e-10),  # of the largest displacement
            at_most("solves that did not converge", sum(not line["converged"] for line in lines), 0),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what a whole solve gains."""
        return " ".join(
            f"{row.case}: {line['processes']} processes solve {line['gain']:.2f} times as fast as one."
            for row in rows
            for line in row.values["rows"][1:]
        )

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the gain of each phase on the head."""
        if not rows:
            return {}
        figure, axes = subplots(1, len(rows), figsize=(5.2 * len(rows), 3.4), sharey=True, squeeze=False)
        for axis, row in zip(axes[0], rows, strict=True):
            one, *others = row.values["rows"]
            for line in others:
                gains = [one[phase] / line[phase] for phase in PHASES]
                axis.plot(gains, "o-", label=f"{line['processes']} processes")
            axis.set_xticks(range(len(PHASES)), [phase.replace("_", " ") for phase in PHASES], rotation=40, fontsize=8)
            axis.axhline(1.0, color="#bbbbbb", lw=0.8)
            axis.set_title(row.case, fontsize=10)
            axis.legend()
        axes[0][0].set_ylabel("times as fast as one process")
        return {"What several processes gain, phase by phase.": to_svg(figure)}


def parse_counts(texts: Sequence[str]) -> tuple[int, ...]:
    """Counts of processes; InputError for other than 1 and others."""
    wanted = f"processes: expected 1 and others, got {', '.join(texts) or 'none'}"
    if not all(text.isdecimal() for text in texts):
        raise InputError(wanted)
    counts = tuple(map(int, texts))
    if not counts or counts[0] != 1 or min(counts) < 1:
        raise InputError(wanted)
    return counts
