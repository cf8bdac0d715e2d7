"""Effects of SoftDECA's Figures 1 and 7 on one head -> results.json, pictures and one HTML page."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..lhm import expressions, fit_head, identities, load_template
from ..lhm.errors import InputError
from ..lhm.files.alone import alone_in
from ..lhm.files.atomic import write_whole
from ..lhm.head import LayeredHead
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress
from ..reference import SOLVERS, Parameters
from . import machine
from .effect_cases import BROAD_SMILE, Effect, named_effects
from .effect_fan import ONE_MINIMUM, fan
from .effect_run import TOLERANCE, EffectResult, run_effect
from .effects_pictures import effect_pictures
from .effects_report import page
from .effects_surrogate import surrogate_skin
from .gates import at_most

ACCURACY = 0.01
"""How near [mm] answers must be to a tight run's, and to another solver's."""


@dataclass(frozen=True)
class EffectsConfig:
    """Which effects (names between commas, all if empty) on the head of a seed, and what they are compared with.

    `fan` random starts of a broad smile without an effect are solved too; `reference` is another solver, none if empty.
    Raises InputError for an unknown effect or solver, or a value outside its range.
    """

    effects: str = ""
    identities: str = "anny"
    seed: int = 0
    reference: str = ""
    fan: int = 0
    out: Path = Path("out/effects")

    def __post_init__(self):
        named_effects(self.effects)
        others = [solver for solver in SOLVERS if solver != "projective"]
        if self.reference and self.reference not in others:
            raise InputError(f"reference {self.reference!r}: expected one of {', '.join(others)}")
        for name in ("seed", "fan"):
            if getattr(self, name) < 0:
                raise InputError(f"{name}: must be at least 0, got {getattr(self, name)}")


def run_effects(config: EffectsConfig, progress: OnProgress) -> dict:
    """Solve and draw the effects; write results.json, NAME.png and index.html into config.out; return the results.

    Raises InputError for a folder in which another run of them works.
    """
    with alone_in(config.out, "run of effects"):
        space = identities.from_text(config.identities)
        template = load_template(space, progress=progress)
        code, skin = space.sample(np.random.default_rng(config.seed))
        head = fit_head(template, skin)
        asked = named_effects(config.effects)
        weights = [expressions.weights_of(dict(effect.expression)) for effect in asked]
        shapes = expressions.blend(space, code, np.array([*weights, expressions.weights_of(BROAD_SMILE)]))
        begin = time.perf_counter()
        done = _solve(head, asked, shapes, config.reference, progress)
        found = _fan(head, shapes[-1], config.fan, progress)
        results = {
            "title": f"effects on a head of {space.name}, seed {config.seed}",
            "identities": space.name,
            "seed": config.seed,
            "tets": len(head.tets),
            "effects": [result.record for result in done],
            "fan": found,
            "gates": effect_gates([result.record for result in done], found),
            "machine": machine.describe(),
            "seconds": round(time.perf_counter() - begin, 1),
        }
        write_whole(config.out / "results.json", json.dumps(results, indent=1, allow_nan=False).encode())
        networks = [surrogate_skin(space, code, head, effect) for effect in asked]
        pictures = effect_pictures(head, done, shapes, networks, progress)
        for name, png in pictures.items():
            write_whole(config.out / f"{name}.png", png)
        write_whole(config.out / "index.html", page(results, pictures).encode())
    return results


def _solve(
    head: LayeredHead, asked: Sequence[Effect], shapes: Floats, reference: str, progress: OnProgress
) -> list[EffectResult]:
    done = []
    for i, (effect, shape) in enumerate(zip(asked, shapes[:-1], strict=True)):
        progress(f"effects: {effect.name}", i / len(asked))
        done.append(run_effect(head, effect, shape, reference=reference or None))
    progress("effects", 1.0)
    return done


def _fan(head: LayeredHead, shape: Floats, count: int, progress: OnProgress) -> dict | None:
    if not count:
        return None
    return fan(head, Parameters(), shape, count, tell=lambda done: progress("fan of random starts", done / count))


def effect_gates(records: Sequence[dict], found: dict | None) -> list[dict]:
    """What the effects of `records`, and the fan where there is one, have to show: see `gates.at_most`."""
    runs = [(record, run) for record in records for run in record["runs"].values()]
    asked = [
        at_most(
            "largest gradient over its start's, of all scenes", max(run["gradient_ratio"] for _, run in runs), TOLERANCE
        ),
        at_most("scenes whose energy rises", sum(not run["monotone"] for _, run in runs), 0),
        at_most(
            "largest distance to a tight run from another start [mm]",
            max(record["to_other_start_mm"] for record in records),
            ACCURACY,
        ),
    ]
    compared = [record["reference"]["mm"] for record in records if record["reference"]]
    if compared:
        asked.append(at_most("largest distance to the reference solver [mm]", max(compared), ACCURACY))
    if found:
        asked.append(at_most("largest distance within the fan of random starts [mm]", found["spread_mm"], ONE_MINIMUM))
    return asked
