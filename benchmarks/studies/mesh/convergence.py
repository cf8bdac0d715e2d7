"""How far the answer on a head's own mesh is from that of an ever finer one.

Sub-layers 1, 2, 4 of each tissue show the error across the layers; a mesh split into eight, beside two sub-layers of
the unsplit surface, shows the one along it. Bones are prescribed, so that every mesh solves the same problem.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import InputError
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.head.head import LayeredHead
from ....lhm.head.remesh import refine_head
from ....reference import Parameters, Scene, Solution, facial_scene, prepare, solve
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..measures import difference, limit_of_three, limit_of_two
from ..person import OfPerson

LINEAR, QUADRATIC = "linear tets, four meshes", "linear tets, and quadratic on the head's own mesh"
SUB_LAYERS = (1, 2, 4)
ALONG = 2
"""Sub-layers of the unsplit surface that compare with the split head: a layer of tets split into eight has two."""
MESHES = (*((0, count) for count in SUB_LAYERS), (1, ALONG))
"""Times that the surface is split, and sub-layers, of which the split head's tets are two of their own."""
ORDER_ALONG = 1.0
"""Of the two surface levels, assumed: smooth answers show 2, but springs and borders of bone let less be trusted."""
QUADRATIC_TOLERANCE = 1e-5
ACCEPTED = 0.039
"""Bound of the mean discretisation error [mm]: 0.033 on the default head, 0.041 on the level below."""


@dataclass(frozen=True)
class Convergence(OfPerson):
    """Expressions of one head; `quadratic`: also P2 tets by FEniCSx on the head's mesh."""

    name = "convergence"
    heading = "Is the head's mesh fine enough?"
    question = "How far is a head's own mesh (one layer of prisms per tissue) from the limit of ever finer ones?"
    columns = (
        Column("moved_mm", "moved, max [mm]"),
        Column("mean", "error, mean [mm]"),
        Column("p95", "95 % [mm]"),
        Column("max", "max [mm]"),
        Column("order_across", "order across the layers"),
        Column("gci_across_mm", "GCI across [mm]"),
        Column("gci_along_mm", "GCI along [mm]"),
        Column("quadratic_mm", "to quadratic tets, mean [mm]"),
        Column("iterations", "iterations", cost=True),
    )
    note = (
        "PD's energy with default parameters and prescribed bones, on the skin. The error is the distance to the "
        "limit across the layers plus the change along the surface that is left; both are taken to add. The order is "
        "log2 of the RMS change from 1 to 2 sub-layers over that from 2 to 4. An order outside 0.5 to 2 is brought to "
        "the nearer end, and proves no asymptotic range. The GCI across is 1.25 times the estimated RMS error of the "
        "finest mesh. The GCI along is 3 times it, since two levels show no order. The assumed order of 1 is low, so "
        "the error is rather stated too large. Quadratic tets have springs at the mesh's corners; a split surface has "
        "them at its middles too."
    )

    expressions: tuple[str, ...] = option(
        ("jawOpen*0.5", "mouthSmileLeft+mouthSmileRight", "cheekPuff+mouthPucker*0.5"),
        "as jawOpen*0.5+cheekPuff; repeat for several",
    )
    quadratic: bool = option(False, "also quadratic tets by FEniCSx: minutes")
    tolerance: float = option(1e-7, "gradient norm over its start")

    def tasks(self) -> Sequence[Task]:
        """List each expression; InputError for none."""
        self.check(self.expressions)
        if not self.expressions:
            raise InputError("expressions: there is none")
        if not 0.0 < self.tolerance < 1.0:
            raise InputError(f"tolerance: expected a number in (0, 1), got {self.tolerance}")
        return [Task(text, QUADRATIC if self.quadratic else LINEAR) for text in self.expressions]

    def measure(self, task: Task) -> Values:
        """Measure the solves on every mesh, and the errors of the head's own."""
        of = self.person()
        head, shape, split = of.head, of.shape(task.case), refine_head(of.head)
        solves, skins = [], {}
        for surface, count in MESHES:
            mesh, layers = (head, count) if surface == 0 else (split, 1)
            scene = facial_scene(mesh, Parameters(), shape, bones="prescribed", layers=(layers, layers))
            begin = time.perf_counter()
            solution = prepare(scene).solve(tolerance=self.tolerance)
            skins[surface, count] = mesh.skin_after(shape, solution.positions[: len(mesh.bone)])
            solves.append(_describe_solve(surface, count, "P1", scene, solution, time.perf_counter() - begin))
        quadratic = _solve_quadratic(head, shape, solves) if self.quadratic else None
        errors = _measure_errors(head, shape, skins, quadratic)
        return errors | {"solves": solves, "iterations": sum(row["iterations"] for row in solves)}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that all converge, and a mesh that may do all that another can has at most its energy."""
        solves = [solve for row in rows for solve in row.values["solves"]]
        rises = sum(_find_energy(row, 1, ALONG) > _find_energy(row, 0, 1) for row in rows)
        worst = float(np.max([row.values["mean"] for row in rows]))
        what = "mean discretisation error of the head's own mesh, worst expression [mm]"
        return [
            at_most("solves that did not reach what was asked", sum(not row["converged"] for row in solves), 0),
            at_most("expressions whose energy is higher on the mesh split into eight", rises, 0),
            at_most(what, worst, ACCEPTED),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the errors in one sentence."""
        means = [row.values["mean"] for row in rows]
        most = max(row.values["max"] for row in rows)
        return (
            f"The head's own mesh is {min(means):.3f} to {max(means):.3f} mm on average, and at most {most:.2f} mm, "
            "from the limit of finer meshes."
        )

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate errors by mesh, and the solves."""
        figures = ["mean [mm]", "RMS [mm]", "95 % [mm]", "max [mm]"]
        lines = [
            (row.case, f"{what}{key}", *(off[name] for name in ("mean", "rms", "p95", "max")))
            for row in rows
            for what, group in (("sub-layers: ", "across"), ("times split: ", "along"))
            for key, off in row.values[group].items()
        ]
        same = ("element", "vertices", "tets", "iterations", "converged", "energy", "inverted")
        titles = {"case": "expression", "surface": "times split", "sub_layers": "sub-layers"}
        titles |= {key: key for key in same} | {"seconds": "prepare and solve [s]"}
        solves = [{"case": row.case, **solve} for row in rows for solve in row.values["solves"]]
        return [
            Table("Distance of each mesh to the limit, across the layers and along the surface",
                  ["expression", "mesh", *figures], lines),
            Table.of("Solves", titles, solves),
        ]  # fmt: skip

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw RMS error to the limit against relative size, a line per expression."""
        figure, axes = subplots(1, 2, figsize=(8.6, 3.4), sharey=True)
        for row in rows:
            across = sorted((1.0 / int(count), found["rms"]) for count, found in row.values["across"].items())
            along = sorted((0.5 ** int(level), found["rms"]) for level, found in row.values["along"].items())
            for axis, points in zip(axes, (across, along), strict=True):
                axis.plot(*zip(*points, strict=True), "o-", label=row.case, ms=4)
        for axis, what in zip(axes, ("across: 1 / sub-layers", "along: edges / the head's own"), strict=True):
            axis.set_xscale("log", base=2)
            axis.set(yscale="log", xlabel=what)
        axes[0].set_ylabel("RMS distance to the limit [mm]")
        axes[0].legend()
        return {"Error against the size of the mesh.": to_svg(figure)}


def _find_energy(row: Row, surface: int, count: int) -> float:
    return next(s["energy"] for s in row.values["solves"] if (s["surface"], s["sub_layers"]) == (surface, count))


def _describe_solve(surface: int, count: int, element: str, scene: Scene, solution: Solution, seconds: float) -> dict:
    return {
        "surface": surface,
        "sub_layers": count,
        "element": element,
        "vertices": len(scene.vertices),
        "tets": len(scene.tets),
        "iterations": solution.iterations,
        "converged": solution.converged,
        "energy": solution.energy,
        "inverted": int(np.count_nonzero(solution.volume_ratio <= 0.0)),
        "seconds": seconds,
    }


def _solve_quadratic(head: LayeredHead, shape: Floats, solves: list[dict]) -> Floats:
    """The skin [mm] of quadratic tets on the head's own mesh; its solve is added."""
    scene = facial_scene(head, Parameters(), shape, bones="prescribed")
    begin = time.perf_counter()
    near = solve(scene, tolerance=QUADRATIC_TOLERANCE).positions
    solution = solve(scene, solver="fenicsx", element="P2", start=near, tolerance=QUADRATIC_TOLERANCE)
    solves.append(_describe_solve(0, 1, "P2", scene, solution, time.perf_counter() - begin))
    return head.skin_after(shape, solution.positions[: len(head.bone)])


def _measure_errors(
    head: LayeredHead, shape: Floats, skins: Mapping[tuple[int, int], Floats], quadratic: Floats | None
) -> dict:
    """What the meshes say: the two limits, and the head's own mesh against both together."""
    rest = head.skin.vertices
    through = [skins[0, count] for count in SUB_LAYERS]
    across = limit_of_three(*through)
    unsplit, split = skins[0, ALONG], skins[1, ALONG]
    along = limit_of_two(unsplit, split, ORDER_ALONG)
    both = across.positions + (along.positions - unsplit)
    second = None if quadratic is None else asdict(difference(through[0], quadratic, rest))
    return {
        "moved_mm": float(np.linalg.norm(through[0] - rest, axis=1).max()),
        "order_across": across.observed,
        "gci_across_mm": across.index,
        "gci_along_mm": along.index,
        "across": {
            str(count): asdict(difference(skin, across.positions, rest))
            for count, skin in zip(SUB_LAYERS, through, strict=True)
        },
        "along": {
            "0": asdict(difference(unsplit, along.positions, rest)),
            "1": asdict(difference(split, along.positions, rest)),
        },
        **asdict(difference(through[0], both, rest)),
        "quadratic_to_own": second,
        "quadratic_to_limit": None if quadratic is None else asdict(difference(quadratic, both, rest)),
        "quadratic_mm": second and second["mean"],
    }
