"""Every ARKit shape at full weight on random identities: which invert tets of soft tissue, and what lids and lips miss.

Scenes are `facial_scene`'s at default parameters, solved by projective dynamics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..lhm import Template, fit_head, identities, load_template
from ..lhm.expressions import ARKIT
from ..lhm.head import LayeredHead
from ..lhm.identities import LinearSpace
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress
from ..reference import Parameters, Prepared, facial_scene, prepare
from ..surrogate.schedule import results_of, schedule

ALLOWED = 0.02
"""Share of the pairs of identity and shape that may have an inverted tet in soft tissue."""
REGIONS = ("face", "lids", "lips")
TOLERANCE = 3e-4
"""Of the gradient norm, as a corpus' frames have it."""


@dataclass(frozen=True, eq=False)
class ShapesTask:
    """The rows of one identity, by seed; `shapes` are numbers in ARKit's order."""

    space: LinearSpace
    template: Template
    shapes: tuple[int, ...] = tuple(range(len(ARKIT)))

    def __call__(self, seed: int) -> list[dict]:
        """A row per shape that the space has."""
        code, skin = self.space.sample(np.random.default_rng(seed))
        head = fit_head(self.template, skin)
        deltas = self.space.expression_deltas(code)
        prepared: Prepared | None = None
        rows = []
        for shape in self.shapes:
            if deltas[shape].any():
                scene = facial_scene(head, Parameters(), skin.vertices + deltas[shape])
                prepared = prepare(scene, solver="projective") if prepared is None else prepared
                solution = prepared.solve(scene, tolerance=TOLERANCE)
                row = {"seed": seed, "shape": ARKIT[shape], "converged": solution.converged}
                targets = head.wrap_targets(skin.vertices + deltas[shape])
                row |= _figures(head, solution.volume_ratio, solution.positions[: len(targets)] - targets)
                rows.append(row | {"iterations": solution.iterations})
        return rows


def _figures(head: LayeredHead, volume_ratio: Floats, missed: Floats) -> dict:
    """Inverted tets, and how far [mm] the wrap `missed` (n, 3) its targets in regions: mean, and the largest."""
    soft, muscle = np.split(volume_ratio, [len(head.soft.tets)])
    distance = np.linalg.norm(missed, axis=1)
    figures: dict = {"soft": int((soft <= 0).sum()), "muscle": int((muscle <= 0).sum()), "least_j": float(soft.min())}
    for region in REGIONS:
        inside = distance[head.regions[region]]
        figures |= {f"{region}_mean": float(inside.mean()), f"{region}_max": float(inside.max())}
    return figures


def run_shapes(names: str, seeds: Sequence[int], workers: int, progress: OnProgress) -> list[dict]:
    """Rows of ShapesTask for identities of these seeds in a space ('anny' or 'ict:FILE'), by seed and shape."""
    space = identities.from_text(names)
    task = ShapesTask(space, load_template(space, progress=progress))
    rows: list[dict] = []
    for number, found in enumerate(results_of(task, seeds, on=schedule(workers), name="shapes"), start=1):
        rows += found
        progress(f"shapes: {number} of {len(seeds)} identities", number / len(seeds))
    return sorted(rows, key=lambda row: (row["seed"], ARKIT.index(row["shape"])))


def by_shape(rows: Sequence[dict]) -> list[dict]:
    """The rows of each shape as one: identities with an inverted tet in soft tissue, the worst and mean figures."""
    table = []
    for shape in ARKIT:
        own = [row for row in rows if row["shape"] == shape]
        if own:
            table.append(
                {
                    "shape": shape,
                    "identities": len(own),
                    "inverted": sum(row["soft"] > 0 for row in own),
                    "soft": max(row["soft"] for row in own),
                    "muscle": max(row["muscle"] for row in own),
                    "least_j": min(row["least_j"] for row in own),
                    "unfinished": sum(not row["converged"] for row in own),
                    **{f"{region}_mean": float(np.mean([row[f"{region}_mean"] for row in own])) for region in REGIONS},
                }
            )
    return table
