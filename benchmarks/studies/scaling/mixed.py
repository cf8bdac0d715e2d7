"""A head of incompressible tissue by quadratic tets with a pressure: cost, volumes kept, distance to linear tets."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import InputError
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.head.head import LayeredHead
from ....reference import Parameters, Scene, apply_law, facial_scene, materials, prepare, terms
from ...harness.study import Column, Row, Task, Values, at_most
from ..measures import distances, solve_to_end
from ..person import OfPerson, parse_poisson

INCOMPRESSIBLE = "incompressible"
DEFAULT = 0.45
"""Poisson's ratio of soft tissue by default parameters."""
POINTS = 4
"""Degree of the rule at whose points J is taken: the one that quadratic elements are integrated with."""
STIFFEST = 0.499
"""Poisson's ratio of linear tets beside incompressible tissue, which they cannot model."""
SHARES = (1, 5, 95, 99)
"""Percentiles of J over the tissue's volume."""


@dataclass(frozen=True)
class Mixed(OfPerson):
    """Expressions of the default head by laws: "incompressible" or a Poisson's ratio as text."""

    name = "mixed"
    heading = "What does an incompressible head cost?"
    question = (
        "What does an incompressible head cost, by quadratic tets with a pressure (FEniCSx, P2-P1)? Minutes each."
    )
    cheap = "mouthPucker, 0.499"
    columns = (
        Column("tets", "tets"),
        Column("reason", "ended"),
        Column("iterations", "iterations", cost=True),
        Column("linear_solves", "linear solves", cost=True),
        Column("wall", "solve [s]", cost=True),
        Column("processor", "processor time [s]", cost=True),
        Column("volume", "volume over that at rest"),
        Column("around", "mean |J - 1| around a vertex"),
        Column("around_default", f"the same, linear tets of nu {DEFAULT}"),
        Column("volume_error", "mean |J - 1| at integration points"),
        Column("least_J", "smallest J at integration points"),
        *(Column(f"J_{share}", f"J, {share} %") for share in SHARES),
        Column("linear_mean", "linear tets, same law, to this skin, mean [mm]"),
        Column("linear_max", "max [mm]"),
    )
    note = (
        "J is taken at the element's integration points; its percentiles count volume. The mean around a vertex is "
        "weighted by the vertex's linear shape function. The element's pressures act on these means, one on each. J "
        "at a single point may be far off in flat tets. Linear tets of the same law start at rest; beside "
        "incompressible tissue they have a Poisson's ratio of 0.499."
    )
    version = 3
    timed = True
    alone = True

    expressions: tuple[str, ...] = option(("mouthPucker",), "as jawOpen*0.5+cheekPuff; repeat for several")
    laws: tuple[str, ...] = option((INCOMPRESSIBLE, "0.499"), "incompressible or a Poisson's ratio; repeat")
    tolerance: float = 1e-6

    def tasks(self) -> Sequence[Task]:
        """List each expression by each law."""
        self.check(self.expressions)
        for law in self.laws:
            if law != INCOMPRESSIBLE:
                parse_poisson(law)
        if not 0.0 < self.tolerance < 1.0:
            raise InputError(f"tolerance: must lie between 0 and 1, got {self.tolerance}")
        return [Task(text, law) for text in self.expressions for law in self.laws]

    def measure(self, task: Task) -> Values:
        """Measure one solve by quadratic tets with a pressure, and two by linear ones."""
        person = self.person()
        return solve_mixed(person.head, person.shape(task.case), task.method, self.tolerance)

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check convergence, that volumes are kept as the default law does not keep them, and memory."""
        stopped = sum(row.values["reason"] != "CONVERGED" for row in rows)
        most = max(row.memory_mb or 0.0 for row in rows)
        worst = max(row.values["around"] / row.values["around_default"] for row in rows)
        return [
            at_most("solves that did not converge", stopped, 0),
            # 0.067 on level 1 for nu 0.499.
            at_most("mean |J - 1| around a vertex over that of the default law, worst solve", worst, 0.083),
            at_most("memory [MB]", most, 8000.0, answer=False),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell what a solve takes, how well volume is kept, and how far linear tets are."""
        cpu, count = ([row.values[key] for row in rows] for key in ("processor", "linear_solves"))
        off, points, away = (max(row.values[key] for row in rows) for key in ("around", "volume_error", "linear_mean"))
        return (
            f"A solve takes {min(cpu):.0f} to {max(cpu):.0f} s of a processor and {min(count)} to {max(count)} "
            f"linear solves. In the worst solve J is {100.0 * off:.3f} % from 1 on average around a vertex, and "
            f"{100.0 * points:.1f} % at integration points. "
            f"Linear tets of the same law are up to {away:.3f} mm away on average, "
            f"{max(row.values['linear_max'] for row in rows):.2f} mm at most."
        )

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw processor time and linear solves, a pair of bars per solve."""
        figure, axes = subplots(1, 2, figsize=(10, 0.5 * len(rows) + 1.4), sharey=True)
        for axis, key, what in zip(
            axes, ("processor", "linear_solves"), ("processor time [s]", "linear solves"), strict=True
        ):
            axis.barh([f"{row.case}, {row.method}" for row in rows], [row.values[key] for row in rows], height=0.6)
            axis.set_xlabel(what)
            axis.grid(False, axis="y")
        axes[0].invert_yaxis()
        return {"What a solve takes.": to_svg(figure)}


def solve_mixed(head: LayeredHead, shape: Floats, law: str, tolerance: float) -> Values:
    """Solve by element P2P1, preparation and compilation included in its seconds, and by linear tets.

    `volume` is the volume of all tissue over that at rest, by the tets' corners.
    """
    poisson = None if law == INCOMPRESSIBLE else float(law)
    scene = make_law_scene(head, shape, poisson)
    wall, cpu = time.perf_counter(), time.process_time()
    prepared: Any = prepare(scene, solver="fenicsx", element="P2P1")
    solution = prepared.solve(tolerance=tolerance)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    fields = prepared.fields(POINTS)
    how = {"solver": "fenicsx", "tolerance": tolerance}
    linear = solve_to_end(make_law_scene(head, shape, STIFFEST if poisson is None else poisson), "linear tets", **how)
    default = solve_to_end(make_law_scene(head, shape, DEFAULT), "linear tets", **how)
    J, middles = np.linalg.det(fields.gradient + np.eye(3)), scene.vertices[scene.tets].mean(axis=1)
    default_around = average_around_vertices(scene, middles, scene.volumes, default.volume_ratio)
    n = len(head.bone)
    away = distances(*(head.skin_after(shape, answer.positions[:n]) for answer in (linear, solution)))
    return {
        "tets": len(scene.tets),
        "reason": solution.reason.name,
        "iterations": solution.iterations,
        "linear_solves": int(solution.detail["linear_solves"]),
        "wall": wall,
        "processor": cpu,
        "energy": solution.energy,
        "volume": float((solution.volume_ratio @ scene.volumes) / scene.volumes.sum()),
        **measure_volumes(J, fields.weights),
        "around": float(np.abs(average_around_vertices(scene, fields.X, fields.weights, J) - 1.0).mean()),
        "around_default": float(np.abs(default_around - 1.0).mean()),
        "linear_mean": float(away.mean()),
        "linear_max": float(away.max()),
    }


def measure_volumes(J: Floats, weights: Floats) -> dict[str, float]:
    """Summarise volume ratios J (q,) at points that stand for volumes (q,) [mm³]: mean |J - 1|, least, percentiles."""
    order = np.argsort(J)
    share = (np.cumsum(weights[order]) - 0.5 * weights[order]) / weights.sum()
    percentiles = np.interp(np.array(SHARES) / 100.0, share, J[order])
    return {
        "volume_error": float(np.average(np.abs(J - 1.0), weights=weights)),
        "least_J": float(J.min()),
        **{f"J_{percent}": float(value) for percent, value in zip(SHARES, percentiles, strict=True)},
    }


def average_around_vertices(scene: Scene, points: Floats, weights: Floats, values: Floats) -> Floats:
    """Average values (q,) around each vertex by its linear shape function, shape (vertices of tets,).

    points (q, 3) [mm] at rest stand for volumes `weights` (q,) [mm³]; as many lie in each tet, next to each other, with
    the tet's centre as their mean.
    """
    centres = scene.vertices[scene.tets].mean(axis=1)
    each = len(points) // len(centres)
    tet = np.repeat(cKDTree(centres).query(points.reshape(-1, each, 3).mean(axis=1))[1], each)
    corners = scene.tets[tet]
    first = scene.vertices[corners[:, 0]]
    edges = (scene.vertices[corners[:, 1:]] - first[:, None]).transpose(0, 2, 1)
    inner = np.linalg.solve(edges, (points - first)[..., None])[..., 0]
    shares = weights[:, None] * np.column_stack([1.0 - inner.sum(axis=1), inner])
    count = len(scene.vertices)
    volume = np.bincount(corners.ravel(), shares.ravel(), minlength=count)
    total = np.bincount(corners.ravel(), (shares * values[:, None]).ravel(), minlength=count)
    return (total / np.where(volume > 0.0, volume, 1.0))[volume > 0.0]


def make_law_scene(head: LayeredHead, shape: Floats, poisson: float | None, layers: tuple[int, int] = (1, 1)) -> Scene:
    """Make an expression's neo-Hookean scene with prescribed bones, incompressible or of a Poisson's ratio."""
    scene = apply_law(facial_scene(head, Parameters(), shape, bones="prescribed", layers=layers), "neo-Hookean")
    parts: list[terms.Term] = []
    for term in scene.terms:
        if isinstance(term, terms.Hyperelastic):
            law = term.material
            assert isinstance(law, materials.NeoHookean)
            if poisson is None:
                term = replace(term, material=materials.Incompressible(law))
            else:
                young = 2 * law.mu * (1 + poisson)
                term = replace(term, material=materials.NeoHookean.from_young(young, poisson))
        parts.append(term)
    return replace(scene, terms=tuple(parts))
