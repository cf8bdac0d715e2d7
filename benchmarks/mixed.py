"""A head of incompressible tissue by quadratic tets with a pressure: seconds, memory, iterations and volumes kept."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..lhm import expressions
from ..lhm.errors import InputError
from ..lhm.head import LayeredHead
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress
from ..lhm.template import DEFAULT_LEVEL, LEVELS
from ..reference import Parameters, Scene, facial_scene, materials, neo_hookean_scene, prepare, terms
from . import machine
from .apart import apart, peak_megabytes
from .throughput import default_head

EXPRESSIONS = ("jawOpen*0.5", "mouthSmileLeft*0.6+mouthSmileRight*0.6")
LAWS = ("incompressible", "0.499")
MEMORY_MB = 8000.0
"""What a solve on the default head may take."""


@dataclass(frozen=True)
class MixedConfig:
    """Which expressions of the default head, and laws: "incompressible" or a Poisson's ratio as text.

    `level` is the template's. Raises InputError for what cannot be read.
    """

    expressions: tuple[str, ...] = EXPRESSIONS
    laws: tuple[str, ...] = LAWS
    seed: int = 0
    level: int = DEFAULT_LEVEL
    tolerance: float = 1e-6

    def __post_init__(self):
        for text in self.expressions:
            expressions.parsed(text)
        for law in self.laws:
            _poisson(law)
        if self.level not in LEVELS:
            raise InputError(f"level: there are {', '.join(map(str, LEVELS))}, got {self.level}")


def _poisson(law: str) -> float | None:
    """Poisson's ratio of a law's name, None for "incompressible"."""
    if law == "incompressible":
        return None
    try:
        nu = float(law)
    except ValueError:
        nu = -1.0
    if not 0.0 < nu < 0.5:
        raise InputError(f"law {law!r}: expected 'incompressible' or a Poisson's ratio between 0 and 0.5")
    return nu


def run_mixed(config: MixedConfig, progress: OnProgress) -> dict:
    """Solve each expression by each law in a process of its own; `solves` has a row each, see `solved`."""
    progress("mixed: the head", 0.0)
    space, code, head = default_head(config.seed, config.level)
    shapes = expressions.blend(space, code, np.array([expressions.parsed(text) for text in config.expressions]))
    cases = [(name, shape, law) for name, shape in zip(config.expressions, shapes, strict=True) for law in config.laws]
    rows = []
    for i, (name, shape, law) in enumerate(cases):
        progress(f"mixed: {name}, {law}", i / len(cases))
        row = apart(solved, head, shape, law, config.tolerance)
        rows.append({"expression": name, "law": law, **row})
    progress("mixed", 1.0)
    return {"solves": rows, "tolerance": config.tolerance, "machine": machine.describe()}


def solved(head: LayeredHead, shape: Floats, law: str, tolerance: float) -> dict:
    """A solve by element P2P1, to be called in a fresh process: wall and processor time [s], memory [MB], iterations.

    `volume` is the volume of all tissue by that at rest, `smallest` the smallest volume ratio between tets' corners.
    """
    scene = mixed_scene(head, shape, _poisson(law))
    wall, cpu = time.perf_counter(), time.process_time()
    solution = prepare(scene, solver="fenicsx", element="P2P1").solve(tolerance=tolerance)
    return {
        "tets": len(scene.tets),
        "reason": solution.reason.name,
        "converged": solution.converged,
        "iterations": solution.iterations,
        "factorisations": int(solution.detail["linear_solves"]),
        "seconds": time.perf_counter() - wall,
        "cpu_seconds": time.process_time() - cpu,
        "memory_mb": peak_megabytes(),
        "energy": solution.energy,
        "volume": float((solution.volume_ratio @ scene.volumes) / scene.volumes.sum()),
        "smallest": float(solution.volume_ratio.min()),
    }


def mixed_scene(head: LayeredHead, shape: Floats, poisson: float | None) -> Scene:
    """The neo-Hookean facial scene of an expression with prescribed bones, incompressible or of a Poisson's ratio."""
    scene = neo_hookean_scene(facial_scene(head, Parameters(), shape, bones="prescribed"))
    return replace(scene, terms=tuple(_with_law(term, poisson) for term in scene.terms))


def _with_law(term: terms.Term, poisson: float | None) -> terms.Term:
    if not isinstance(term, terms.Hyperelastic):
        return term
    law = term.material
    assert isinstance(law, materials.NeoHookean)
    if poisson is None:
        return replace(term, material=materials.Incompressible(law))
    return replace(term, material=materials.NeoHookean.from_young(2 * law.mu * (1 + poisson), poisson))


def lines(rows: Iterable[dict]) -> list[str]:
    """A line per solve for the terminal."""
    return [
        f"{'ok  ' if row['converged'] else row['reason']} {row['expression']:<44} {row['law']:<15} "
        f"{row['tets']} tets  {row['iterations']} iterations  {row['seconds']:.0f} s  CPU {row['cpu_seconds']:.0f} s  "
        f"{row['memory_mb']:.0f} MB  volume {row['volume']:.5f}"
        for row in rows
    ]
