"""What makes a time of FEniCSx unfair: each habit beside the fair way, on blocks of rubber."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ....lhm.base.errors import InputError, SoftdecaError
from ....lhm.base.option import option
from ....reference import Scene, materials, solve, terms
from ....reference.materials import Material, NeoHookean
from ....reference.problems import meshes
from ...harness.processes import read_cpu_seconds
from ...harness.study import Column, Row, Study, Task, Values, at_most
from ..measures import largest_distance
from .parts import make_terms

YOUNG, POISSON = 10.0, 0.45
"""[kPa] and 1, of the block's rubber."""
FEWEST_CELLS = 3
SLENDER = 8
"""A bar's length over its width."""
DEGREE, FORM_CELLS = 4, 8
"""What integrates quadratic tets, and the edge of the block whose forms are timed."""
REPEATS = 3
RELATIVE = 1e-8
"""Residual over right-hand side, to which a linear system is solved."""
TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8)
TIGHT = 1e-12
LAWS: dict[str, Callable[[float, float], Material]] = {
    "stable neo-Hookean": materials.StableNeoHookean.from_young,
    "corotated": materials.Corotated.from_young,
    "St. Venant-Kirchhoff": materials.StVenantKirchhoff.from_young,
}
"""Laws with the neo-Hookean one's moduli at rest."""
START = f"from {__name__} import print_first_form; print_first_form()"


@dataclass(frozen=True)
class Timing(Study):
    """Habits by what they get wrong."""

    name = "timing"
    heading = "What makes a time of FEniCSx unfair?"
    question = "By how much are times of FEniCSx off by degree, compilation, preconditioner, threads, tolerance or law?"
    columns = (
        Column("what", "what"),
        Column("unknowns", "unknowns"),
        Column("degree", "degree"),
        Column("iterations", "iterations", cost=True),
        Column("set_up_s", "set-up, processor time [s]", cost=True),
        Column("own_s", "processor time of the process itself [s]", cost=True),
        Column("cpu_s", "processor time of all [s]", cost=True),
        Column("wall_s", "wall clock [s]", cost=True),
        Column("off", "off the fair answer, of its size"),
    )
    note = (
        "Neo-Hookean rubber, Poisson's ratio .45. A system is of a bar eight times as long as wide, held at one end "
        "and loaded sideways, by linear tets and to 1e-8 of its right-hand side. Forms are of quadratic tets, "
        "solves of linear ones, of a block held below, drawn by a fifth and sheared above. Off: of a form its matrix, "
        "of a solve the largest displacement. Of forms and factors the least time of three is told."
    )
    timed = True
    alone = True

    cells: tuple[str, ...] = option(("6", "12"), "along an edge of a block and of a bar's end; repeat", name="--cells")

    def tasks(self) -> Sequence[Task]:
        """List what can be wrong; InputError for a block of too few cells."""
        if not self.cells or not all(text.isdecimal() and int(text) >= FEWEST_CELLS for text in self.cells):
            raise InputError(f"cells: expected {FEWEST_CELLS} or more each, got {', '.join(self.cells) or 'none'}")
        return [Task(case, "FEniCSx") for case in self._parts()]

    def measure(self, task: Task) -> Values:
        """Measure a row per habit."""
        return {"rows": self._parts()[task.case]()}

    def _parts(self) -> dict[str, Callable[[], list[dict]]]:
        sizes = [int(text) for text in self.cells]
        return {
            "degree of quadrature": compare_degrees,
            "compilation": compare_compilation,
            **{f"linear solver, {n} cells": partial(compare_linear_solvers, n) for n in sizes},
            "threads": partial(compare_threads, sizes[-1]),
            "tolerance": partial(compare_tolerances, sizes[-1]),
            "law": partial(compare_laws, sizes[-1]),
        }

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that every linear solver gives one answer, and the tightest tolerance the answer."""
        lines = [line for row in rows for line in row.values["rows"] if row.case.startswith("linear solver")]
        return [
            at_most(
                "distance between answers of linear solvers, of their size", max(line["off"] for line in lines), 1e-4
            )
        ]


def make_block(cells: int, law: Material | None = None) -> Scene:
    """Make the block's scene; the law is neo-Hookean where none is given."""
    X, tets = meshes.unstructured(cells)
    solid, *held = make_terms(SimpleNamespace(vertices=X))
    return Scene(X, tets, (solid if law is None else terms.Hyperelastic(law), *held))


def stretch(X: np.ndarray) -> np.ndarray:
    """Displace rest positions [mm], shape (n, 3), as the block's ends are, linearly between them."""
    return X[:, 2:] * np.array([0.1, 0.05, 0.2])


def measure_seconds(call: Callable[[], object]) -> dict[str, float]:
    """Measure a call: of wall clock, of the process itself, and of all that it starts [s]."""
    wall, own, cpu = time.perf_counter(), time.process_time(), read_cpu_seconds()
    call()
    return {
        "wall_s": time.perf_counter() - wall,
        "own_s": time.process_time() - own,
        "cpu_s": read_cpu_seconds() - cpu,
    }


def _make_tangent(cells: int, metadata: dict[str, int]) -> tuple[Any, int]:
    """Make the tangent of quadratic tets in UFL, stretched, and the degree that its code integrates with."""
    import ufl
    from ufl.algorithms import compute_form_data

    from ....reference.fenicsx import dolfinx_version as seam
    from ....reference.fenicsx.hyperelastic import density
    from ....reference.fenicsx.numbering import Numbering

    numbering = Numbering(make_block(cells), 2)
    u = seam.function(numbering.space)
    u.x.array[:] = (numbering.X[:, 2:] * stretch(numbering.X)).ravel()  # F differs from point to point
    psi, _ = density(u, np.arange(len(numbering.cell_dofs)), NeoHookean.from_young(YOUNG, POISSON))
    gradient = ufl.derivative(psi * ufl.dx(metadata=metadata), u, ufl.TestFunction(numbering.space))
    tangent = ufl.derivative(gradient, u, ufl.TrialFunction(numbering.space))
    lowered = compute_form_data(
        tangent, do_apply_function_pullbacks=True, do_apply_integral_scaling=True, do_apply_geometry_lowering=True
    )
    (integral,) = lowered.integral_data[0].integrals
    guessed = integral.metadata()["estimated_polynomial_degree"]
    return tangent, int(metadata.get("quadrature_degree", np.max(guessed)))


def compare_degrees() -> list[dict]:
    """Assemble a tangent by the degree that UFL estimates, and by the one that quadratic tets need."""
    from ....reference.fenicsx import dolfinx_version as seam

    rows, matrices = [], []
    for what, metadata in (("as UFL estimates", {}), (f"degree {DEGREE}", {"quadrature_degree": DEGREE})):
        tangent, degree = _make_tangent(FORM_CELLS, metadata)
        form = seam.compile_form(tangent)
        matrix = seam.empty_matrix(form)
        times = []
        for _ in range(REPEATS):
            matrix.zeroEntries()
            times.append(measure_seconds(partial(seam.add_matrix, form, matrix)))
        matrix.assemble()
        matrices.append(matrix)
        best = min(times, key=lambda each: each["cpu_s"])
        rows.append({"what": what, "unknowns": matrix.size[0], "degree": degree, **best})
    first, last = matrices
    last_size = last.norm()
    first.axpy(-1.0, last)
    return [row | {"off": off} for row, off in zip(rows, (first.norm() / last_size, 0.0), strict=True)]


def print_first_form() -> None:
    """Print, as JSON, what a form takes that is made and assembled, and what its assembly alone."""
    from ....reference.fenicsx import dolfinx_version as seam

    tangent, _ = _make_tangent(FEWEST_CELLS, {"quadrature_degree": DEGREE})
    forms: list[Any] = []

    def assemble() -> None:
        seam.add_matrix(forms[-1], seam.empty_matrix(forms[-1]))

    def make_and_assemble() -> None:
        forms.append(seam.compile_form(tangent))
        assemble()

    print(json.dumps([measure_seconds(call) for call in (make_and_assemble, assemble)]))


def compare_compilation() -> list[dict]:
    """Make and assemble a form with an empty cache, with the cache that this leaves, and within one process."""
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "XDG_CACHE_HOME": folder}
        runs = []
        for _ in range(2):
            done = subprocess.run(
                [sys.executable, "-c", START], env=environment, capture_output=True, text=True, check=False
            )
            if done.returncode:
                raise SoftdecaError(f"a form by itself: {(done.stderr.strip().splitlines() or ['no words'])[-1]}")
            runs.append(json.loads(done.stdout.splitlines()[-1]))
    (cold, _), (warm, assembly) = runs
    names = ("cache empty", "in the cache", "assembly alone")
    return [{"what": name} | each for name, each in zip(names, (cold, warm, assembly), strict=True)]


def _make_system(cells: int) -> tuple[Any, np.ndarray]:
    """Make the bar's matrix at rest, by linear tets, and its right-hand side."""
    from ....reference.fenicsx.linear_solvers import hold
    from ....reference.fenicsx.numbering import Numbering
    from ....reference.fenicsx.problem import Problem

    X, tets = meshes.box((cells, cells, SLENDER * cells), (1.0, 1.0, float(SLENDER)))
    law = NeoHookean.from_young(YOUNG, POISSON)
    scene = Scene(X, tets, (terms.Hyperelastic(law), terms.Fixed(meshes.vertices_at(X, 2, 0.0))))
    problem = Problem(scene, Numbering(scene))
    held = problem.held_dofs(problem.numbering.held(scene.dirichlet()[0]))
    matrix = problem.at(np.zeros(X.shape)).hessian()
    b = np.tile([1.0, 0.0, 0.0], len(X))
    hold(matrix, held, np.zeros(len(held)), b)
    return matrix, b


def compare_linear_solvers(cells: int) -> list[dict]:
    """Solve one system by CG with several preconditioners, and by factors; "off" is from the latter's answer."""
    from ....reference.fenicsx.dolfinx_version import PETSc
    from ....reference.fenicsx.linear_solvers import solve_with
    from ....reference.fenicsx.multigrid import GAMG, set_options

    matrix, b = _make_system(cells)
    rigid, nothing = matrix.getNearNullSpace(), PETSc.NullSpace()

    def solve_by(kind: str, before: PETSc.NullSpace, after: PETSc.NullSpace) -> tuple[dict, np.ndarray]:
        matrix.setNearNullSpace(before)
        ksp = PETSc.KSP().create(matrix.comm)
        prefix = f"timing_{kind}_"
        set_options(prefix, GAMG if kind == "gamg" else {})
        ksp.setOptionsPrefix(prefix)
        ksp.setType("preonly" if kind == "cholesky" else "cg")
        norms = PETSc.KSP.NormType
        ksp.setNormType(norms.NONE if kind == "cholesky" else norms.UNPRECONDITIONED)
        ksp.getPC().setType(kind)
        if kind == "cholesky":
            ksp.getPC().setFactorSolverType("mumps")
        ksp.setTolerances(rtol=RELATIVE, atol=0.0, max_it=20_000)
        ksp.setOperators(matrix)
        ksp.setFromOptions()
        set_up = measure_seconds(ksp.setUp)
        matrix.setNearNullSpace(after)
        answers = []
        costs = measure_seconds(lambda: answers.append(solve_with(ksp, b)[0]))
        row = {"iterations": ksp.its, "set_up_s": set_up["cpu_s"]}
        row |= {key: set_up[key] + costs[key] for key in costs}
        ksp.destroy()
        return row, answers[0]

    habits = {
        "no preconditioner": ("none", nothing, nothing),
        "Jacobi": ("jacobi", nothing, nothing),
        "GAMG, no near-null space": ("gamg", nothing, nothing),
        "GAMG, near-null space after set-up": ("gamg", nothing, rigid),
        "GAMG, near-null space": ("gamg", rigid, rigid),
        "MUMPS": ("cholesky", rigid, rigid),
    }
    found = {what: solve_by(*how) for what, how in habits.items()}
    exact = found["MUMPS"][1]
    size = float(np.linalg.norm(exact))
    return [
        {"what": what, "unknowns": len(b), **row, "off": float(np.linalg.norm(x - exact)) / size}
        for what, (row, x) in found.items()
    ]


def compare_threads(cells: int) -> list[dict]:
    """Factor a matrix with one thread, and with as many as the machine has cores, in turns."""
    from ....reference.fenicsx.linear_solvers import Factorisation

    matrix, b = _make_system(cells)
    counts = (1, os.cpu_count() or 1)
    times: dict[int, list[dict[str, float]]] = {count: [] for count in counts}
    for _ in range(REPEATS):
        for count in counts:
            with threadpool_limits(count):
                factors = Factorisation()
                times[count].append(measure_seconds(partial(factors.factor, matrix, symmetric=True)))
                factors.release()
    return [
        {
            "what": f"MUMPS, {count} thread{'s' * (count > 1)}",
            "unknowns": len(b),
            **min(each, key=lambda t: t["wall_s"]),
        }
        for count, each in times.items()
    ]


def _solve(scene: Scene, tolerance: float) -> tuple[dict, np.ndarray]:
    answers = []
    costs = measure_seconds(lambda: answers.append(solve(scene, solver="fenicsx", tolerance=tolerance)))
    (answer,) = answers
    return {"unknowns": 3 * len(scene.vertices), "iterations": answer.iterations, **costs}, answer.positions


def _measure_off(positions: np.ndarray, truth: np.ndarray, scene: Scene) -> float:
    return largest_distance(positions, truth) / largest_distance(truth, scene.vertices)


def compare_tolerances(cells: int) -> list[dict]:
    """Solve to tolerances, compiled before."""
    scene = make_block(cells)
    _, truth = _solve(scene, TIGHT)
    rows = []
    for tolerance in (*TOLERANCES, TIGHT):
        row, positions = _solve(scene, tolerance)
        rows.append({"what": f"gradient norm to {tolerance:g}", **row, "off": _measure_off(positions, truth, scene)})
    return rows


def compare_laws(cells: int) -> list[dict]:
    """Solve by other laws of the same moduli; "off" is from the neo-Hookean answer."""
    scene = make_block(cells)
    row, truth = _solve(scene, TIGHT)
    rows = [{"what": "neo-Hookean", **row, "off": 0.0}]
    for name, make in LAWS.items():
        row, positions = _solve(make_block(cells, make(YOUNG, POISSON)), TIGHT)
        rows.append({"what": name, **row, "off": _measure_off(positions, truth, scene)})
    return rows
