"""How far is projective dynamics from the answer when it stops early? One file, one study."""

from dataclasses import dataclass, field

import numpy as np

from softdeca.benchmarks.harness import Column, Study, Task
from softdeca.benchmarks.harness.study import at_most
from softdeca.benchmarks.studies import add_study
from softdeca.reference import Scene, solve, terms
from softdeca.reference.problems.meshes import block, vertices_at


def hanging():
    """A soft cube of 20 mm that hangs by its top."""
    X, tets = block(6, 20.0)
    gravity = terms.Gravity((0, 0, -9810), density=1.04e-6)
    return Scene(
        X,
        tets,
        [
            terms.Strain(1.0),
            terms.Volume(10.0),
            terms.Fixed(vertices_at(X, 2, 20.0)),
            gravity,
        ],
    )


@add_study
@dataclass(frozen=True)
class StoppedEarly(Study):
    """A hanging cube, by the tolerance of the solve."""

    name = "stopped-early"
    question = "How far is PD from Newton's answer when it is stopped early?"
    columns = (
        Column("error_mm", "largest error [mm]"),
        Column("iterations", "iterations", cost=True),
    )

    tolerances: tuple[str, ...] = field(
        default=("1e-2", "1e-4", "1e-6"), metadata={"help": "repeat for several"}
    )

    def tasks(self):
        """A task for each tolerance."""
        return [Task("hanging cube", f"tolerance {text}") for text in self.tolerances]

    def measure(self, task):
        """The largest distance of a vertex to scikit-fem's tight answer."""
        scene, tolerance = hanging(), float(task.method.split()[1])
        truth = solve(scene, solver="skfem", tolerance=1e-10)
        early = solve(scene, tolerance=tolerance)
        error = np.linalg.norm(early.positions - truth.positions, axis=1).max()
        return {"error_mm": error, "iterations": early.iterations}

    def gates(self, rows):
        """Bound the error by 0.01 mm, which a face needs, at the tightest tolerance."""
        return [
            at_most(
                "error at the tightest tolerance [mm]",
                min(row.values["error_mm"] for row in rows),
                0.01,
            )
        ]

    def words(self, rows):
        """The tolerance that is enough."""
        enough = [row for row in rows if row.values["error_mm"] <= 0.01]
        return (
            f"{enough[0].method} is enough for 0.01 mm."
            if enough
            else "No tolerance is enough for 0.01 mm."
        )
