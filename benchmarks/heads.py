"""A campaign over many random identities: fit and check a head of each -> one line of JSON per head -> HTML."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from .. import lhm
from ..lhm import LayeredHead, Surface, Template, check_head, fit_head, identities, load_template
from ..lhm.errors import InputError, SoftdecaError
from ..lhm.files.alone import alone_in
from ..lhm.files.atomic import write_whole
from ..lhm.files.head_file import load_head
from ..lhm.identities.space import CLIP, LinearSpace
from ..lhm.progress import OnProgress
from ..lhm.template import DEFAULT_LEVEL
from ..surrogate.schedule import results_of, schedule
from . import machine
from .head_rows import HeadRows
from .heads_gallery import Shown, shown_head
from .heads_report import page, summary

LEAST_PAUSE = 2.0  # [s] between two words on progress


@dataclass(frozen=True)
class HeadsConfig:
    """Which heads: `count` identities of seeds `seed`, `seed` + 1, ... in a space ('anny' or 'ict:FILE').

    `sigma` is the largest coefficient of a code: a sample, which is clipped at 2.5, is scaled by sigma / 2.5.
    `level` is the template's. `gallery`: how many of them, and `own`, files of other heads, are simulated and drawn
    in the report.
    Raises InputError for a value outside its range.
    """

    identities: str = "anny"
    count: int = 1000
    sigma: float = CLIP
    seed: int = 0
    workers: int = 1
    out: Path = Path("out/heads")
    gallery: int = 0
    own: tuple[Path, ...] = ()
    level: int = DEFAULT_LEVEL

    def __post_init__(self):
        for name, least in (("count", 1), ("seed", 0), ("workers", 1), ("gallery", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{name}: must be at least {least}, got {getattr(self, name)}")
        if not (math.isfinite(self.sigma) and 0 < self.sigma <= 10):
            raise InputError(f"sigma: must be above 0 and at most 10, got {self.sigma:g}")

    @property
    def seeds(self) -> range:
        """The identities' seeds, one each, so that any one can be repeated alone."""
        return range(self.seed, self.seed + self.count)


def sample(space: LinearSpace, seed: int, sigma: float) -> Surface:
    """The neutral skin [mm] of one identity; at the default sigma that of `softdeca head fit --seed`."""
    code, skin = space.sample(np.random.default_rng(seed))
    return skin if sigma == CLIP else space.skin(code * (sigma / CLIP))


def run_heads(config: HeadsConfig, progress: OnProgress) -> dict:
    """Fit and check what is missing; write heads.jsonl as it goes, results.json and index.html; return the results.

    What is there of an earlier run is kept. Raises InputError if the folder holds another campaign, and SoftdecaError
    if a worker dies; a head that fails is a row with its reason.
    """
    own = [(str(path), load_head(path)) for path in config.own]
    with alone_in(config.out, "campaign"):
        space = identities.from_text(config.identities)
        template = load_template(space, level=config.level, progress=progress)
        campaign = {
            "identities": space.name,
            "space": _space_digest(space),
            "template": template.digest,
            "sigma": config.sigma,
            "code": _code_digest(),
        }
        rows = HeadRows(config.out, campaign)
        pending = [seed for seed in config.seeds if seed not in rows.by_seed]
        tell = _Rate(config.count, pending, progress)
        task = _Task(space, template, config.sigma)
        for row in results_of(task, pending, on=schedule(config.workers), name="heads"):
            rows.append(row)
            tell(rows, config)
        results = {
            "title": f"{config.count} heads of {space.name} at up to {config.sigma:g} standard deviations",
            "campaign": campaign | {"first_seed": config.seed, "count": config.count},
            "machine": machine.describe(),
            **summary([rows.by_seed[seed] for seed in config.seeds]),
        }
        shown = _gallery(config, _Task(space, template, config.sigma), own, rows, progress)
        results["gallery"] = [{"head": row.name, **row.figures} for row in shown]
        write_whole(config.out / "results.json", json.dumps(results, indent=1, allow_nan=False).encode())
        write_whole(config.out / "index.html", page(results, shown).encode())
    return results


def _gallery(
    config: HeadsConfig, task: _Task, own: Sequence[tuple[str, LayeredHead]], rows: HeadRows, progress: OnProgress
) -> list[Shown]:
    """The heads of one's own, and the first of the campaign that could be fitted."""
    seeds = [seed for seed in config.seeds if not rows.by_seed[seed]["error"]][: config.gallery]
    count = len(own) + len(seeds)
    shown: list[Shown] = []
    for name, head in (*own, *((f"seed {seed}", task.head(seed)) for seed in seeds)):
        progress(f"gallery: {name}", len(shown) / count)
        shown.append(shown_head(name, head))
    return shown


@dataclass(frozen=True, eq=False)
class _Task:
    """Fit and check the head of a seed, in this process or in another."""

    space: LinearSpace
    template: Template
    sigma: float
    warmed: list[bool] = field(default_factory=list)

    def warm(self) -> None:
        """What is done once per process, so that no head's time holds it."""
        check_head(fit_head(self.template, self.space.mean))

    def head(self, seed: int) -> LayeredHead:
        """The head of a seed."""
        return fit_head(self.template, sample(self.space, seed, self.sigma))

    def __call__(self, seed: int) -> dict:
        if not self.warmed:
            self.warmed.append(True)
            self.warm()
        row: dict = {"seed": seed, "error": None, "problems": [], "figures": None, "seconds": {}}
        begin = time.perf_counter(), time.process_time()
        try:
            head = self.head(seed)
            middle = time.perf_counter(), time.process_time()
            report = check_head(head)
        except Exception as error:
            # Also a failure that is no FitError: one head must not end a thousand, and the reason is told.
            reason = str(error) if isinstance(error, SoftdecaError) else f"{type(error).__name__}: {error}"
            return row | {"error": " ".join(reason.split())}
        end = time.perf_counter(), time.process_time()
        names = ("fit", "fit_cpu", "check", "check_cpu")
        spans = (middle[0] - begin[0], middle[1] - begin[1], end[0] - middle[0], end[1] - middle[1])
        row["seconds"] = {name: round(span, 4) for name, span in zip(names, spans, strict=True)}
        return row | {"figures": asdict(report), "problems": list(report.problems)}


class _Rate:
    """Says how many heads are done, how fast, how long the rest takes, and how many have failed."""

    def __init__(self, count: int, pending: list[int], progress: OnProgress):
        self._count, self._left, self._progress = count, len(pending), progress
        self._done, self._begin, self._said = 0, time.monotonic(), -math.inf

    def __call__(self, rows: HeadRows, config: HeadsConfig) -> None:
        self._done += 1
        self._left -= 1
        now = time.monotonic()
        if self._left and now - self._said < LEAST_PAUSE:
            return
        self._said = now
        rate = self._done / max(now - self._begin, 1e-9)
        found = [rows.by_seed[seed] for seed in config.seeds if seed in rows.by_seed]
        failed = sum(bool(row["error"] or row["problems"]) for row in found)
        words = f"{len(found)} of {self._count}, {failed} failed, {rate:.2f} heads/s, {self._left / rate:.0f} s left"
        self._progress(f"heads: {words}", len(found) / self._count)


def _space_digest(space: LinearSpace) -> str:
    # The fingerprint leaves out the identity directions, on which no template depends.
    return hashlib.sha256(space.fingerprint().encode() + np.ascontiguousarray(space.identity).tobytes()).hexdigest()[
        :12
    ]


def _code_digest() -> str:
    """A name for the code that is measured: rows of two versions must not be mixed."""
    folder = Path(lhm.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:12]
