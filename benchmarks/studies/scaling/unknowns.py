"""How time and memory grow with the unknowns.

One head on meshes from its coarsest template to the finest with sub-layers, each in a process of its own: PD's energy
by PD and by FEniCSx, the neo-Hookean law by FEniCSx. Meshes up to the default one start at rest, finer ones by FEniCSx
at coarser meshes' answers.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import InputError
from ....lhm.base.limits import UNKNOWNS
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....reference import Parameters, Scene, apply_law, facial_scene, nested_start, prepare
from ....reference.face.facial import FaceLaw
from ....surrogate import methods as m
from ...harness.processes import peak_megabytes, reset_peak
from ...harness.study import Column, Row, Task, Values, at_most
from ..measures import COUNTS, TIMES, count_unfinished, load_kernels, time_solve
from ..person import OfPerson

ELEMENTS: Mapping[str, tuple[str, ...]] = {
    m.FENICSX_NEO_HOOKEAN: ("P1", "P2", "P2P1"),
    m.FENICSX: ("P1", "P2"),
    m.PD: ("P1",),
}
"""Solvers of METHODS, and the elements with which each solves."""
TOLERANCE = 1e-8

Mesh = tuple[int, int, str]
"""Level of the template, sub-layers of each tissue, and element."""
DEFAULT_MESH: Mesh = (2, 1, "P1")
NEAR = 1e-3
"""Tolerance of coarser meshes' answers that a finer one starts from."""
MESHES: dict[Mesh, int] = {
    (1, 2, "P1"): 18_180,
    DEFAULT_MESH: 43_578,
    (2, 2, "P1"): 72_630,
    (2, 4, "P1"): 130_734,
    (3, 2, "P1"): 290_430,
    (3, 5, "P1"): 638_946,
    (1, 1, "P2"): 72_630,
    (2, 1, "P2"): 290_430,
    (1, 1, "P2P1"): 72_630,
}
"""The unknowns of each, three per node, to choose by; quadratic tets with a pressure (P2P1) have those beside."""
USUAL = 150_000
"""Meshes up to so many unknowns take some minutes; all of them, to 639 k, about half an hour and 6 GB."""


def _name_mesh(mesh: Mesh) -> str:
    level, layers, element = mesh
    return f"level {level}, {layers} sub-layer{'s' if layers > 1 else ''}, {element}"


@dataclass(frozen=True)
class Unknowns(OfPerson):
    """Meshes of at most so many unknowns, by solver and law."""

    name = "unknowns"
    question = "How do time and memory grow with the mesh?"
    columns = (
        Column("unknowns", "unknowns"),
        Column("tets", "tets"),
        *TIMES,
        *COUNTS,
        Column("coarse_cpu_s", "coarser meshes before these three [s]", cost=True),
        Column("cpu_us_per_unknown", "processor time per unknown [µs]", cost=True),
        Column("peak_mb", "most memory [MB]", cost=True),
        Column("reason", "ended"),
    )
    note = (
        "All end at a gradient norm of 1e-8 of their start, with prescribed bones and default parameters; each mesh "
        "has its own process. By FEniCSx linear meshes finer than the default one start at its answer to 1e-3, whose "
        "cost is counted; all others start at rest. PD has linear tets alone. Memory is the most that the process "
        "held during preparation and solve, with the programs and the head's fit. Seconds are processor time."
    )
    version = 2
    timed = True
    alone = True

    level: ClassVar[int] = DEFAULT_MESH[0]  # type: ignore[misc]  # no option: each mesh has its own
    up_to: int = option(USUAL, "unknowns of a mesh; 640000 for all: forty minutes", bound=UNKNOWNS)
    expression: str = "mouthSmileLeft+mouthSmileRight"

    @property
    def meshes(self) -> dict[str, Mesh]:
        """Those that are asked for, by name."""
        return {_name_mesh(mesh): mesh for mesh, count in MESHES.items() if count <= self.up_to}

    def tasks(self) -> Sequence[Task]:
        """List each mesh by each method; InputError for fewer unknowns than the smallest mesh has."""
        self.check([self.expression])
        if not self.meshes:
            raise InputError(f"up_to: the smallest mesh has {min(MESHES.values())} unknowns, got {self.up_to}")
        return [
            Task(name, method)
            for method, elements in ELEMENTS.items()
            for name, (_, _, element) in self.meshes.items()
            if element in elements
        ]

    def measure(self, task: Task) -> Values:
        """Measure a solve from rest or from coarser meshes' answers, and the most memory that the process holds."""
        mesh, solver = self.meshes[task.case], m.METHODS[task.method].solver
        assert solver is not None
        level, layers, element = mesh
        how = {**solver.how, **({} if task.method == m.PD else {"element": element})}
        load_kernels(solver.law, **how)
        coarser: list[Mesh] = []
        if task.method != m.PD and element == "P1" and MESHES[mesh] > MESHES[DEFAULT_MESH]:
            coarser = [DEFAULT_MESH]
            if level > DEFAULT_MESH[0] and layers > 1:
                coarser.append((level, 1, "P1"))
        scenes = [self.scene(each) for each in (*coarser, mesh)]
        reset_peak()
        begin = time.process_time()
        start = self._find_start((*coarser, mesh), scenes, solver.law) if coarser else None
        coarse_cpu_s = time.process_time() - begin
        _, costs = time_solve(lambda: apply_law(scenes[-1], solver.law), TOLERANCE, start=start, **how)
        unknowns, cpu_s = 3 * count_nodes(scenes[-1], element), costs["cpu_s"] + coarse_cpu_s
        return {
            "law": solver.law,
            "element": element,
            "unknowns": unknowns,
            "tets": len(scenes[-1].tets),
            **costs,
            "cpu_s": cpu_s,
            "coarse_cpu_s": coarse_cpu_s,
            "cpu_us_per_unknown": 1e6 * cpu_s / unknowns,
            "peak_mb": peak_megabytes(),
        }

    def _find_start(self, meshes: Sequence[Mesh], scenes: Sequence[Scene], law: FaceLaw) -> Floats | None:
        """Solve all meshes but the last in turn, each from the answer before, and give the last one's start [mm]."""
        start: Floats | None = None
        for mesh, scene, finer, fine in zip(meshes, scenes, meshes[1:], scenes[1:], strict=False):
            near = prepare(apply_law(scene, law), solver="fenicsx").solve(tolerance=NEAR, start=start)
            heads = [self.person(level).head for level, _, _ in (finer, mesh)]
            layers = [(count, count) for _, count, _ in (finer, mesh)]
            start = nested_start(fine, heads[0], near.positions, heads[1], layers=layers[0], coarse_layers=layers[1])
        return start

    def scene(self, mesh: Mesh) -> Scene:
        """Make the scene of PD's energy on a mesh."""
        level, layers, _ = mesh
        person = self.person(level)
        shape = person.shape(self.expression)
        return facial_scene(person.head, Parameters(), shape, bones="prescribed", layers=(layers, layers), cells="tets")

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all converge."""
        return [at_most("solves that did not reach what was asked", count_unfinished([row.values for row in rows]), 0)]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the exponents, where there are two meshes or more."""
        sentences = []
        for (method, element), solves in _group_solves(rows).items():
            if len(solves) > 1:
                sizes, seconds = ([values[key] for values in solves] for key in ("unknowns", "cpu_s"))
                slope = np.polyfit(np.log(sizes), np.log(seconds), 1)[0]
                sentences.append(f"{method}, {element}: unknowns^{slope:.2f}")
        return f"Processor time grows as {'; '.join(sentences)}." if sentences else ""

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw processor time per unknown, and memory, against unknowns: a line per method and element."""
        figure, axes = subplots(1, 2, figsize=(8.6, 3.4))
        for (method, element), solves in _group_solves(rows).items():
            sizes = [values["unknowns"] for values in solves]
            axes[0].plot(sizes, [v["cpu_us_per_unknown"] for v in solves], "o-", label=f"{method}, {element}", ms=4)
            axes[1].plot(sizes, [v["peak_mb"] for v in solves], "o-", ms=4)
        for axis, what in zip(axes, ("processor time per unknown [µs]", "most memory [MB]"), strict=True):
            axis.set(xscale="log", yscale="log", xlabel="unknowns", ylabel=what)
        axes[0].legend()
        return {"Time and memory against unknowns.": to_svg(figure)}


def count_nodes(scene: Scene, element: str) -> int:
    """Count the nodes of an element on a scene: vertices in tets, and of quadratic ones the edges' middles."""
    vertices = len(np.unique(scene.tets))
    if element == "P1":
        return vertices
    edges = np.sort(scene.tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2), axis=1)
    return vertices + len(np.unique(edges, axis=0))


def _group_solves(rows: Sequence[Row]) -> dict[tuple[str, str], list[Values]]:
    """The solves by method and element, in the order of their unknowns."""
    groups: dict[tuple[str, str], list[Values]] = {}
    for row in sorted(rows, key=lambda row: row.values["unknowns"]):
        groups.setdefault((row.method, row.values["element"]), []).append(row.values)
    return groups
