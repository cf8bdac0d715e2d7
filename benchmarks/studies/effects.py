"""Effects of SoftDECA's Figures 1 and 7 on one head, with pictures, and a fan of random starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ...lhm.errors import InputError
from ...lhm.expressions import weights_of
from ...reference import SOLVERS, Parameters
from ..effect_cases import BROAD_SMILE, EFFECTS, named_effects
from ..effect_fan import ONE_MINIMUM, fan
from ..effect_run import TOLERANCE, run_effect
from ..effects_pictures import effect_pictures
from ..effects_surrogate import surrogate_skin
from ..harness.gates import at_most
from ..harness.runner import Row
from ..harness.study import Column, Table, Task, Values
from .person import OfPerson

ACCURACY = 0.01
"""How near [mm] answers must be to a tight run's, and to another solver's."""
STARTS = "a broad smile from random starts"


@dataclass(frozen=True)
class Effects(OfPerson):
    """Effects on one head; `fan` random starts of a broad smile without an effect; beside another solver."""

    name = "effects"
    heading = "What do palsy, weight and the other effects do to a face?"
    question = "Palsy, weight, jaw, zombie, gravity, wrinkles: what do they do to a face, and is the answer the answer?"
    columns = (
        Column("shown", "what the paper shows"),
        Column("neutral_change_mm", "neutral face moves, max [mm]"),
        Column("mean_mm", "changes the expression, mean [mm]"),
        Column("max_mm", "max [mm]"),
        Column("iterations", "iterations", cost=True),
        Column("solve_s", "prepare and solve [s]", cost=True),
        Column("to_own_limit_mm", "to its own limit [mm]"),
        Column("to_other_start_mm", "to a tight run from another start [mm]"),
        Column("reference_mm", "to the other solver [mm]"),
        Column("reference_s", "its time [s]", cost=True),
        Column("spread_mm", "farthest answer of the starts [mm]"),
    )
    note = (
        "Each expression is solved by PD with and without its effect, from the neutral face that has come to rest, the "
        "mandible a free rigid body. The other start: all wraps moved by the skin's way to its targets, which inverts "
        "tets. The paper is silent about targets of a face that has changed: where an effect changes the neutral face, "
        "the targets of what is fleshy let go of it, bones stay at their scaled rest, and it comes to rest; its "
        "displacement is then added to the targets of the expression. Flesh is the neck and the face below the brow, "
        "but for lips, lids, mouth, eyes, teeth and ears, and fades in over 12 mm along the skin."
    )

    effects: tuple[str, ...] = field(
        default=(), metadata={"help": f"of {', '.join(e.name for e in EFFECTS)}; repeat for several  [all]"}
    )
    reference: str = field(default="", metadata={"help": "compare with fenicsx or skfem too"})
    fan: int = field(default=0, metadata={"help": "random starts of a broad smile without an effect"})

    def tasks(self) -> Sequence[Task]:
        """Each effect, and the fan; InputError for an unknown effect or solver, and fewer starts than none."""
        self.check()
        others = [solver for solver in SOLVERS if solver != "projective"]
        if self.reference and self.reference not in others:
            raise InputError(f"reference {self.reference!r}: expected one of {', '.join(others)}")
        if self.fan < 0:
            raise InputError(f"fan: must be at least 0, got {self.fan}")
        method = f"PD beside {self.reference}" if self.reference else "PD"
        found = [Task(effect.name, method) for effect in named_effects(",".join(self.effects))]
        return found + ([Task(STARTS, f"PD, {self.fan} of them")] if self.fan else [])

    def measure(self, task: Task) -> Values:
        """The solves of an effect, and its pictures."""
        of = self.person()
        if task.case == STARTS:
            return fan(of.head, Parameters(), of.blend(weights_of(BROAD_SMILE)[None])[0], self.fan)
        (effect,) = named_effects(task.case)
        shape = of.blend(weights_of(dict(effect.expression))[None])[0]
        result = run_effect(of.head, effect, shape, reference=self.reference or None)
        record, run = result.record, result.record["runs"]["with"]
        compared = record["reference"] or {"mm": None, "seconds": None}
        network = surrogate_skin(of.space, of.code, of.head, effect)
        return {
            **record,
            "mean_mm": record["change_mm"]["mean"],
            "max_mm": record["change_mm"]["max"],
            "iterations": run["iterations"],
            "solve_s": run["seconds"],
            "reference_mm": compared["mm"],
            "reference_s": compared["seconds"],
            **effect_pictures(of.head, result, shape, network),
        }

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """All converge to one minimum, whose energy falls, and which another solver finds."""
        records, fans = _apart(rows)
        found = []
        if records:
            runs = [run for record in records for run in record["runs"].values()]
            other = "largest distance to a tight run from another start [mm]"
            found = [
                at_most("largest gradient over its start's", max(run["gradient_ratio"] for run in runs), TOLERANCE),
                at_most("scenes whose energy rises", sum(not run["monotone"] for run in runs), 0),
                at_most(other, max(record["to_other_start_mm"] for record in records), ACCURACY),
            ]
        compared = [record["reference"]["mm"] for record in records if record["reference"]]
        if compared:
            found.append(at_most("largest distance to the reference solver [mm]", max(compared), ACCURACY))
        what = "largest distance within the fan of random starts [mm]"
        return found + [at_most(what, values["spread_mm"], ONE_MINIMUM) for values in fans]

    def words(self, rows: Sequence[Row]) -> str:
        """What changes most, and how sure that is."""
        records, fans = _apart(rows)
        said = ""
        if records:
            most = max(records, key=lambda record: record["max_mm"])
            off = max(record["to_other_start_mm"] for record in records)
            said = (
                f"Of {len(records)} effects {most['name']} changes the expression most, by {most['max_mm']:.1f} mm; "
                f"from other starts all end within {off:.1e} mm. "
            )
        return said + "".join(
            f"{len(values['starts'])} random starts of a broad smile end within {values['spread_mm']:.1e} mm."
            for values in fans
        )

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Every scene, and every start."""
        records, fans = _apart(rows)
        keys = (
            "iterations seconds gradient_ratio monotone largest_rise inverted_tets smallest_volume_ratio "
            "soft_volume_percent"
        ).split()
        titles = [
            "effect", "scene", "iterations", "prepare and solve [s]", "gradient over its start's", "energy falls",
            "largest rise", "inverted tets", "smallest volume ratio", "soft tissue's volume [%]",
        ]  # fmt: skip
        scenes = [
            (record["name"], name, *(run[key] for key in keys))
            for record in records
            for name, run in record["runs"].items()
        ]
        found = [Table("Scenes", titles, scenes, "A rise by a share of 1e-12 is rounding.")] if scenes else []
        keys = "seed moved jitter_mm iterations converged energy inverted_tets to_lowest_mm".split()
        titles = [
            "start",
            "moved",
            "by [mm]",
            "iterations",
            "converged",
            "energy [mN mm]",
            "inverted",
            "to lowest [mm]",
        ]
        for values in fans:
            starts = [tuple(row[key] for key in keys) for row in values["starts"]]
            found.append(Table("Random starts", titles, starts))
            if values["suspects"]:
                traced = sorted(values["suspects"].items(), key=lambda pair: pair[1])
                caption = "The two starts that end farthest apart, solved again with one term changed"
                found.append(Table(caption, ["changed", "apart [mm]"], traced))
        return found


def _apart(rows: Sequence[Row]) -> tuple[list[Values], list[Values]]:
    """The effects' records, and those of the fan."""
    fans = [row.values for row in rows if row.case == STARTS]
    return [row.values for row in rows if row.case != STARTS], fans
