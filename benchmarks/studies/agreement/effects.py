"""Effects of SoftDECA's Figures 1 and 7 on one head, with pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....reference import SOLVERS
from ....surrogate.methods import CARRIED, NETWORK, PD, SETTLED
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..measures import NEO_HOOKEAN, PD_ENERGY
from ..person import OfPerson, check_known
from .effect import (
    EFFECTS,
    SOLVED,
    TOLERANCE,
    EffectResult,
    apply_rules,
    compare_laws,
    measure_skins,
    parse_effects,
    predict_skin,
    run_effect,
)
from .effect_pictures import draw_effect
from .insides import tabulate_insides

ACCURACY = 0.01
"""How near [mm] answers must be to a tight run's, and to another solver's.

Of PD beside FEniCSx this excludes the neo-Hookean law, whose largest distance is 0.02 to 0.4 mm over the effects, and
the surrogate and the rules without physics, which are 0.15 to 15 mm off.
"""
NO_REFERENCE = "none"
METHODS = (PD, *SOLVED["fenicsx"], *SOLVED["skfem"], NETWORK, CARRIED, SETTLED)


@dataclass(frozen=True)
class Effects(OfPerson):
    """Effects on one head, by PD and beside another solver."""

    name = "effects"
    heading = "What do palsy, weight and the other effects do to a face?"
    question = "What do palsy, weight, jaw, zombie, gravity, wrinkles, contact do to a face, and is the answer unique?"
    columns = (
        Column("shown", "what the paper shows"),
        Column("neutral_change_mm", "neutral face moves, max [mm]"),
        Column("mean_mm", "changes the expression, mean [mm]"),
        Column("max_mm", "max [mm]"),
        Column("contact_depth_before", "lips overlap without contact [mm]"),
        Column("contact_depth_after", "with contact [mm]"),
        Column("iterations", "iterations", cost=True),
        Column("solve_s", "prepare and solve [s]", cost=True),
        Column("to_own_limit_mm", "to its own limit [mm]"),
        Column("to_other_start_mm", "to a tight run from another start [mm]"),
        Column("same_mm", "PD to finite elements, same energy, max [mm]"),
        Column("law_mean_mm", "PD to neo-Hookean, skin, mean [mm]"),
        Column("law_max_mm", "max [mm]"),
        Column("law_inside_mm", "all vertices, max [mm]"),
    )
    note = (
        "PD solves each expression with and without its effect, from the settled neutral face, with a free rigid "
        "mandible. The other start moves all wraps by the skin's way to its targets, which inverts tets. The paper "
        "does not say what targets a changed face has. Where an effect changes the neutral face, fleshy targets let "
        "go of it, bones stay at their scaled rest, and it settles. Its displacement is then added to the targets of "
        "the expression. Flesh is the neck and the face below the brow, except lips, lids, mouth, eyes, teeth and "
        "ears; it fades in over 12 mm along the skin. Each law settles the neutral face itself. Shares are of T less "
        "blendshapes that bones carry, over vertices that this moves by more than 0.05 mm. In an expression the "
        "mandible is free: the law's load on it is the one that holds it where PD has it. In the settled neutral face "
        "bones are prescribed, and each law has its load."
    )
    version = 2

    effects: tuple[str, ...] = option((), f"of {', '.join(e.name for e in EFFECTS)}; repeat for several  [all]")
    reference: str = option("fenicsx", "by which PD's energy and a law are solved too: fenicsx, skfem or none")

    def tasks(self) -> Sequence[Task]:
        """List each effect; InputError for an unknown effect or solver."""
        self.check()
        known = [*(solver for solver in SOLVERS if solver != "projective"), NO_REFERENCE]
        check_known("reference", [self.reference], known)
        tasks = []
        for effect in parse_effects(",".join(self.effects)):
            tasks.append(Task(effect.name, PD))
            if self.reference != NO_REFERENCE and not effect.contact:  # FEniCSx models no contact
                tasks.append(Task(effect.name, f"both laws by {self.reference}"))
        return tasks

    def measure(self, task: Task) -> Values:
        """Solve and draw an effect by PD; or solve its laws by finite elements."""
        of = self.person()
        result, shape, others = _solve(self, task.case)
        if task.method != PD:
            (effect,) = parse_effects(task.case)
            comparison = compare_laws(of.head, effect, shape, result, self.reference, others)
            law, inside = comparison["to_pd"][SOLVED[self.reference][1]], comparison["inside"]["vertices"]["max"]
            return comparison | {
                "law_mean_mm": law["skin_mean"],
                "law_max_mm": law["skin_max"],
                "law_inside_mm": inside,
            }
        record, run = result.record, result.record["runs"]["with"]
        return {
            **record,
            "mean_mm": record["change_mm"]["mean"],
            "max_mm": record["change_mm"]["max"],
            "iterations": run["iterations"],
            "solve_s": run["seconds"],
            "to_pd": measure_skins(others, result.with_it, others[CARRIED]),
            **draw_effect(of.head, result, shape, others.get(NETWORK)),
        }

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all converge to one minimum, whose energy falls, and which another solver finds."""
        records, laws = _sort_rows(rows)
        gates = []
        if records:
            runs = [run for record in records for run in record["runs"].values()]
            other = "largest distance to a tight run from another start [mm]"
            gates = [
                at_most("largest gradient over its start's", max(run["gradient_ratio"] for run in runs), TOLERANCE),
                at_most("scenes whose energy rises", sum(run["monotone"] is False for run in runs), 0),
                at_most(other, max(record["to_other_start_mm"] for record in records), ACCURACY),
            ]
        if laws:
            same = "largest distance of PD to finite elements, same energy, each settled by itself [mm]"
            gates += [
                at_most(same, max(law["same_mm"] for law in laws), ACCURACY),
                at_most(
                    "effects with a finite-element run that did not converge", sum(not law["done"] for law in laws), 0
                ),
            ]
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what changes most and how sure that is, how far the law is from PD, and the others from the law."""
        records, laws = _sort_rows(rows)
        sentences = []
        if records:
            most = max(records, key=lambda record: record["max_mm"])
            off = max(record["to_other_start_mm"] for record in records)
            sentences.append(
                f"Of {len(records)} effects {most['name']} changes the expression most, by {most['max_mm']:.1f} mm; "
                f"from other starts all end within {off:.1e} mm."
            )
        if laws:
            vertices = [law["inside"]["vertices"] for law in laws]
            sentences.append(
                "With the neutral face settled by each law itself, the neo-Hookean law moves the skin by "
                f"{_format_range(law['law_mean_mm'] for law in laws)} mm on average and "
                f"{_format_range(law['law_max_mm'] for law in laws)} mm at most, all vertices by "
                f"{_format_range(each['mean'] for each in vertices)} mm on average and "
                f"{_format_range(each['max'] for each in vertices)} mm at most."
            )
        for method in (NETWORK, CARRIED, SETTLED):
            means = [law["to_law"][method]["skin_mean"] for law in laws if method in law["to_law"]]
            sentences += [f"From that law's skin, {method}: {_format_range(means)} mm on average."] if means else []
        return " ".join(sentences)

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate each method beside PD and beside the law, what lies inside, and every scene."""
        records, laws = _sort_rows(rows)
        columns = {
            "effect": "effect", "scene": "scene", "iterations": "iterations", "seconds": "prepare and solve [s]",
            "gradient_ratio": "gradient over its start's", "monotone": "energy falls", "largest_rise": "largest rise",
            "inverted_tets": "inverted tets", "smallest_volume_ratio": "smallest volume ratio",
            "soft_volume_percent": "soft tissue's volume [%]",
        }  # fmt: skip
        scenes = [
            {"effect": record["name"], "scene": name, **run}
            for record in records
            for name, run in record["runs"].items()
        ]
        tables = [_tabulate_methods(rows)] if records or laws else []
        tables += tabulate_insides(rows, PD_ENERGY, NEO_HOOKEAN)
        if scenes:
            tables.append(Table.of("Scenes", columns, scenes, "A rise by a share of 1e-12 is rounding."))
        return tables


@lru_cache(maxsize=1)
def _solve(study: Effects, name: str) -> tuple[EffectResult, Floats, dict[str, Floats]]:
    """PD's answer to an effect, its expression's blendshapes [mm], and the skins [mm] of methods without a solver."""
    of, (effect,) = study.person(), parse_effects(name)
    shape = of.blend(effect.weights()[None])[0]
    result = run_effect(of.head, effect, shape)
    skins = apply_rules(of.head, shape, result.at_rest)
    network = predict_skin(of.space, of.code, of.head, effect)
    return result, shape, skins if network is None else {NETWORK: network, **skins}


def _format_range(values: Iterable[float]) -> str:
    numbers = list(values)
    return f"{min(numbers):.3f}" if len(numbers) == 1 else f"{min(numbers):.3f} to {max(numbers):.3f}"


def _tabulate_methods(rows: Sequence[Row]) -> Table:
    """An effect's methods, each beside PD's skin and beside the neo-Hookean law's."""
    titles = ["effect", "method"]
    for truth in (PD_ENERGY, NEO_HOOKEAN):
        titles += [f"to {truth}: mean [mm]", "max [mm]", "share"]
    to_pd, to_law = ({}, {})
    for row in rows:
        for method, figures in row.values.get("to_pd", {}).items():
            to_pd[row.case, method] = figures
        for method, figures in row.values.get("to_law", {}).items():
            to_law[row.case, method] = figures
    cells = []
    for case in dict.fromkeys(row.case for row in rows):
        for method in METHODS:
            of_both = [of.get((case, method), {}) for of in (to_pd, to_law)]
            if any(of_both):
                figures = [each.get(key) for each in of_both for key in ("skin_mean", "skin_max", "share")]
                cells.append((case, method, *figures))
    note = "Mean and max over the skin; shares by the ruler of surrogates, over vertices that more than bones move."
    return Table("Each method beside PD, and beside the neo-Hookean law", titles, cells, note)


def _sort_rows(rows: Sequence[Row]) -> tuple[list[Values], list[Values]]:
    """The effects' records of PD, and those of laws."""
    effects = [row.values for row in rows]
    return [v for v in effects if "runs" in v], [v for v in effects if "inside" in v]
