"""PD's contact of lips and lids: beside ipctk's barrier, and on hard frames of several people."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ....lhm.base.geometry.bvh import TriangleTree
from ....lhm.base.limits import Bound
from ....lhm.base.mesh import Floats
from ....lhm.base.option import option
from ....lhm.head.head import LayeredHead
from ....reference import Face, Parameters, Reason, Scene, Solution, facial_scene, prepare, solve, terms
from ....surrogate.methods import PD
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
BLINK, SQUINT = "eyeBlinkLeft+eyeBlinkRight", "eyeSquintLeft+eyeSquintRight"
PRESS, SMILE = "mouthPressLeft+mouthPressRight", "mouthSmileLeft+mouthSmileRight"
ROLLS = "mouthRollLower+mouthRollUpper"
HARD: Mapping[str, str] = {
    "blink": BLINK,
    "blink, squint": f"{BLINK}+{SQUINT}",
    "blink, squint, cheeks": f"{BLINK}+{SQUINT}+cheekSquintLeft+cheekSquintRight",
    "blink of 0.8, squint": f"eyeBlinkLeft*0.8+eyeBlinkRight*0.8+{SQUINT}",
    "wink, squint": f"eyeBlinkLeft+{SQUINT}",
    "blink, brows down": f"{BLINK}+browDownLeft+browDownRight",
    "press": PRESS,
    "lower lip raised": "mouthShrugLower",
    "both lips raised": "mouthShrugLower+mouthShrugUpper",
    "close, jaw open": "mouthClose+jawOpen",
    "close of 0.6, jaw of 0.5": "mouthClose*0.6+jawOpen*0.5",
    "close": "mouthClose",
    "close of 0.3": "mouthClose*0.3",
    "pucker": "mouthPucker",
    "pucker, funnel": "mouthPucker+mouthFunnel",
    "pucker, press": f"mouthPucker+{PRESS}",
    "rolls": ROLLS,
    "lower roll, press": f"mouthRollLower+{PRESS}",
    "upper roll, lower lip raised": "mouthRollUpper+mouthShrugLower",
    "smile, press": f"{SMILE}+{PRESS}",
    "frown, lower lip raised": "mouthFrownLeft+mouthFrownRight+mouthShrugLower",
    "jaw forward, lower lip raised": "jawForward+mouthShrugLower",
    "mouth left, press": f"mouthLeft+{PRESS}",
    "blink, squint, press, lower lip raised": f"{BLINK}+{SQUINT}+{PRESS}+mouthShrugLower",
    "jaw of 0.3, rolls": f"jawOpen*0.3+{ROLLS}",
}
"""Expressions in which lips or lids meet, but for two of an open jaw, which cost what they do without contact."""
MADE_HARDER: Mapping[str, Parameters] = {
    "soft": Parameters(soft_stiffness=2.0),
    "3 g": Parameters(gravity=3.0),
    "more volume": Parameters(soft_volume=1.4, muscle_volume=1.3),
}
FRAMES = Bound("frames", 43, "there are no more", 0)
OTHERS = (1, 2, 3)
"""Seeds of other people, beside the study's own."""
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
    question = "How far is PD's contact from ipctk's barrier, and what does it do on hard frames?"
    cheap = "press, soft, PD"
    columns = (
        Column("overlap_mm", "overlap without contact [mm]"),
        Column("crossings", "pairs that cross with it"),
        Column("moved_mean_mm", "contact moves, mean [mm]"),
        Column("moved_max_mm", "max [mm]"),
        Column("apart_mean_mm", "PD to barrier, mean [mm]"),
        Column("apart_max_mm", "max [mm]"),
        Column("another_minimum_mm", "PD from rest and from the barrier's answer, max [mm]"),
        Column("iterations_pd", "PD's iterations", cost=True),
        Column("iterations_free", "without contact", cost=True),
        Column("iterations_barrier", "Newton's iterations", cost=True),
        Column("times", "time over that without contact", cost=True),
    )
    note = (
        "One energy, PD's, on one mesh: the tets about lips or lids, beyond which the expression holds the face. PD "
        "keeps surfaces apart on its way from rest; scikit-fem minimises the energy with ipctk's barrier from rest on. "
        "PD starts at the barrier's answer too, and the nearer end counts: by prisms shut lids have two minima. "
        f"Means are over vertices that contact moves by more than {MOVES:g} mm. Hard frames are of the whole face, "
        "from rest; their time is that of the processor, prepared, the second of two solves."
    )

    version = 3
    poses: tuple[str, ...] = option(tuple(POSES), f"one of {', '.join(POSES)}; repeat for several", name="--pose")
    frames: int = option(43, "hard frames that PD solves with contact and without, 43 at most", bound=FRAMES)

    def tasks(self) -> Sequence[Task]:
        """List each pose, and the hard frames; InputError for an unknown pose."""
        self.check()
        check_known("pose", self.poses, POSES)
        frames = [Task(name, PD) for name in list(self._hard)[: self.frames]]
        return [*(Task(pose, BOTH) for pose in self.poses), *frames]

    @property
    def _hard(self) -> Mapping[str, tuple[int | None, str, Parameters]]:
        """Hard frames by name: the seed, the expression and p."""
        own = {name: (None, text, Parameters()) for name, text in HARD.items()}
        harder = {
            f"{name}, {how}": (None, HARD[name], parameters)
            for how, parameters in MADE_HARDER.items()
            for name in ("blink, squint", "lower lip raised", "press")
        }
        others = {
            f"{name}, seed {seed}": (seed, HARD[name], Parameters())
            for seed in OTHERS
            for name in ("blink", "both lips raised", "close, jaw open")
        }
        return own | harder | others

    def measure(self, task: Task) -> Values:
        """Compare a pose by both codes, or a hard frame with contact and without."""
        if task.method == PD:
            seed, text, parameters = self._hard[task.case]
            person = self.person(seed=seed)
            return measure_frame(person.face(parameters), person.shape(text))
        person, (text, regions) = self.person(), POSES[task.case]
        head, shape, near = person.head, person.shape(text), _find_around(person.head, regions)

        def scene_at(share: float) -> Scene:
            targets = head.skin.vertices + share * (shape - head.skin.vertices)
            return facial_scene(head, Parameters(), targets, region=near, contact=regions)

        return compare_contact(scene_at(1.0), solve_by_barrier(scene_at))

    def gates(self, rows: Sequence[Row]) -> list[dict]:
        """Check that PD has converged and nothing crosses, that the barrier is solved, and that PD is near it."""
        poses = [row.values for row in rows if row.method == BOTH]
        done = [row.values for row in rows]
        gates = [
            at_most("answers of PD that cross", sum(values["crossings"] > 0 for values in done), 0),
            at_most("answers of PD that have not converged", sum(not values["done"] for values in done), 0),
        ]
        if poses:
            failed = sum(values["reasons"][1] != str(Reason.CONVERGED) for values in poses)
            share = max(values["apart_mean_mm"] / values["moved_mean_mm"] for values in poses)
            gates.append(at_most("poses whose barrier was not solved", failed, 0))
            gates.append(at_most("mean distance of PD's contact to the barrier, of what contact moves", share, 0.05))
        return gates

    def words(self, rows: Sequence[Row]) -> str:
        """Tell how far the codes are apart in each pose."""
        sentences = [
            f"{row.case}: contact moves the skin by {row.values['moved_mean_mm']:.2f} mm on average, PD and the "
            f"barrier are {row.values['apart_mean_mm']:.3f} mm apart"
            + ("." if row.values["done"] else f"; {' and '.join(row.values['reasons'])}.")
            for row in rows
            if row.method == BOTH
        ]
        frames = [row.values for row in rows if row.method == PD]
        if frames:
            touching = [values for values in frames if values["pairs"]] or frames
            left = sum(not values["done"] for values in frames)
            crossing = sum(values["crossings"] > 0 for values in frames)
            sentences.append(
                f"Of {len(frames)} hard frames {sum(values['crossings_free'] > 0 for values in frames)} cross without "
                f"contact; with it {crossing} cross and {left} have not converged. It moves a vertex by "
                f"{max(values['moved_max_mm'] for values in frames):.1f} mm at most, and frames that touch cost "
                f"{np.median([values['times'] for values in touching]):.1f} times those without, in the median."
            )
        return " ".join(sentences)


def measure_frame(face: Face, skin: Floats) -> dict:
    """Solve an expression's skin (n, 3) [mm] by PD with contact and without; `times`: what contact costs, of without.

    crossings: pairs of triangles. Each is solved twice, and the second time counts.
    """
    answers, times = [], []
    for each in (face, face.in_contact()):
        scene = each.expression_scene(skin)
        prepared = prepare(each.neutral_scene())
        prepared.solve(scene, tolerance=TOLERANCE)
        begin = time.process_time()
        answers.append(prepared.solve(scene, tolerance=TOLERANCE))
        times.append(time.process_time() - begin)
    free, touching = answers
    (contact,) = scene.of(terms.Contact)
    moved = distances(free.positions, touching.positions)
    crossings, overlap = TriangleTree(free.positions, contact.triangles).measure_overlap()
    return {
        "done": touching.converged,
        "pairs": int(touching.detail["contact_pairs"]),
        "crossings_free": crossings,
        "overlap_mm": overlap,
        "crossings": len(TriangleTree(touching.positions, contact.triangles).self_crossings()),
        "moved_max_mm": float(moved.max()),
        "iterations_pd": touching.iterations,
        "iterations_free": free.iterations,
        "times": times[1] / times[0],
    }


def solve_by_barrier(scene_at: Callable[[float], Scene]) -> Solution:
    """Solve a scene of a share of its motion by scikit-fem and ipctk, share by share from rest to the whole."""
    prepared, positions = prepare(scene_at(0.0), solver="skfem"), None
    for step in range(1, STEPS):
        positions = prepared.solve(scene_at(step / STEPS), start=positions, tolerance=ON_THE_WAY).positions
    return prepared.solve(scene_at(1.0), start=positions, tolerance=TOLERANCE)


def compare_contact(scene: Scene, by_barrier: Solution) -> dict:
    """Solve a scene by PD with and without its Contact, and compare the barrier's answer with both.

    Figures are over the vertices of the surface in contact. PD starts at rest and at the barrier's answer, and the
    nearer end counts: lids that fold have two minima.
    """
    (contact,) = scene.of(terms.Contact)
    without = replace(scene, terms=tuple(term for term in scene.terms if term is not contact))
    ids = np.unique(contact.triangles)
    free = solve(without, tolerance=TOLERANCE)
    ends = [solve(scene, start=start, tolerance=TOLERANCE) for start in (None, by_barrier.positions)]
    by_pd = min(ends, key=lambda end: distances(by_barrier.positions, end.positions)[ids].mean())
    motion = distances(by_barrier.positions, free.positions)[ids]
    apart = distances(by_barrier.positions, by_pd.positions)[ids]
    counts = motion > MOVES
    return {
        "done": all(solution.converged for solution in (*ends, by_barrier, free)),
        "another_minimum_mm": float(distances(ends[0].positions, ends[1].positions)[ids].max()),
        "reasons": [str(by_pd.reason), str(by_barrier.reason)],
        "overlap_mm": TriangleTree(free.positions, contact.triangles).measure_overlap()[1],
        "crossings": int(by_pd.detail["contact_crossings"]),
        "moved_mean_mm": float(motion[counts].mean()),
        "moved_max_mm": float(motion.max()),
        "apart_mean_mm": float(apart[counts].mean()),
        "apart_max_mm": float(apart.max()),
        "iterations_pd": by_pd.iterations,
        "iterations_free": free.iterations,
        "iterations_barrier": by_barrier.iterations,
    }


def _find_around(head: LayeredHead, regions: Sequence[str]) -> np.ndarray:
    """Mark the wraps' vertices within AROUND edges of some regions, shape (n,)."""
    triangles, inside = head.skin_wrap.triangles, np.any([head.regions[name] for name in regions], axis=0)
    for _ in range(AROUND):
        inside[triangles[inside[triangles].any(axis=1)]] = True
    return inside
