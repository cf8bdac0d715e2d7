"""Every ARKit shape at full weight on random identities: which invert tets of soft tissue, and what lids and lips miss.

Scenes are `facial_scene`'s at default parameters, solved by projective dynamics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ....animation.plots import subplots, to_svg
from ....lhm.base.errors import InputError
from ....lhm.base.limits import STUDIED_HEADS
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.expressions import ARKIT
from ....lhm.head.head import LayeredHead
from ....reference import Parameters, Prepared, facial_scene, prepare
from ....surrogate.methods import PD
from ...harness.study import Column, Row, Table, Task, Values, at_most
from ..person import OfPerson, Person

REGIONS = ("face", "lids", "lips")


@dataclass(frozen=True)
class Shapes(OfPerson):
    """Random identities, of seeds from the study's on, in every shape that their space has."""

    name = "shapes"
    heading = "Which expressions turn tetrahedra inside out?"
    question = "Which ARKit shapes at full weight invert tets of soft tissue, and how far do lids and lips stay off?"
    cheap = "identity 1, PD"
    columns = (
        Column("shape", "shape"),
        Column("soft", "inverted tets, soft tissue"),
        Column("muscle", "inverted tets, muscle"),
        Column("least_j", "smallest volume ratio, soft tissue"),
        *(Column(f"{region}_mean", f"{region}: from targets, mean [mm]") for region in REGIONS),
        Column("iterations", "iterations", cost=True),
    )

    count: int = option(20, "how many random identities, half a minute each", bound=STUDIED_HEADS)

    def tasks(self) -> Sequence[Task]:
        """List an identity each; InputError for none."""
        self.check()
        if self.count < 1:
            raise InputError(f"count: must be at least 1, got {self.count}")
        return [Task(f"identity {seed}", PD) for seed in range(self.seed, self.seed + self.count)]

    def measure(self, task: Task) -> Values:
        """Measure a row per shape."""
        return {"rows": simulate_shapes(self.person(seed=int(task.case.split()[1])))}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that few pairs have an inverted tet, and all frames converge."""
        lines = _collect_lines(rows)
        share = sum(line["soft"] > 0 for line in lines) / len(lines)
        return [
            at_most("share of pairs with an inverted tet in soft tissue", share, 0.02),
            at_most("frames that did not converge", sum(not line["converged"] for line in lines), 0),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how many invert."""
        lines = _collect_lines(rows)
        inverted = sum(line["soft"] > 0 for line in lines)
        return f"{inverted} of {len(lines)} pairs of identity and shape have an inverted tet in soft tissue."

    def tables(self, rows: Sequence[Row]) -> Sequence[Table]:
        """Tabulate the identities together, by shape."""
        head = ["shape", "identities", "with an inverted tet in soft tissue", "most in soft tissue", "most in muscle",
                "smallest volume ratio", "did not converge",
                *(f"{region}: from targets, mean [mm]" for region in REGIONS)]  # fmt: skip
        return [Table("By shape", head, [list(row.values()) for row in summarise_shapes(_collect_lines(rows))])]

    def pictures(self, rows: Sequence[Row]) -> Mapping[str, str]:
        """Draw how far lids and lips stay from their targets."""
        summary = summarise_shapes(_collect_lines(rows))
        figure, axis = subplots(figsize=(11, 3.6))
        for region in REGIONS:
            axis.plot([row[f"{region}_mean"] for row in summary], "o", ms=4, label=region)
        axis.set_xticks(range(len(summary)), [row["shape"] for row in summary], rotation=90, fontsize=7)
        axis.set_ylabel("distance from targets, mean [mm]")
        axis.legend()
        return {"How far face, lids and lips stay from their targets, mean over identities.": to_svg(figure)}


def _collect_lines(rows: Sequence[Row]) -> list[Values]:
    return [line for row in rows for line in row.values["rows"]]


def simulate_shapes(person: Person, chosen: Sequence[int] = tuple(range(len(ARKIT)))) -> list[dict]:
    """Simulate a row per shape (numbers in ARKit's order) that a person's space has."""
    head, deltas = person.head, person.space.expression_deltas(person.code)
    skin, rows = head.skin, []
    prepared: Prepared | None = None
    for shape in chosen:
        if deltas[shape].any():
            scene = facial_scene(head, Parameters(), skin.vertices + deltas[shape])
            prepared = prepare(scene, solver="projective") if prepared is None else prepared
            solution = prepared.solve(scene, tolerance=3e-4)  # as a corpus' frames have it
            row = {"shape": ARKIT[shape], "converged": solution.converged}
            targets = head.wrap_targets(skin.vertices + deltas[shape])
            row |= _measure_tets(head, solution.volume_ratio, solution.positions[: len(targets)] - targets)
            rows.append(row | {"iterations": solution.iterations})
    return rows


def _measure_tets(head: LayeredHead, volume_ratio: Floats, missed: Floats) -> dict:
    """Inverted tets, and how far [mm] the wrap `missed` (n, 3) its targets in regions: mean, and the largest."""
    soft, muscle = np.split(volume_ratio, [len(head.soft.tets)])
    distance = np.linalg.norm(missed, axis=1)
    figures: dict = {"soft": int((soft <= 0).sum()), "muscle": int((muscle <= 0).sum()), "least_j": float(soft.min())}
    for region in REGIONS:
        inside = distance[head.regions[region]]
        figures |= {f"{region}_mean": float(inside.mean()), f"{region}_max": float(inside.max())}
    return figures


def summarise_shapes(rows: Sequence[Values]) -> list[dict]:
    """Join the rows of each shape: identities with an inverted tet in soft tissue, the worst and mean figures."""
    table = []
    for shape in ARKIT:
        lines = [row for row in rows if row["shape"] == shape]
        if lines:
            table.append(
                {
                    "shape": shape,
                    "identities": len(lines),
                    "inverted": sum(row["soft"] > 0 for row in lines),
                    "soft": max(row["soft"] for row in lines),
                    "muscle": max(row["muscle"] for row in lines),
                    "least_j": min(row["least_j"] for row in lines),
                    "unfinished": sum(not row["converged"] for row in lines),
                    **{
                        f"{region}_mean": float(np.mean([row[f"{region}_mean"] for row in lines])) for region in REGIONS
                    },
                }
            )
    return table
