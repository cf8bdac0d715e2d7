"""Quantities inside a face: all vertices' displacement, stress of each layer, and the mandible's place and load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace

import numpy as np

from ....lhm.base.geometry.warp import rigid_motion
from ....lhm.base.mesh import Floats, Ints
from ....lhm.head import MANDIBLE, LayeredHead
from ....reference import Scene, Solution, prepare, terms
from ....reference.face.free_scenes import jaw_hinge
from ...harness.study import Table
from ..measures import difference

LAYERS = ("soft", "muscle")
TOLERANCE = 1e-8
"""Gradient norm relative to its start of the answer with a mandible that is held."""


def compare_insides(
    head: LayeredHead,
    one: tuple[str, Scene, Solution],
    other: tuple[str, Scene, Solution],
    *,
    solver: str = "fenicsx",
) -> dict:
    """Compare two laws' answers, each a name, a scene and its solution, over all vertices, in stress and at the jaw.

    Nothing holds a free mandible, so "mandible" has the distance of the two and "held_at_pd" the load that holds the
    other's where the first one's is, solved by `solver`; there the first one's load is zero. A mandible that both
    scenes hold has its load by law in "prescribed".
    """
    (_, scene, solution), (_, law_scene, law_solution) = one, other
    ids = mandible(head)
    free = any(np.array_equal(body.vertices, ids) for body in law_scene.of(terms.RigidBody))
    loads = {} if free or not len(ids) else {n: load_on_mandible(head, s) for n, _, s in (one, other)}
    return {
        "vertices": asdict(difference(law_solution.positions, solution.positions, scene.vertices)),
        "stress": {n: stress_by_layer(head, sc, s) for n, sc, s in (one, other)},
        "mandible": mandible_apart(head, law_solution.positions, solution.positions) if free else None,
        "held_at_pd": _held(head, law_scene, law_solution, solution.positions, solver) if free else None,
        "prescribed": loads,
    }


def _held(head: LayeredHead, scene: Scene, solution: Solution, at: Floats, solver: str) -> dict[str, float] | None:
    """Return the load that holds the mandible where `at` [mm] has it; None where that does not converge."""
    prepared = prepare(with_mandible_at(head, scene, at), solver=solver)
    held = prepared.solve(start=solution.positions, tolerance=TOLERANCE)
    return load_on_mandible(head, held) if held.converged else None


def stress_by_layer(head: LayeredHead, scene: Scene, solution: Solution) -> dict[str, dict[str, float]]:
    """Return von Mises stress [kPa] of soft tissue and muscle: mean over the volume at rest, and 95 % of it.

    Stresses are of the tets' own terms: the skin's membrane is none of them.
    """
    soft = np.arange(len(scene.tets)) < len(head.soft.tets)
    stress, volume = solution.von_mises, scene.volumes
    return {
        name: {
            "mean": float(np.average(stress[layer], weights=volume[layer])),
            "p95": _quantile(stress[layer], volume[layer], 0.95),
        }
        for name, layer in zip(LAYERS, (soft, ~soft), strict=True)
    }


def mandible(head: LayeredHead) -> Ints:
    """Return the indices of the mandible's vertices in a scene of one layer of tets per tissue."""
    return 2 * len(head.bone) + np.flatnonzero(head.bone == MANDIBLE)


def load_on_mandible(head: LayeredHead, solution: Solution) -> dict[str, float]:
    """Return force [mN] and torque [mN mm] about `jaw_hinge` that hold a prescribed mandible: sums of its reactions.

    They are zero for a free mandible, which is in balance.
    """
    ids = mandible(head)
    force = solution.reactions[ids]
    torque = np.cross(solution.positions[ids] - jaw_hinge(head), force).sum(axis=0)
    return {"force": float(np.linalg.norm(force.sum(axis=0))), "torque": float(np.linalg.norm(torque))}


def with_mandible_at(head: LayeredHead, scene: Scene, positions: Floats) -> Scene:
    """Hold the free mandible of a scene where `positions` [mm], shape (scene's vertices, 3), have it."""
    ids = mandible(head)
    others = [t for t in scene.terms if not (isinstance(t, terms.RigidBody) and np.array_equal(t.vertices, ids))]
    return replace(scene, terms=(*others, terms.Fixed(ids, positions[ids])))


def mandible_apart(head: LayeredHead, positions: Floats, others: Floats) -> dict[str, float]:
    """Return how far two answers' mandibles are apart: mean distance [mm] of their vertices, and the turn [degrees]."""
    ids = mandible(head)
    if len(ids) < 3:
        return {"mm": 0.0, "degrees": 0.0}
    rotation, _ = rigid_motion(others[ids], positions[ids])
    # The sine keeps small angles that the cosine rounds away.
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    angle = np.arctan2(np.linalg.norm(axis), np.trace(rotation) - 1.0)
    apart = np.linalg.norm(positions[ids] - others[ids], axis=1)
    return {"mm": float(apart.mean()), "degrees": float(np.degrees(angle))}


def vertices_and_stress(inside: Mapping[str, dict], one: str, other: str) -> Table:
    """Tabulate by case "vertices", a `Difference` of all vertices as a dict, and "stress" by law and layer."""
    kinds = [(layer, law, key) for layer in LAYERS for law in (one, other) for key in ("mean", "p95")]
    titles = [f"{layer}, {law}, {'95 %' if key == 'p95' else key} [kPa]" for layer, law, key in kinds]
    cells = [
        (
            case,
            values["vertices"]["mean"],
            values["vertices"]["max"],
            *(values["stress"][law][layer][key] for layer, law, key in kinds),
        )
        for case, values in inside.items()
    ]
    note = (
        "Distances of all vertices, of skin and inside. Von Mises stress of the tets by volume, without the membrane."
    )
    return Table(f"Inside: {one} and {other}", ["case", "vertices, mean [mm]", "max [mm]", *titles], cells, note)


def loads_on_mandible(inside: Mapping[str, dict], one: str, other: str) -> Table:
    """Tabulate by case "mandible", "held_at_pd" and "prescribed": where it is, and what holds it."""
    titles = ["case", "free: mean distance [mm]", "turn [degrees]", f"{other} held where {one} has it: force [mN]"]
    titles += ["torque [mN mm]"]
    titles += [f"prescribed: {key}, {law} [{unit}]" for key, unit in _LOADS.items() for law in (one, other)]
    cells = []
    for case, values in inside.items():
        free, held, loads = values.get("mandible") or {}, values.get("held_at_pd") or {}, values["prescribed"]
        prescribed = [loads.get(law, {}).get(key) for key in _LOADS for law in (one, other)]
        cells.append((case, free.get("mm"), free.get("degrees"), held.get("force"), held.get("torque"), *prescribed))
    note = "A free mandible is in balance. Torques are about the axis between the ears."
    return Table("The mandible: place and load", titles, cells, note)


_LOADS = {"force": "mN", "torque": "mN mm"}


def _quantile(values: Floats, weights: Floats, share: float) -> float:
    """Return the value below which the values of this share of all weight lie."""
    order = np.argsort(values)
    reached = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(reached, share * reached[-1])])
