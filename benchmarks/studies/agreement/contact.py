"""PD's contact of lips and lids beside ipctk's barrier."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....lhm.base.mesh import Floats, Ints
from ....lhm.base.option import option
from ....lhm.head.head import LayeredHead
from ....reference import Parameters, Reason, Scene, Solution, facial_scene, prepare, solve, terms
from ...harness.study import Column, Row, Task, Values, at_most
from ..measures import distances
from ..person import OfPerson, check_known

LIPS, LIDS = ("lips", "mouth"), ("lids", "eyes")
POSES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "lips pressed": ("mouthPressLeft+mouthPressRight", LIPS),
    "lower lip raised": ("mouthShrugLower", LIPS),
    "lids shut": ("eyeBlinkLeft+eyeBlinkRight", LIDS),
}
"""Expressions in which the regions beside them would go through each other."""
BOTH = "PD's contact and ipctk's barrier"
AROUND = 5
"""Edges about the regions in contact, up to which tets are solved for: two more than contact reaches."""
STEPS = 4
"""Shares of the way to an expression's targets on which Newton's method meets the barrier little by little."""
ON_THE_WAY, TOLERANCE = 1e-2, 1e-6
"""Gradient norm relative to its start, before the last share and at the end."""
MOVES = 0.05
"""[mm] by which contact has to move a vertex that counts."""


@dataclass(frozen=True)
class Contact(OfPerson):
    """Lips pressed and lids shut by PD and by a barrier."""

    name = "contact"
    heading = "Are lips and lids parted as another code parts them?"
    question = "How far is PD's contact from ipctk's barrier?"
    columns = (
        Column("depth_before_mm", "overlap without contact [mm]"),
        Column("depth_after_mm", "with it [mm]"),
        Column("moved_mean_mm", "contact moves, mean [mm]"),
        Column("moved_max_mm", "max [mm]"),
        Column("apart_mean_mm", "PD to barrier, mean [mm]"),
        Column("apart_max_mm", "max [mm]"),
        Column("where", "where"),
        Column("force_pd_mn", "contact force by PD [mN]"),
        Column("force_barrier_mn", "by the barrier [mN]"),
        Column("iterations_barrier", "Newton's iterations"),
    )
    note = (
        "One energy, PD's, on one mesh: the tets about lips or lids, beyond which the expression holds the face. PD "
        "parts surfaces after the solve without contact; scikit-fem minimises the energy with ipctk's barrier from "
        f"rest on. Means are over vertices that contact moves by more than {MOVES:g} mm. The force is half the sum of "
        "what each vertex is pushed with, the remainder of the energy's gradient without contact."
    )

    poses: tuple[str, ...] = option(tuple(POSES), f"one of {', '.join(POSES)}; repeat for several", name="--pose")

    def tasks(self) -> Sequence[Task]:
        """List each pose; InputError for an unknown one."""
        self.check()
        check_known("pose", self.poses, POSES)
        return [Task(pose, BOTH) for pose in self.poses]

    def measure(self, task: Task) -> Values:
        """Compare a pose by both codes."""
        person, (text, regions) = self.person(), POSES[task.case]
        head, shape, near = person.head, person.shape(text), _find_around(person.head, regions)

        def scene_at(share: float) -> Scene:
            targets = head.skin.vertices + share * (shape - head.skin.vertices)
            return facial_scene(head, Parameters(), targets, region=near, contact=regions)

        by_barrier = solve_by_barrier(scene_at)
        values = compare_contact(scene_at(1.0), by_barrier)
        return values | {"where": _name_place(head, values["worst_vertex"])}

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that the barrier is solved, and that PD is nearer to it than a face without contact is."""
        poses = [row.values for row in rows]
        if not poses:
            return []
        failed = sum(values["reasons"][1] != str(Reason.CONVERGED) for values in poses)
        share = max(values["apart_mean_mm"] / values["moved_mean_mm"] for values in poses)
        return [
            at_most("poses whose barrier was not solved", failed, 0),
            at_most("mean distance of PD's contact to the barrier, of what contact moves", share, 0.5),
        ]

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how far the codes are apart in each pose."""
        sentences = [
            f"{row.case}: contact moves the skin by {row.values['moved_mean_mm']:.2f} mm on average, PD and the "
            f"barrier are {row.values['apart_mean_mm']:.3f} mm apart, and push with "
            f"{row.values['force_pd_mn']:.0f} and {row.values['force_barrier_mn']:.0f} mN"
            + ("." if row.values["done"] else f"; PD leaves an overlap of {row.values['depth_after_mm']:.2f} mm.")
            for row in rows
        ]
        return " ".join(sentences)


def solve_by_barrier(scene_at: Callable[[float], Scene]) -> Solution:
    """Solve a scene of a share of its motion by scikit-fem and ipctk, share by share from rest to the whole."""
    prepared, positions = prepare(scene_at(0.0), solver="skfem"), None
    for step in range(1, STEPS):
        positions = prepared.solve(scene_at(step / STEPS), start=positions, tolerance=ON_THE_WAY).positions
    return prepared.solve(scene_at(1.0), start=positions, tolerance=TOLERANCE)


def compare_contact(scene: Scene, by_barrier: Solution) -> dict:
    """Solve a scene by PD with and without its Contact, and compare the barrier's answer with both.

    Figures are over the vertices of the surface in contact; "worst_vertex" is where the codes are farthest apart.
    """
    (contact,) = scene.of(terms.Contact)
    without = replace(scene, terms=tuple(term for term in scene.terms if term is not contact))
    ids = np.unique(contact.triangles)
    by_pd, free = solve(scene, tolerance=TOLERANCE), solve(without, tolerance=TOLERANCE)
    motion = distances(by_barrier.positions, free.positions)[ids]
    apart = distances(by_barrier.positions, by_pd.positions)[ids]
    counts = motion > MOVES
    forces = [measure_pushes(without, ids, each.positions) for each in (by_pd, by_barrier)]
    return {
        "done": by_pd.converged and by_barrier.converged and free.converged,
        "reasons": [str(by_pd.reason), str(by_barrier.reason)],
        "tets": len(scene.tets),
        "pairs_before": int(by_pd.detail["contact_pairs_before"]),
        "depth_before_mm": by_pd.detail["contact_depth_before"],
        "depth_after_mm": by_pd.detail["contact_depth_after"],
        "moved_mean_mm": float(motion[counts].mean()),
        "moved_max_mm": float(motion.max()),
        "vertices_moved": int(counts.sum()),
        "apart_mean_mm": float(apart[counts].mean()),
        "apart_max_mm": float(apart.max()),
        "worst_vertex": int(ids[apart.argmax()]),
        "force_pd_mn": float(0.5 * forces[0].sum()),
        "force_barrier_mn": float(0.5 * forces[1].sum()),
        "iterations_pd": by_pd.iterations,
        "iterations_barrier": by_barrier.iterations,
    }


def measure_pushes(without: Scene, ids: Ints, positions: Floats) -> Floats:
    """Measure the force [mN], shape (k,), that keeps each vertex `ids` where it is, in a scene without contact.

    Components that the scene holds itself do not count.
    """
    held = replace(without, terms=(*without.terms, terms.Fixed(ids, positions[ids])))
    reactions = solve(held, start=positions, max_iterations=0).reactions[ids]
    return np.linalg.norm(np.where(without.dirichlet()[0][ids], 0.0, reactions), axis=1)


def _find_around(head: LayeredHead, regions: Sequence[str]) -> np.ndarray:
    """Mark the wraps' vertices within AROUND edges of some regions, shape (n,)."""
    triangles, inside = head.skin_wrap.triangles, np.any([head.regions[name] for name in regions], axis=0)
    for _ in range(AROUND):
        inside[triangles[inside[triangles].any(axis=1)]] = True
    return inside


def _name_place(head: LayeredHead, vertex: int) -> str:
    """Name the region of a vertex, the smallest that it is of."""
    place = vertex % len(head.bone)
    named = [name for name, mask in head.regions.items() if mask[place]]
    return min(named, key=lambda name: int(head.regions[name].sum())) if named else "beside"
