"""Where a frame's error comes from: the network, the corpus' tolerance, PD's energy as a law, and the mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ...lhm import expressions
from ...lhm.errors import InputError, SoftdecaError
from ...lhm.mesh import Floats
from ...reference import Parameters, Scene, neo_hookean_scene, solve
from ...reference.face.linearised import TIGHT, Linearised
from ...surrogate import Surrogate
from ...surrogate.corpus.plan import CorpusPlan
from ...surrogate.linear import linearised_face
from ..harness.gates import at_most
from ..harness.runner import Row
from ..harness.study import Column, Task, Values
from ..plots import subplots, svg
from .person import OfPerson

EFFECTS: Mapping[str, Parameters] = {
    "defaults": Parameters(),
    "40 % more soft tissue": Parameters(soft_volume=1.4),
    "skin grown by 30 %": Parameters(skin_growth=1.3),
    "softer, 2 g": Parameters(soft_stiffness=2.0, gravity=2.0),
}
PARTS = {
    "network": "surrogate - PD as trained",
    "tolerance": "PD as trained - PD converged",
    "law": "PD's energy - neo-Hookean",
    "mesh": "linear tets - quadratic tets",
}
FEM_TOLERANCE, NEAR = 1e-9, 1e-1
"""Gradient norm over its start: of another energy's answer, and of one that is at the minimum but for rounding."""


@dataclass(frozen=True)
class Split(OfPerson):
    """The error of the shipped network on a person it has not seen, part by part; expressions by effects."""

    name = "split"
    heading = "Where does the network's error come from?"
    question = (
        "Where does the surrogate's error to a refined hyperelastic reference come from: the network, the tolerance of "
        "what it learned from, projective dynamics' energy in place of a hyperelastic law, or the mesh?"
    )
    columns = (
        Column("moved", "T - S, mean [mm]"),
        *(Column(key, f"{title}, mean [mm]") for key, title in PARTS.items()),
        Column("total", "surrogate - refined reference, mean [mm]"),
        Column("fenicsx", "check: PD - FEniCSx, same energy, max [mm]"),
    )

    expressions: tuple[str, ...] = field(
        default=("jawOpen*0.5", "mouthSmileLeft*0.6+mouthSmileRight*0.6", "mouthPucker", "cheekPuff"),
        metadata={"help": "as jawOpen*0.5+cheekPuff; repeat for several"},
    )
    effects: tuple[str, ...] = field(
        default=tuple(EFFECTS), metadata={"help": f"of {', '.join(EFFECTS)}; repeat for several"}
    )
    seed: int = field(default=1_000_003, metadata={"help": "of the person"})
    refined: bool = field(default=False, metadata={"help": "also quadratic tets: minutes each"})

    def tasks(self) -> Sequence[Task]:
        """Each effect with each expression: a process that goes on with an effect has prepared it."""
        self.check(self.expressions)
        for name in self.effects:
            if name not in EFFECTS:
                raise InputError(f"effect {name!r}: there are {', '.join(EFFECTS)}")
        return [Task(name, text) for name in self.effects for text in self.expressions]

    def measure(self, task: Task) -> Values:
        """The skins of one frame by every method, and what lies between them."""
        of = self.person()
        head, code, shape = of.head, of.code, of.shape(task.method)
        linear = _prepared(self, task.case)
        weights = expressions.parsed(task.method)
        scene = linear.face.scene(shape)
        network = (
            Surrogate.load().bind(head.skin, code, EFFECTS[task.case], beyond="clamp").frame(weights).astype(np.float64)
        )
        trained, tight = (linear.solve(shape, accuracy=accuracy) for accuracy in (CorpusPlan.tolerance, TIGHT))
        if not (trained.converged and tight.converged):
            raise SoftdecaError(f"projective dynamics: {tight.reason}")
        same = _fem(scene, tight.positions, NEAR)
        hyperelastic = neo_hookean_scene(scene)
        neo = _fem(hyperelastic, tight.positions if tight.volume_ratio.min() > 0 else None, FEM_TOLERANCE)
        skins: list[Floats] = [
            network,
            *(linear.face.skin_after(shape, x) for x in (trained.positions, tight.positions, neo)),
        ]
        found = {"moved": _mean(skins[2] - shape), "fenicsx": float(np.abs(tight.positions - same).max())}
        if self.refined:
            skins.append(linear.face.skin_after(shape, _fem(hyperelastic, neo, FEM_TOLERANCE, element="P2")))
        pairs = zip(PARTS, skins[:-1], skins[1:], strict=False)
        return found | {key: _mean(one - other) for key, one, other in pairs} | {"total": _mean(network - skins[-1])}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """The reference holds, and what the network was trained on is no part of its error that one sees."""
        apart = max(row.values["fenicsx"] for row in rows)
        share = max(row.values["tolerance"] / row.values["network"] for row in rows)
        return [
            at_most("PD to FEniCSx, same energy, largest distance of a vertex [mm]", apart, 1e-3),
            at_most("the corpus' tolerance over the network's error", share, 0.2),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Each part's mean, and which is the largest."""
        means = {key: float(np.mean([row.values[key] for row in rows])) for key in PARTS if key in rows[0].values}
        moved = float(np.mean([row.values["moved"] for row in rows]))
        parts = ", ".join(f"{PARTS[key]} {mean:.3f} mm ({100.0 * mean / moved:.1f} %)" for key, mean in means.items())
        largest = max(means, key=lambda key: means[key])
        return f"Simulation moves the skin by {moved:.2f} mm on average. Of that: {parts}. Most is {PARTS[largest]}."

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """The parts as bars, a group per frame."""
        figure, axis = subplots(figsize=(11, 0.42 * len(rows) + 1.6))
        places = np.arange(len(rows))
        left = np.zeros(len(rows))
        for key in (key for key in PARTS if key in rows[0].values):
            sizes = np.array([row.values[key] for row in rows])
            axis.barh(places, sizes, left=left, height=0.7, label=PARTS[key])
            left += sizes
        axis.scatter([row.values["moved"] for row in rows], places, marker="|", s=160, color="black", label="T - S")
        axis.set_yticks(places, [f"{row.case}, {row.method}" for row in rows], fontsize=8)
        axis.invert_yaxis()
        axis.set_xlabel("mean over the skin's vertices [mm]")
        axis.legend(frameon=True)
        axis.grid(False, axis="y")
        return {"Mean distances, one after another; | is what simulation moves.": svg(figure)}


@lru_cache(maxsize=1)
def _prepared(study: Split, effect: str) -> Linearised:
    return linearised_face(study.person().head, EFFECTS[effect])


def _fem(scene: Scene, start: Floats | None, tolerance: float, element: str = "P1") -> Floats:
    solution = solve(scene, solver="fenicsx", start=start, tolerance=tolerance, element=element)
    if not solution.converged:
        raise SoftdecaError(f"FEniCSx: {solution.reason}")
    return solution.positions


def _mean(difference: Floats) -> float:
    return float(np.linalg.norm(difference, axis=1).mean())
