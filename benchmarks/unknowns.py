"""How FEniCSx' time and memory grow with the unknowns -> results.json and one HTML page.

The default head on meshes from its coarsest template to the finest with sub-layers, under PD's energy and the
neo-Hookean law, each mesh in a process of its own and from rest. Beside it stands what the default mesh must cost at
least: the bytes of an assembly and of a product with the matrix over the bandwidth of memory.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ..lhm import expressions
from ..lhm.errors import InputError
from ..lhm.files.alone import alone_in
from ..lhm.files.atomic import write_whole
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress
from ..reference import Parameters, Scene, facial_scene, neo_hookean_scene, prepare, terms
from . import machine
from .apart import apart, forget_peak, peak_megabytes
from .cases import NEO_HOOKEAN, PD_ENERGY
from .floor import bandwidth
from .gates import at_most
from .throughput import default_head
from .traces import Stopwatch
from .unknowns_report import page

TOLERANCE = 1e-8
DEFAULT_MESH = (2, 1, "P1")
CPU_SECONDS = {PD_ENERGY: 4.0, NEO_HOOKEAN: 3.0}
"""What a whole solve may take on the default mesh."""
GROWING = ("cpu_seconds", "cpu_per_linear_iteration", "linear_iterations", "peak_mb")
ENTRY_BYTES = 12
"""Of a matrix: a value in float64 and a column in int32."""
TET_BYTES = 4 * 8 + 16 * 4 + 9 * 8 + 8 + 2 * 9 * 8 + 9 * 8 + 2 * 3 * 8
"""What assembly reads of a linear tet: nodes, slots, inverse of the Jacobian, volume, U and V, and dP/dF's modes."""
REPEATS = 7

Mesh = tuple[int, int, str]
"""Level of the template, sub-layers of each tissue, and element."""
MESHES: dict[Mesh, int] = {
    (1, 2, "P1"): 18_180,
    DEFAULT_MESH: 43_578,
    (2, 2, "P1"): 72_630,
    (2, 4, "P1"): 130_734,
    (3, 2, "P1"): 290_430,
    (3, 5, "P1"): 638_946,
    (1, 1, "P2"): 72_630,
    (2, 1, "P2"): 290_430,
}
"""The unknowns of each, three per node, to choose by."""
USUAL = 150_000
"""Meshes up to so many unknowns take some minutes; all of them, to 639 k, about half an hour and 6 GB."""


@dataclass(frozen=True)
class UnknownsConfig:
    """Meshes of at most so many unknowns, and the expression; InputError for fewer than the smallest has."""

    up_to: int = USUAL
    expression: str = "mouthSmileLeft+mouthSmileRight"
    out: Path = Path("out/unknowns")

    def __post_init__(self):
        expressions.parsed(self.expression)
        if not self.meshes:
            raise InputError(f"up_to: the smallest mesh has {min(MESHES.values())} unknowns, got {self.up_to}")

    @property
    def meshes(self) -> list[Mesh]:
        """Those that are asked for."""
        return [mesh for mesh, count in MESHES.items() if count <= self.up_to]


def run_unknowns(config: UnknownsConfig, progress: OnProgress) -> dict:
    """Solve on all meshes; write results.json and index.html into config.out; return the results.

    Raises InputError for a folder in which another run works.
    """
    with alone_in(config.out, "run of unknowns"):
        begin = time.perf_counter()
        rows: list[dict] = []
        for i, (level, layers, element) in enumerate(config.meshes):
            what = f"unknowns: level {level}, {layers} sub-layers, {element}"
            progress(what, i / (len(config.meshes) + 1))
            rows += apart(measure_mesh, level, layers, element, config.expression)
        progress("unknowns: floors", len(config.meshes) / (len(config.meshes) + 1))
        results = {
            "title": f"time per unknown of FEniCSx' Newton ({config.expression})",
            "tolerance": TOLERANCE,
            "rows": rows,
            "exponents": exponents(rows),
            "floors": apart(measure_floors, config.expression),
            "gates": unknowns_gates(rows),
            "machine": machine.describe(),
            "seconds": round(time.perf_counter() - begin, 1),
        }
        write_whole(config.out / "results.json", json.dumps(results, indent=1, allow_nan=False).encode())
        write_whole(config.out / "index.html", page(results).encode())
        progress("unknowns", 1.0)
    return results


def measure_mesh(level: int, layers: int, element: str, expression: str) -> list[dict]:
    """A row per energy on one mesh of the default head; to be called in a process of its own."""
    _load_kernels(element)
    scene = _scene(level, layers, expression)
    scenes = {NEO_HOOKEAN: neo_hookean_scene(scene), PD_ENERGY: scene}
    return [{"level": level, "sub_layers": layers, **measure(law, scenes[law], element)} for law in scenes]


def _load_kernels(element: str) -> None:
    """Solve scenes of one tet, which compiles what is compiled when it is first called, or reads it from the disk."""
    vertices, ids = np.vstack([np.zeros(3), np.eye(3)]), np.arange(4)
    skin, springs = terms.SurfaceStrain(ids[None, 1:], 1.0), terms.Target(ids, 1.1 * vertices, 1.0)
    scene = Scene(vertices, ids[None], (terms.Strain(1.0), terms.Volume(1.0), skin, springs))
    for each in (scene, neo_hookean_scene(scene)):
        prepare(each, solver="fenicsx", element=element).solve()


def _scene(level: int, layers: int, expression: str) -> Scene:
    space, code, head = default_head(level=level)
    targets = expressions.blend(space, code, expressions.parsed(expression))[0]
    return facial_scene(head, Parameters(), targets, bones="prescribed", layers=(layers, layers))


def measure(law: str, scene: Scene, element: str) -> dict:
    """What one cold solve from rest costs: seconds, iterations, and the most memory [MB] that the process holds."""
    forget_peak()
    watch = Stopwatch()
    prepared = prepare(scene, solver="fenicsx", element=element)
    prepare_seconds, prepare_cpu = watch.lap()
    solution = prepared.solve(tolerance=TOLERANCE)
    seconds, cpu = watch.lap()
    linear = solution.detail["linear_iterations"]
    unknowns = 3 * nodes_of(scene, element)
    return {
        "law": law,
        "element": element,
        "unknowns": unknowns,
        "tets": len(scene.tets),
        "prepare_seconds": prepare_seconds,
        "prepare_cpu_seconds": prepare_cpu,
        "seconds": seconds,
        "cpu_seconds": cpu,
        "iterations": solution.iterations,
        "assemblies": solution.detail["assemblies"],
        "linear_iterations": linear,
        "fallback_solves": solution.detail["fallback_solves"],
        "cpu_per_linear_iteration": cpu / max(linear, 1),
        "cpu_us_per_unknown": 1e6 * cpu / unknowns,
        "peak_mb": peak_megabytes(),
        "converged": solution.converged,
    }


def nodes_of(scene: Scene, element: str) -> int:
    """The nodes of an element on a scene: its vertices in tets, and of quadratic ones the middles of the edges."""
    vertices = len(np.unique(scene.tets))
    return vertices if element == "P1" else vertices + len(_edges(scene))


def _edges(scene: Scene) -> np.ndarray:
    pairs = np.sort(scene.tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2), axis=1)
    return np.unique(pairs, axis=0)


def matrix_entries(scene: Scene) -> int:
    """Entries of the stiffness matrix of linear tets: nine per vertex and per edge and direction."""
    return 9 * (len(np.unique(scene.tets)) + 2 * len(_edges(scene)))


def measure_floors(expression: str) -> list[dict]:
    """Milliseconds that parts of an iteration take on the default mesh, and at least need for their bytes."""
    from ..reference.fenicsx.linear import ConjugateGradients, hold
    from ..reference.fenicsx.numbering import Numbering
    from ..reference.fenicsx.problem import Problem

    scene = _scene(DEFAULT_MESH[0], DEFAULT_MESH[1], expression)
    problem = Problem(scene, Numbering(scene))
    x = problem.numbering.X
    states = [problem.at(1e-3 * k * x) for k in range(1, REPEATS + 1)]
    assemble = _median_ms([state.hessian for state in states])
    gradients = _median_ms([partial(_gradient, problem, 1e-3 * k * x) for k in range(1, REPEATS + 1)])
    matrix = problem.at(np.zeros_like(x)).softened_hessian(0.0)
    held = np.flatnonzero(problem.numbering.held(scene.dirichlet()[0]))
    b = np.random.default_rng(0).normal(size=x.size)
    hold(matrix, held, np.zeros(len(held)), b)
    solver = ConjugateGradients(matrix)
    solver.solve(b, relative=1e-2)
    few, many = (_median_cg(solver, b, relative) for relative in (1e-2, 1e-8))
    per_iteration = (many[0] - few[0]) / (many[1] - few[1])
    rate = bandwidth() / 1e3
    entries, tets = matrix_entries(scene), len(scene.tets)
    floors = {
        "energy and gradient at a new place": (gradients, tets * TET_BYTES),
        "assembly of the Hessian": (assemble, 2 * 8 * entries + tets * TET_BYTES),
        "iteration of CG with GAMG (floor: one product with the matrix)": (per_iteration, ENTRY_BYTES * entries),
    }
    return [
        {"what": what, "ms": ms, "floor_ms": size / rate, "ratio": ms / (size / rate), "megabytes": size / 1e6}
        for what, (ms, size) in floors.items()
    ]


def _gradient(problem, u) -> Floats:
    return problem.at(u).gradient()


def _median_ms(calls: Sequence[Callable[[], object]]) -> float:
    calls[0]()
    times = []
    for call in calls:
        begin = time.process_time()
        call()
        times.append(time.process_time() - begin)
    return 1e3 * float(np.median(times))


def _median_cg(solver, b, relative: float) -> tuple[float, int]:
    """Milliseconds and iterations of a solve."""
    iterations = solver.solve(b, relative=relative).iterations
    return _median_ms([partial(solver.solve, b, relative=relative)] * REPEATS), iterations


def exponents(rows: Sequence[Mapping]) -> list[dict]:
    """Per energy and element of two meshes or more, the slopes of log(figure) over log(unknowns) by least squares."""
    found = []
    for law, element in sorted({(row["law"], row["element"]) for row in rows}):
        of = [row for row in rows if (row["law"], row["element"]) == (law, element)]
        if len(of) > 1:
            sizes = np.log([row["unknowns"] for row in of])
            slopes = {key: float(np.polyfit(sizes, np.log([row[key] for row in of]), 1)[0]) for key in GROWING}
            found.append({"law": law, "element": element, "meshes": len(of), **slopes})
    return found


def unknowns_gates(rows: Sequence[Mapping]) -> list[dict]:
    """What the meshes have to show: see `gates.at_most`."""
    found = [at_most("solves that did not reach what was asked", sum(not row["converged"] for row in rows), 0)]
    level, layers, element = DEFAULT_MESH
    for law, bound in CPU_SECONDS.items():
        for row in rows:
            if (row["law"], row["level"], row["sub_layers"], row["element"]) == (law, level, layers, element):
                what = f"whole solve to {TOLERANCE:g} on the default mesh, {law} [CPU s]"
                found.append(at_most(what, row["cpu_seconds"], bound, answer=False))
    return found
