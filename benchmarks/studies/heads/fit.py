"""Heads of many random identities, fitted and checked, and a gallery of some as they move."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ....animation.head_pictures import FRONT, LARGEST_GAP
from ....animation.pictures import Panel, draw_cut_away, draw_strip
from ....lhm import (
    HeadReport,
    LayeredHead,
    Surface,
    Template,
    check_head,
    expressions,
    fit_head,
    identities,
    load_template,
)
from ....lhm.base.errors import SoftdecaError
from ....lhm.base.geometry.bvh import TriangleTree
from ....lhm.base.limits import DRAWN_HEADS, SEED, STUDIED_HEADS
from ....lhm.base.option import option
from ....lhm.head.file import load_head
from ....lhm.head.gates import Figure
from ....lhm.identities.space import LinearSpace
from ....reference import Parameters, facial_scene, solve
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..measures import Stopwatch
from ..person import WHOSE, OfPerson

POSES = {
    "jawOpen": ("jawOpen",),
    "smile": ("mouthSmileLeft", "mouthSmileRight"),
    "blink": ("eyeBlinkLeft", "eyeBlinkRight"),
}
SIZE = 300


def draw_moving_head(head: LayeredHead) -> Values:
    """Simulate and draw a head that has a rig (some ten seconds). InputError without one."""
    skin = head.skin
    gap = TriangleTree(head.skin_wrap.vertices, head.skin_wrap.triangles).closest(skin.vertices)[2]
    panels = [Panel("distance to its wrap", skin, gap, LARGEST_GAP)]
    for pose, names in POSES.items():
        shape = head.expression(expressions.weights_of(dict.fromkeys(names, 1.0)))
        solution = solve(facial_scene(head, Parameters(), shape), solver="projective")
        moved = head.skin_after(shape, solution.positions[: len(head.bone)])
        panels.append(Panel(pose, skin.with_vertices(moved)))
    faces = draw_strip(panels, view=FRONT, size=SIZE, framed=head.skin_wrap.vertices, rest=skin)
    return {"as it moves": faces, "cut open": draw_cut_away(head, size=SIZE)}


WORST = 5
FITTED, DRAWN = "fit and check", "simulated and drawn"
FIGURES = {item.name: Figure(item.name, None, **item.metadata) for item in fields(HeadReport)} | {
    "fit_cpu_s": Figure("fit, processor", None, "s", None, None),
    "check_cpu_s": Figure("check, processor", None, "s", None, None),
}


@dataclass(frozen=True)
class Heads(OfPerson):
    """Random identities, of seeds from the study's on."""

    name = "heads"
    heading = "Does every person get a valid head?"
    question = "Does every identity get a valid head, in how long, and what does it look like when it moves?"
    cheap = "seed 187, fit and check"
    columns = (
        Column("error", "could not be fitted because"),
        Column("problems", "gates missed"),
        Column("fit_cpu_s", "fit, processor [s]", cost=True),
        Column("check_cpu_s", "check, processor [s]", cost=True),
    )
    note = (
        "Each head counts once, with its smallest, mean or largest value. `softdeca bench heads --seed N --count 1` "
        "repeats seed N, and `softdeca head fit --seed N` does too. The gallery shows "
        "expressions at full weight, simulated by projective dynamics with default parameters."
    )

    identities: str = option("anny", WHOSE)
    seed: int = option(0, "seed of the first identity", bound=SEED)
    count: int = option(1000, "how many random identities", bound=STUDIED_HEADS)
    gallery: int = option(2, "how many of them are simulated and drawn", bound=DRAWN_HEADS)
    heads: tuple[str, ...] = option((), "a head file, drawn as well; repeat for several")

    def tasks(self) -> Sequence[Task]:
        """List each identity, and the gallery; InputError for a file without a head."""
        self.check()
        for path in self.heads:
            load_head(Path(path))
        seeds = [f"seed {seed}" for seed in range(self.seed, self.seed + self.count)]
        drawn = [*self.heads, *seeds[: self.gallery]]
        return [*(Task(case, FITTED) for case in seeds), *(Task(case, DRAWN) for case in drawn)]

    def measure(self, task: Task) -> Values:
        """Measure a head's figures, or why there is none; or its pictures."""
        space, template = _load_space(self.identities, self.level)
        seed = None if task.case in self.heads else int(task.case.split()[1])
        if task.method == FITTED:
            assert seed is not None
            return try_fit(template, sample(space, seed))
        head = load_head(Path(task.case)) if seed is None else fit_head(template, sample(space, seed))
        return draw_moving_head(head)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that nearly every identity has a valid head."""
        fits = [row.values for row in rows if row.method == FITTED]
        failed = sum(bool(values["error"] or values["problems"]) for values in fits)
        what = f"heads of {len(fits)} that could not be fitted or miss a gate"
        return [at_most(what, failed, 1e-3 * len(fits))]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how many there are, and how long a fit takes."""
        fits = [row for row in rows if row.method == FITTED]
        seconds = list(collect_values(fits, "fit_cpu_s").values())
        took = f"; a fit takes {np.median(seconds):.2f} s of a processor (median)" if seconds else ""
        return f"{len(seconds)} of {len(fits)} random identities have a layered head{took}."

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate failures and their reasons, and distributions."""
        fits = [row for row in rows if row.method == FITTED]
        reasons = [(row.case, row.values["error"] or "; ".join(row.values["problems"])) for row in fits]
        unfit = [(case, reason) for case, reason in reasons if reason]
        head = ["figure", "gate", "missed by", "min", "5 %", "median", "mean", "95 %", "max", "worst seeds"]
        known = {name: collect_values(fits, name) for name in FIGURES}
        figures = [_describe_figure(FIGURES[name], values) for name, values in known.items() if values]
        return [
            *([Table("Failures", ["head", "reason"], unfit)] if unfit else []),
            *([Table("Distributions", head, figures)] if figures else []),
        ]


@lru_cache(maxsize=1)
def _load_space(whose: str, level: int) -> tuple[LinearSpace, Template]:
    space = identities.from_text(whose)
    template = load_template(space, level=level)
    check_head(fit_head(template, space.mean))  # what is done once per process is in no head's time
    return space, template


def sample(space: LinearSpace, seed: int) -> Surface:
    """Sample the neutral skin [mm] of one identity, that of `softdeca head fit --seed`."""
    return space.sample(np.random.default_rng(seed))[1]


def try_fit(template: Template, skin: Surface) -> dict:
    """Fit a head to a skin: figures, missed gates and seconds; or why it has none, which is an outcome of the study."""
    watch = Stopwatch()
    try:
        head = fit_head(template, skin)
        fit = watch.lap()[1]
        report = check_head(head)
    except Exception as error:
        # Also a failure that is no FitError: the reason is told.
        reason = str(error) if isinstance(error, SoftdecaError) else f"{type(error).__name__}: {error}"
        return {"error": " ".join(reason.split()), "problems": [], "figures": None}
    seconds = {"fit_cpu_s": fit, "check_cpu_s": watch.lap()[1]}
    return {"error": None, "problems": list(report.problems), "figures": asdict(report), **seconds}


def collect_values(rows: Iterable[Row], name: str) -> dict[str, float]:
    """Collect one of FIGURES, by seed, of all heads that have it."""
    found = {row.case.split()[1]: {**row.values, **(row.values["figures"] or {})}.get(name) for row in rows}
    return {seed: float(value) for seed, value in found.items() if value is not None}


def _describe_figure(figure: Figure, values: Mapping[str, float]) -> list:
    """A row: the seeds are those nearest to the wrong side of the bound, else of the largest values."""
    x = np.array(list(values.values()))
    worst = sorted(values, key=lambda seed: values[seed], reverse=figure.direction not in ("at least", "above"))
    missed = sum(replace(figure, value=value).missed for value in values.values())
    unit = f" [{figure.unit}]" if figure.unit else ""
    spread = (x.min(), np.quantile(x, 0.05), np.median(x), x.mean(), np.quantile(x, 0.95), x.max())
    gate = [figure.limit, missed] if figure.limit else [None, None]
    return [figure.words + unit, *gate, *map(float, spread), ", ".join(worst[:WORST])]
