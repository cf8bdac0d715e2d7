"""Heads of many random identities, fitted and checked."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache

import numpy as np

from ....lhm import (
    HeadReport,
    Surface,
    Template,
    check_head,
    fit_head,
    identities,
    load_template,
)
from ....lhm.base.errors import SoftdecaError
from ....lhm.base.limits import SEED, STUDIED_HEADS
from ....lhm.base.option import option
from ....lhm.head.gates import Figure
from ....lhm.identities.space import LinearSpace
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..person import WHOSE, OfPerson

WORST = 5
FITTED = "fit and check"
FIGURES = {item.name: Figure(item.name, None, **item.metadata) for item in fields(HeadReport)} | {
    "fit_cpu_s": Figure("fit, processor", None, "s", None, None),
    "check_cpu_s": Figure("check, processor", None, "s", None, None),
}


@dataclass(frozen=True)
class Heads(OfPerson):
    """Random identities, of seeds from the study's on."""

    name = "heads"
    question = "Does every person get a valid head?"
    cheap = "seed 187, fit and check"
    columns = (
        Column("error", "could not be fitted because"),
        Column("problems", "gates missed"),
        Column("fit_cpu_s", "fit, processor [s]", cost=True),
        Column("check_cpu_s", "check, processor [s]", cost=True),
    )
    note = (
        "Each head counts once, with its smallest, mean or largest value. `softdeca bench heads --seed N --count 1` "
        "repeats seed N, and `softdeca head fit --seed N` does too."
    )

    identities: str = option("anny", WHOSE)
    seed: int = option(0, "seed of the first identity", bound=SEED)
    count: int = option(1000, "how many random identities", bound=STUDIED_HEADS)

    def tasks(self) -> Sequence[Task]:
        """List each identity."""
        self.check()
        return [Task(f"seed {seed}", FITTED) for seed in range(self.seed, self.seed + self.count)]

    def measure(self, task: Task) -> Values:
        """Measure a head's figures, or why there is none."""
        space, template = _load_space(self.identities, self.level)
        return try_fit(template, sample(space, int(task.case.split()[1])))

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that nearly every identity has a valid head."""
        failed = sum(bool(row.values["error"] or row.values["problems"]) for row in rows)
        what = f"heads of {len(rows)} that could not be fitted or miss a gate"
        return [at_most(what, failed, 1e-3 * len(rows))]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how many there are, and how long a fit takes."""
        seconds = list(collect_values(rows, "fit_cpu_s").values())
        took = f"; a fit takes {np.median(seconds):.2f} s of a processor (median)" if seconds else ""
        return f"{len(seconds)} of {len(rows)} random identities have a layered head{took}."

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate failures and their reasons, and distributions."""
        reasons = [(row.case, row.values["error"] or "; ".join(row.values["problems"])) for row in rows]
        unfit = [(case, reason) for case, reason in reasons if reason]
        head = ["figure", "gate", "missed by", "min", "5 %", "median", "mean", "95 %", "max", "worst seeds"]
        known = {name: collect_values(rows, name) for name in FIGURES}
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
    begin = time.process_time()
    try:
        head = fit_head(template, skin)
        fitted = time.process_time()
        report = check_head(head)
    except Exception as error:
        # Also a failure that is no FitError: the reason is told.
        reason = str(error) if isinstance(error, SoftdecaError) else f"{type(error).__name__}: {error}"
        return {"error": " ".join(reason.split()), "problems": [], "figures": None}
    seconds = {"fit_cpu_s": fitted - begin, "check_cpu_s": time.process_time() - fitted}
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
