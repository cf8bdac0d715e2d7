"""How far registered points slide, and how near transferred expressions come to a head's own.

Two heads with rigs of their own are laid upon one another both ways. A point of the one is carried to the other and
back: what it is off then is slide. A head's transferred shapes are then compared with its own. How much of what is left
is transfer's and how much registration's, a person of the same space tells, whose shapes and points are known.

No study of the common runner: two registrations, some minutes each, answer all of it together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..lhm.arkit import ARKIT
from ..lhm.base.geometry.rays import visible_sky
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..lhm.base.progress import OnProgress
from ..lhm.base.provenance import describe_machine
from ..lhm.expressions.transfer import transfer_expressions
from ..lhm.fit import transfer_rig
from ..lhm.identities import LinearSpace
from ..lhm.identities.space import OUTSIDE
from ..lhm.registration.alignment import Target
from ..lhm.registration.registration import Registration, find_face, register
from ..lhm.wraps.landmarks import Mask

SEEN = 0.2
"""What sees less of the sky (nostrils, folds) has no counterpart on another head, and is not measured."""


def run_registrations(spaces: Sequence[LinearSpace], seed: int, progress: OnProgress) -> dict[str, Any]:
    """Slides and shapes of two spaces' mean heads, and of a person of each; with the machine and the options."""
    one, other = spaces
    progress(f"{one.name} upon {other.name}", 0.0)
    there = register(one.mean, one.parts, other.mean)
    progress(f"{other.name} upon {one.name}", 0.25)
    back = register(other.mean, other.parts, one.mean)
    options = {"identities": one.name, "upon": other.name, "seed": seed}
    results: dict[str, Any] = {"machine": describe_machine(), "options": options, "slide": [], "shapes": []}
    for number, (space, upon, forth, home) in enumerate(((one, other, there, back), (other, one, back, there))):
        away = slide(space, forth, upon, home)
        results["slide"].append(
            {"from": space.name, "upon": upon.name, "mean_mm": float(away.mean()), "median_mm": float(np.median(away))}
            | {"p95_mm": float(np.quantile(away, 0.95)), "points": len(away), "crossings": forth.crossings}
        )
        rig = transfer_rig(space, forth).deltas
        rows = {"another rig": agreement(rig, upon.expressions, upon.parts == OUTSIDE)}
        progress(f"a person of {space.name}", 0.5 + 0.25 * number)
        results["shapes"].append({"from": space.name, "upon": upon.name, "rows": rows | _of_a_person(space, seed)})
    progress("registrations", 1.0)
    return results


def slide(space: LinearSpace, forth: Registration, upon: LinearSpace, home: Registration) -> Floats:
    """How far [mm] the visible points of a space's mean face are off after they were carried to another and back."""
    face = visible_face(space)
    corners, shares, good = Target(upon.mean).located(forth.vertices[face], forth.surface.vertex_normals[face])
    back = (shares[:, :, None] * home.vertices[corners]).sum(axis=1)
    return np.linalg.norm(back - space.mean.vertices[face], axis=1)[good]


def visible_face(space: LinearSpace) -> Mask:
    """The vertices (n,) of a mean head's face that see the sky."""
    return find_face(space.mean, space.parts)[1] & (visible_sky(space.mean) > SEEN)


def agreement(found: Floats | Floats32, own: Floats | Floats32, visible: Mask) -> list[dict[str, Any]]:
    """By shape that both have: cosine between displacements (52, n, 3), and their mean distance [mm], where visible."""
    rows = []
    for k, name in enumerate(ARKIT):
        a, b = (deltas[k][visible].astype(np.float64) for deltas in (own, found))
        size = np.linalg.norm(a) * np.linalg.norm(b)
        if size > 0:
            mean = float(np.linalg.norm(a - b, axis=1).mean())
            rows.append({"shape": name, "cosine": float((a * b).sum() / size), "mean_mm": mean})
    return rows


def _of_a_person(space: LinearSpace, seed: int) -> dict[str, list[dict[str, Any]]]:
    """Agreement with a random person's own shapes, by exact points, and by points that registration finds."""
    skin = space.sample(np.random.default_rng(seed))[1]
    visible = space.parts == OUTSIDE
    exact = transfer_expressions(space.mean, space.expressions, skin)
    # Other numbers for its vertices, so that nothing can be known of the points.
    order = np.random.default_rng(seed).permutation(len(skin.vertices))
    other = Surface(skin.vertices[order], np.argsort(order)[skin.triangles])
    found = transfer_rig(space, register(space.mean, space.parts, other)).deltas
    return {
        "a person, exact points": agreement(exact, space.expressions, visible),
        "a person, registered": agreement(found, space.expressions[:, order], visible[order]),
    }


def median(rows: Sequence[dict[str, Any]]) -> tuple[float, float]:
    """The median cosine over the shapes, and the mean distance [mm]."""
    return float(np.median([row["cosine"] for row in rows])), float(np.mean([row["mean_mm"] for row in rows]))
