"""Quantities inside a face: all vertices' displacement, stress of each layer, and the mandible's place and load."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, replace

import numpy as np

from ....lhm.base.geometry.warp import rigid_motion
from ....lhm.base.mesh import Floats, Ints
from ....lhm.head.head import MANDIBLE, LayeredHead
from ....reference import Scene, SettledFace, Solution, prepare, terms
from ....reference.face.free_scenes import jaw_hinge
from ...harness.study import Row, Table
from ..measures import difference

LAYERS = ("soft", "muscle")
LOADS = {"force": "mN", "torque": "mN mm"}
TOLERANCE = 1e-8
"""Gradient norm relative to its start of the answer with a mandible that is held."""


def compare_insides(
    head: LayeredHead,
    one: tuple[str, Scene, Solution],
    other: tuple[str, Scene, Solution],
    *,
    settled: tuple[SettledFace, SettledFace] | None = None,
) -> dict:
    """Compare two laws' answers, each a name, a scene and its solution, over all vertices, in stress and at the jaw.

    Nothing holds a free mandible, so "mandible" has the distance of the two and "held_at_pd" the load that holds the
    other's where the first one's is, by FEniCSx (None where that does not converge); there the first one's load is
    zero. A prescribed mandible has its load by law in "prescribed": that of both answers, or of the `settled` faces.
    """
    (_, scene, solution), (_, law_scene, law_solution) = one, other
    ids = mandible(head)
    free = any(np.array_equal(body.vertices, ids) for body in law_scene.of(terms.RigidBody))
    apart = load = None
    if free:
        apart = mandible_apart(head, law_solution.positions, solution.positions)
        prepared = prepare(with_mandible_at(head, law_scene, solution.positions), solver="fenicsx")
        answer = prepared.solve(start=solution.positions, tolerance=TOLERANCE)
        load = load_on_mandible(head, answer) if answer.converged else None
    prescribed: dict[str, Solution | None] = {} if free or not len(ids) else {n: s for n, _, s in (one, other)}
    if settled is not None:
        prescribed = {name: face.solution for (name, _, _), face in zip((one, other), settled, strict=True)}
    return {
        "vertices": asdict(difference(law_solution.positions, solution.positions, scene.vertices)),
        "stress": {n: stress_by_layer(head, sc, s) for n, sc, s in (one, other)},
        "mandible": apart,
        "held_at_pd": load,
        "prescribed": {n: load_on_mandible(head, each) for n, each in prescribed.items() if each is not None},
    }


def stress_by_layer(head: LayeredHead, scene: Scene, solution: Solution) -> dict[str, dict[str, float]]:
    """Give von Mises stress [kPa] of soft tissue and muscle: mean over the volume at rest, and 95 % of it.

    Stresses are of the tets' own terms: the skin's membrane is none of them.
    """
    soft = np.arange(len(scene.tets)) < len(head.soft.tets)
    figures = {}
    for name, layer in zip(LAYERS, (soft, ~soft), strict=True):
        stress, volume = solution.von_mises[layer], scene.volumes[layer]
        order = np.argsort(stress)
        share = np.cumsum(volume[order])
        most = stress[order][np.searchsorted(share, 0.95 * share[-1])]
        figures[name] = {"mean": float(np.average(stress, weights=volume)), "p95": float(most)}
    return figures


def mandible(head: LayeredHead) -> Ints:
    """Give the indices of the mandible's vertices in a scene of one layer of tets per tissue."""
    return 2 * len(head.bone) + np.flatnonzero(head.bone == MANDIBLE)


def load_on_mandible(head: LayeredHead, solution: Solution) -> dict[str, float]:
    """Give force [mN] and torque [mN mm] about `jaw_hinge` that hold a prescribed mandible: sums of its reactions.

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
    """Give how far two answers' mandibles are apart: mean distance [mm] of their vertices, and the turn [degrees]."""
    ids = mandible(head)
    if len(ids) < 3:
        return {"mm": 0.0, "degrees": 0.0}
    rotation, _ = rigid_motion(others[ids], positions[ids])
    # The sine keeps small angles that the cosine rounds away.
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    angle = np.arctan2(np.linalg.norm(axis), np.trace(rotation) - 1.0)
    apart = np.linalg.norm(positions[ids] - others[ids], axis=1)
    return {"mm": float(apart.mean()), "degrees": float(np.degrees(angle))}


def tabulate_insides(rows: Iterable[Row], one: str, other: str) -> list[Table]:
    """Tabulate "inside" of the rows that have it: vertices and stress; the mandible's place and load."""
    inside = {row.case: row.values["inside"] for row in rows if "inside" in row.values}
    if not inside:
        return []
    kinds = [(layer, law, key) for layer in LAYERS for law in (one, other) for key in ("mean", "p95")]
    titles = ["case", "vertices, mean [mm]", "max [mm]"]
    titles += [f"{layer}, {law}, {'95 %' if key == 'p95' else key} [kPa]" for layer, law, key in kinds]
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
    jaws = ["case", "free: mean distance [mm]", "turn [degrees]", f"{other} held where {one} has it: force [mN]"]
    jaws += ["torque [mN mm]"]
    jaws += [f"prescribed: {key}, {law} [{unit}]" for key, unit in LOADS.items() for law in (one, other)]
    places = []
    for case, values in inside.items():
        free, load, loads = values.get("mandible") or {}, values.get("held_at_pd") or {}, values["prescribed"]
        prescribed = [loads.get(law, {}).get(key) for key in LOADS for law in (one, other)]
        places.append((case, free.get("mm"), free.get("degrees"), load.get("force"), load.get("torque"), *prescribed))
    balance = "A free mandible is in balance. Torques are about the axis between the ears."
    return [
        Table(f"Inside: {one} and {other}", titles, cells, note),
        Table("The mandible: place and load", jaws, places, balance),
    ]
