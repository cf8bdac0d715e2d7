"""A head of incompressible tissue by quadratic tets with a pressure: seconds, memory, iterations and volumes kept."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from ...lhm.errors import InputError
from ...lhm.head import LayeredHead
from ...lhm.mesh import Floats
from ...reference import Parameters, Scene, facial_scene, materials, neo_hookean_scene, prepare, terms
from ..harness.gates import at_most
from ..harness.runner import Row
from ..harness.study import Column, Task, Values
from ..plots import subplots, svg
from .person import OfPerson

MEMORY_MB = 8000.0
"""What a solve on the default head may take."""


@dataclass(frozen=True)
class Mixed(OfPerson):
    """Expressions of the default head by laws: "incompressible" or a Poisson's ratio as text."""

    name = "mixed"
    heading = "What does an incompressible head cost?"
    question = "What do incompressible heads cost by quadratic tets with a pressure (FEniCSx, P2-P1)? Minutes each."
    columns = (
        Column("tets", "tets"),
        Column("reason", "ended"),
        Column("iterations", "iterations", cost=True),
        Column("factorisations", "factorisations", cost=True),
        Column("wall", "solve [s]", cost=True),
        Column("processor", "processor time [s]", cost=True),
        Column("volume", "volume over that at rest"),
        Column("smallest", "smallest J between corners"),
    )
    timed = True
    alone = True

    expressions: tuple[str, ...] = field(
        default=("jawOpen*0.5", "mouthSmileLeft*0.6+mouthSmileRight*0.6"),
        metadata={"help": "as jawOpen*0.5+cheekPuff; repeat for several"},
    )
    laws: tuple[str, ...] = field(
        default=("incompressible", "0.499"),
        metadata={"help": "incompressible or a Poisson's ratio; repeat"},
    )
    tolerance: float = field(default=1e-6, metadata={"help": "gradient norm over its start"})

    def tasks(self) -> Sequence[Task]:
        """Each expression by each law."""
        self.check(self.expressions)
        for law in self.laws:
            _poisson(law)
        if not 0.0 < self.tolerance < 1.0:
            raise InputError(f"tolerance: must lie between 0 and 1, got {self.tolerance}")
        return [Task(text, law) for text in self.expressions for law in self.laws]

    def measure(self, task: Task) -> Values:
        """One solve."""
        of = self.person()
        return solved(of.head, of.shape(task.case), task.method, self.tolerance)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """All converge, in little enough memory."""
        stopped = sum(row.values["reason"] != "CONVERGED" for row in rows)
        most = max(row.memory_mb or 0.0 for row in rows)
        return [at_most("solves that did not converge", stopped, 0), at_most("memory [MB]", most, MEMORY_MB)]

    def words(self, rows: Sequence[Row]) -> str:
        """What a solve takes, from the cheapest to the dearest, and how well volume is kept."""
        cpu, count = ([row.values[key] for row in rows] for key in ("processor", "factorisations"))
        off = max(abs(row.values["volume"] - 1.0) for row in rows)
        return (
            f"A solve takes {min(cpu):.0f} to {max(cpu):.0f} s of a processor and {min(count)} to {max(count)} "
            f"factorisations; volume is kept to {100.0 * off:.2f} %."
        )

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Processor time and factorisations, a pair of bars per solve."""
        figure, axes = subplots(1, 2, figsize=(10, 0.5 * len(rows) + 1.4), sharey=True)
        for axis, key, what in zip(
            axes, ("processor", "factorisations"), ("processor time [s]", "factorisations"), strict=True
        ):
            axis.barh([f"{row.case}, {row.method}" for row in rows], [row.values[key] for row in rows], height=0.6)
            axis.set_xlabel(what)
            axis.grid(False, axis="y")
        axes[0].invert_yaxis()
        return {"What a solve takes.": svg(figure)}


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


def solved(head: LayeredHead, shape: Floats, law: str, tolerance: float) -> Values:
    """A solve by element P2P1, preparation and compilation included in its seconds.

    `volume` is the volume of all tissue by that at rest, `smallest` the smallest volume ratio between tets' corners.
    """
    scene = mixed_scene(head, shape, _poisson(law))
    wall, cpu = time.perf_counter(), time.process_time()
    solution = prepare(scene, solver="fenicsx", element="P2P1").solve(tolerance=tolerance)
    return {
        "tets": len(scene.tets),
        "reason": solution.reason.name,
        "iterations": solution.iterations,
        "factorisations": int(solution.detail["linear_solves"]),
        "wall": time.perf_counter() - wall,
        "processor": time.process_time() - cpu,
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
