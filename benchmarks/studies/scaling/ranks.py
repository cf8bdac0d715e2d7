"""What several processes of mpirun gain: FEniCSx' phases on one head, and blocks that no process holds whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import InputError
from ....lhm.base.limits import REPEATS
from ....lhm.base.option import option
from ....reference import Parameters, apply_law, facial_scene
from ...harness.study import Column, Row, Task, Values, at_most
from ..measures import NEO_HOOKEAN, PD_ENERGY
from ..person import OfPerson
from .blocks import compare_blocks
from .phases import PHASES, compare_phases

STRONG, WEAK = "strong", "weak"
FEWEST = 3000  # unknowns
AGREEMENT = 1e-10  # of the largest displacement


@dataclass(frozen=True)
class Ranks(OfPerson):
    """Counts of processes, the first of which is 1, on both energies of one head and on blocks.

    Strong scaling is one block by each count, weak scaling a block for each count whose unknowns grow with it.
    """

    name = "ranks"
    heading = "What do several processes gain?"
    question = (
        "How do FEniCSx' time and memory fall with the number of processes of mpirun, and do their answers agree?"
    )
    columns = (
        Column("processes", "processes"),
        Column("tets", "tets"),
        Column("unknowns", "unknowns"),
        *(Column(phase, f"{phase.replace('_', ' ')} [s]", cost=True) for phase in PHASES),
        Column("gain", "whole: times as fast as one process"),
        Column("seconds", "wall clock [s]", cost=True),
        Column("cpu_s", "processor time, largest process [s]", cost=True),
        Column("all_cpu_s", "of all [s]", cost=True),
        Column("iterations", "iterations", cost=True),
        Column("linear_iterations", "CG iterations", cost=True),
        Column("off", "off one process' answer, of the largest displacement"),
        Column("empty_mb", "largest process before [MB]", cost=True),
        Column("peak_mb", "the largest process [MB]", cost=True),
    )
    note = (
        "All solves end at a gradient norm of 1e-12 of their start. Of a head, energy, gradient and hessian are those "
        "of a state near rest. The first solve makes multigrid's levels and solves one system; the next solves another "
        "with new values. A block is neo-Hookean, of Poisson's ratio .45 and linear tets. Its figures are of reading, "
        "preparation and solve, compiled before. The system counts a process that waits for others as working. All "
        "gather the answer afterwards, to compare it."
    )
    timed = True

    processes: tuple[str, ...] = option(
        ("1", "2", "4"), "counts to compare, the first is 1; repeat", name="--processes"
    )
    expression: str = option("jawOpen*0.5", "of the head, as jawOpen*0.5+cheekPuff")
    rounds: int = option(2, "on the head, in which every count has its turn", bound=REPEATS)
    repeats: int = option(5, "of a phase in each round", bound=REPEATS)
    unknowns: tuple[str, ...] = option(("65000", "290000"), "of a block, about; repeat", name="--unknowns")

    @property
    def counts(self) -> tuple[int, ...]:
        """Of processes; InputError for other than 1 and others."""
        return parse_counts(self.processes)

    def tasks(self) -> Sequence[Task]:
        """List an energy of the head each, strong scaling at each size, and weak scaling at the first per process.

        Raises InputError for options out of range.
        """
        self.check([self.expression])
        if self.rounds < 1 or self.repeats < 1:
            raise InputError(f"rounds: {self.rounds}, repeats: {self.repeats}; expected 1 or more")
        if not self.unknowns or not all(text.isdecimal() and int(text) >= FEWEST for text in self.unknowns):
            raise InputError(f"unknowns: expected {FEWEST} or more each, got {', '.join(self.unknowns) or 'none'}")
        cases = [NEO_HOOKEAN, PD_ENERGY, *(f"{STRONG}, {size} unknowns" for size in self.unknowns)]
        cases.append(f"{WEAK}, {self.unknowns[0]} unknowns each")
        return [Task(case, f"{', '.join(map(str, self.counts))} processes") for case in cases]

    def measure(self, task: Task) -> Values:
        """Measure a row per count of processes."""
        if task.case not in (NEO_HOOKEAN, PD_ENERGY):
            kind, size = task.case.split(", ")
            return {"rows": compare_blocks(self.counts, int(size.split()[0]), each=kind == WEAK)}
        of = self.person()
        scene = facial_scene(of.head, Parameters(), of.shape(self.expression), bones="prescribed")
        scene = apply_law(scene, "neo-Hookean") if task.case == NEO_HOOKEAN else scene
        return {"rows": compare_phases(scene, self.counts, self.rounds, self.repeats)}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that there is one answer, where it was compared, and that all converged."""
        lines = [line for row in rows for line in row.values["rows"]]
        what = "distance to one process' answer, of the largest displacement"
        return [
            at_most(what, max(line["off"] for line in lines if line["off"] is not None), AGREEMENT),
            at_most("solves that did not converge", sum(not line["converged"] for line in lines), 0),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what a whole solve gains, and what the most processes hold of a block."""
        sentences = []
        for row in rows:
            first, *others = row.values["rows"]
            if "gain" in first:
                sentences += [
                    f"{row.case}: {line['processes']} processes solve {line['gain']:.2f} times as fast as one."
                    for line in others
                ]
                continue
            last = row.values["rows"][-1]
            sentences.append(
                f"{row.case.capitalize()}: the largest of {last['processes']} processes holds {last['peak_mb']:.0f} MB "
                f"and works {last['cpu_s']:.1f} s, one alone {first['peak_mb']:.0f} MB and {first['cpu_s']:.1f} s."
            )
        return " ".join(sentences)

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw the gain of each phase on the head."""
        rows = [row for row in rows if "gain" in row.values["rows"][0]]
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
