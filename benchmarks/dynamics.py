"""softdeca bench dynamics: a released cheek and a shaken head by Eq. 9, PD and FEM -> results.json and a page."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..lhm import LayeredHead, fit_head, identities, load_template
from ..lhm.errors import InputError
from ..lhm.files.alone import alone_in
from ..lhm.files.atomic import write_whole
from ..lhm.progress import OnProgress
from . import machine
from .dynamics_plots import released
from .dynamics_study import study
from .report import machine_rows, rendered


@dataclass(frozen=True)
class DynamicsConfig:
    """Whose head, of how many vertices (`level` of its template), over how many frames at 60 Hz.

    Raises InputError for a level other than 1, 2, 3 and fewer than 8 frames, too few to fit a swing to.
    """

    identities: str = "anny"
    seed: int = 0
    level: int = 1
    frames: int = 24
    out: Path = Path("out/dynamics")

    def __post_init__(self):
        if self.level not in (1, 2, 3):
            raise InputError(f"level: there are 1, 2 and 3, got {self.level}")
        if self.frames < 8:
            raise InputError(f"frames: at least 8 are needed, got {self.frames}")


def run_dynamics(config: DynamicsConfig, progress: OnProgress) -> dict:
    """Make the head, study it; write results.json and index.html into config.out; return the results."""
    with alone_in(config.out, "run of dynamics"):
        space = identities.from_text(config.identities)
        template = load_template(space, level=config.level, progress=progress)
        head = fit_head(template, space.sample(np.random.default_rng(config.seed))[1])
        begin = time.perf_counter()
        results = {
            "title": f"dynamics of a head of {space.name}, seed {config.seed}",
            **study(head, cheek(head), config.frames, progress),
            "seconds": time.perf_counter() - begin,
            "machine": machine.describe(),
        }
        write_whole(config.out / "results.json", json.dumps(results, indent=1, allow_nan=False).encode())
        write_whole(config.out / "index.html", page(results).encode())
        progress("dynamics", 1.0)
        return results


def cheek(head: LayeredHead) -> int:
    """The skin wrap's vertex of the face nearest to 45 mm beside the lips."""
    wrap, face = head.skin_wrap.vertices, np.flatnonzero(head.regions["face"])
    beside = wrap[head.regions["lips"]].mean(axis=0)[:2] + [45.0, 0.0]
    return int(face[np.linalg.norm(wrap[face, :2] - beside, axis=1).argmin()])


def page(results: Mapping) -> str:
    """The self-contained report."""

    def cells(rows: Sequence[Mapping], *keys: str) -> list[list]:
        return [[row.get(key) for key in keys] for row in rows]

    return rendered(
        "dynamics.html",
        results,
        plot=released(results["traces"], [name for name in results["traces"] if not name.endswith("2 per frame")]),
        release_rows=cells(
            results["release"],
            *(
                "name",
                "steps_per_s",
                "frequency",
                "damping",
                "misfit",
                "lost",
                "iterations",
                "factorisations",
                "stopped",
            ),
        ),
        step_rows=cells(results["steps"], "name", "per_frame", "rms_mm", "peak_mm", "order"),
        own_rows=cells(results["own_mass"], "name", "frequency", "decay", "to_a_tenth_s", "stopped"),
        shake_rows=cells(results["shake"]["rows"], "name", "peak_mm", "off_mm", "stopped"),
        gate_rows=cells(results["gates"], "what", "value", "bound", "passed"),
        machine_rows=[*machine_rows(results["machine"]), ("seconds", results["seconds"])],
    )
