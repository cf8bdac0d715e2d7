"""The converged answers of the open face benchmark, each with a band, from two codes, three meshes and three elements.

Quadratic tets on three meshes show the order by which each quantity converges, and are extrapolated by it (Celik et al.
2008). Linear tets on three meshes, quadratic ones with a pressure, and a second code are the checks.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ....lhm.base.mesh import Floats
from ....reference import Scene, Solution, solve
from ....surrogate import methods as m
from ...face.problems import MESHES, PROBLEMS, Body, body_of, describe_measures
from ...face.score import find_unit, measure
from ...harness.study import Column, Row, Study, Table, Task, Values, at_most
from ..measures import COUNTS, count_work
from ..person import person

ORDERS = 0.5, 3.0
"""Between which an observed order of quadratic tets is trusted; the lower one gives the wider band."""
SAFETY = 1.25
"""Band over the extrapolated step, as for the index of grid convergence with an observed order (Roache 1994)."""
LEAST_BAND = 0.005
"""Least band, as a share of a value."""
CONVERGED = "converged"
ANSWERS = Path(__file__).parents[2] / "face" / "answers"
"""Scores of other codes' answers, NAME.json each of `bench score --json`: a pull request adds its own."""


CODES: Mapping[str, str] = {
    "FEniCSx, linear": m.FENICSX_NEO_HOOKEAN,
    "FEniCSx, quadratic": m.FENICSX_P2,
    "FEniCSx, quadratic with a pressure": m.FENICSX_P2P1,
    "scikit-fem, linear": m.SKFEM_NEO_HOOKEAN,
    "scikit-fem, quadratic": m.SKFEM_P2,
}
"""Solvers of METHODS by the names of codes and elements in rows."""
LINEAR, QUADRATIC = ([f"FEniCSx, {element}, {mesh}" for mesh in MESHES] for element in ("linear", "quadratic"))
MIXED = f"FEniCSx, quadratic with a pressure, {MESHES[0]}"
CHECKS = [f"scikit-fem, {element}, {MESHES[0]}" for element in ("linear", "quadratic")]
RUNS = (*LINEAR, *QUADRATIC, MIXED, *CHECKS)
"""A code, its elements and the mesh each."""
TOLERANCE = 1e-7
"""Gradient norm relative to that at rest."""


@lru_cache(maxsize=1)
def default_bodies() -> tuple[Body, ...]:
    """Make the meshes of the default head, the mean of its space, coarse ones first."""
    return nested_bodies(body_of(person(seed=None, level=1).head))


def nested_bodies(body: Body) -> tuple[Body, ...]:
    """Make a body's three meshes from the coarse one."""
    medium = body.refine()
    return body, medium, medium.refine()


@dataclass(frozen=True)
class FaceBenchmark(Study):
    """Four problems by nine methods; the limits follow from them. The largest solve takes some 12 GB."""

    name = "face-benchmark"
    version = 2
    question = "What are the converged answers of the open face benchmark?"
    needs = ("people", "heads")
    cheap = "growth, FEniCSx, linear, coarse"
    columns = (
        Column("tets", "tets"),
        Column("mean_mm", "skin, mean [mm]"),
        Column("largest_mm", "skin, largest [mm]"),
        Column("mandible_mN", "force on the mandible [mN]"),
        *COUNTS,
    )
    note = (
        "Neo-Hookean tissue on nested meshes, each of eight times the tets of the one before. The skin's figures are "
        "over the coarse mesh's vertices, which all meshes have. Converged: quadratic tets on three meshes, "
        f"extrapolated by the order that they show; the band is {SAFETY:g} times that step and the distance of two "
        f"codes, and at least {100 * LEAST_BAND:g} % of the value."
    )
    limit = 7200.0
    timed = True
    alone = True

    def bodies(self) -> tuple[Body, ...]:
        """Give the meshes."""
        return default_bodies()

    def tasks(self) -> Sequence[Task]:
        """List every problem by every method."""
        return [Task(problem, name) for name in RUNS for problem in PROBLEMS]

    def measure(self, task: Task) -> Values:
        """Solve one; its quantities, and displacements [mm] of the mesh's vertices as an array."""
        code, _, mesh = task.method.rpartition(", ")
        solver, bodies = m.METHODS[CODES[code]].solver, self.bodies()
        assert solver is not None
        body = bodies[MESHES.index(mesh)]
        scene = body.scene(task.case)
        solution = solve(scene, tolerance=TOLERANCE, **solver.how)
        quantities = quantities_of(bodies[0], body, scene, solution)
        return {
            "tets": len(scene.tets),
            "quantities": quantities,
            "mean_mm": quantities["skin, mean"][0],
            "largest_mm": quantities["skin, largest"][0],
            "mandible_mN": float(np.linalg.norm(quantities["force on mandible"])),
            "displacement": solution.positions - scene.vertices,
            **count_work(solution),
        }

    def conclude(self, rows: Sequence[Row]) -> Sequence[Row]:
        """Extrapolate the quantities of each problem that has been solved by all methods that the limit needs."""
        concluded = []
        for problem in PROBLEMS:
            solved = {row.method: row for row in rows if row.case == problem}
            if all(name in solved for name in RUNS):
                values = _converge({name: row.values["quantities"] for name, row in solved.items()})
                last = solved[QUADRATIC[-1]]
                concluded.append(replace(last, method=CONVERGED, values=values, seconds=0.0, memory_mb=None, cpu=None))
        return concluded

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all converge, codes agree, finer linear tets come nearer, and quadratic ones are nearest."""
        solved, limits = [row for row in rows if row.method in RUNS], _limits(rows)
        unfinished = sum(not row.values["converged"] for row in solved)
        gates = [at_most("solves that did not reach what was asked", unfinished, 0)]
        if limits:
            codes = max(_compare_codes(lines) for lines in limits.values())
            ratio = max(
                _mean(rows, problem, b) / _mean(rows, problem, a)
                for problem in limits
                for a, b in zip(LINEAR[:-1], LINEAR[1:], strict=True)
            )
            pressure = max(_mean(rows, problem, MIXED) / _mean(rows, problem, LINEAR[0]) for problem in limits)
            gates += [
                at_most("distance of FEniCSx and scikit-fem over the largest value of its unit", codes, 1e-4),
                at_most("distance to the limit of linear tets, over that on the mesh before", ratio, 1.0),
                at_most("the same of quadratic tets with a pressure, over linear ones'", pressure, 1.0),
            ]
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the width of the bands."""
        bands = [line["share"] for lines in _limits(rows).values() for line in lines]
        if not bands:
            return "No problem has been solved by all methods yet."
        middle = float(np.median(bands))
        return f"The bands are {100 * middle:.1f} % of the value in the median, {100 * max(bands):.0f} % at most."

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate the converged values with their bands, and each method's."""
        head = ["problem", "quantity", "unit", CONVERGED, "band", "order", *RUNS]
        lines = [
            (
                *(problem, line["name"], line["unit"], line["size"], line["band"], line["order"]),
                *(line["by"][name] for name in RUNS),
            )
            for problem, listed in _limits(rows).items()
            for line in listed
        ]
        converged = Table("Converged answers and every method's; of vectors the lengths", head, lines)
        others = tabulate_answers(ANSWERS)
        return [converged, others] if others.rows else [converged]


def quantities_of(coarse: Body, body: Body, scene: Scene, solution: Solution) -> dict[str, list[float]]:
    """Give the benchmark's quantities of a solution on one of a coarse body's meshes."""
    return measure(
        describe_measures(coarse),
        body.level,
        solution.positions - scene.vertices,
        solution.reactions,
        solution.cauchy,
        body.shares,
    )


def extrapolate(coarse: Floats, medium: Floats, fine: Floats) -> tuple[Floats, float]:
    """Extrapolate answers of quadratic tets on three meshes, arrays of one shape; return the limit and the order."""
    steps = [float(np.linalg.norm(step)) for step in (medium - coarse, fine - medium)]
    order = float(np.clip(np.log2(max(steps[0], 1e-300) / max(steps[1], 1e-300)), *ORDERS))
    limit: Floats = fine + (fine - medium) / (2.0**order - 1.0)
    return limit, order


def _converge(values: Mapping[str, Mapping[str, list[float]]]) -> Values:
    """A list of quantities: converged value and its size, order, band, what codes differ by, and each method's."""
    answers = {name: {key: np.array(value) for key, value in each.items()} for name, each in values.items()}
    lines = []
    for quantity, fine in answers[QUADRATIC[-1]].items():
        value, order = extrapolate(*(answers[method][quantity] for method in QUADRATIC))
        pairs = ((LINEAR[0], CHECKS[0]), (QUADRATIC[0], CHECKS[1]))
        codes = max(float(np.linalg.norm(answers[a][quantity] - answers[b][quantity])) for a, b in pairs)
        size = float(np.linalg.norm(value))
        band = max(SAFETY * float(np.linalg.norm(value - fine)) + codes, LEAST_BAND * size)
        lines.append(
            {
                "name": quantity,
                "unit": find_unit(quantity),
                "value": value.tolist(),
                "size": size,
                "order": order,
                "band": band,
                "share": band / max(size, 1e-12),
                "codes": codes / max(size, 1e-12),
                "by": {name: float(np.linalg.norm(each[quantity])) for name, each in answers.items()},
                "off": {name: float(np.linalg.norm(each[quantity] - value)) for name, each in answers.items()},
            }
        )
    return {"answers": lines}


def tabulate_answers(folder: Path) -> Table:
    """Tabulate the scores in a folder, by the names of their files."""
    lines = []
    for file in sorted(folder.glob("*.json")):
        score = json.loads(file.read_text())
        bands = [each["distance"] / each["band"] for each in score["compared"]]
        within = f"{sum(band <= 1.0 for band in bands)} of {len(bands)}"
        lines.append((file.stem, score["version"], score["line"].split(": ")[0], score["verdict"], within, max(bands)))
    head = ["answer", "of version", "problem, mesh", "verdict", "quantities within their bands", "farthest [bands]"]
    return Table("Answers of other codes", head, lines)


def _limits(rows: Sequence[Row]) -> dict[str, list[dict]]:
    return {row.case: list(row.values["answers"]) for row in rows if row.method == CONVERGED}


def _compare_codes(lines: Sequence[Values]) -> float:
    """Give the largest difference of two codes, over the problem's largest value of its unit: elsewhere is rounding."""
    largest = {unit: max(line["size"] for line in lines if line["unit"] == unit) for unit in ("mm", "kPa", "mN")}
    return max(line["codes"] * line["size"] / largest[line["unit"]] for line in lines)


def _mean(rows: Sequence[Row], problem: str, method: str) -> float:
    """Mean distance [mm] of a method's named points to the limit."""
    return float(np.mean([line["off"][method] for line in _limits(rows)[problem] if line["name"].startswith("at ")]))
