"""Frames of a corpus simulated again, to see that they come out as they are kept."""

from __future__ import annotations

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.geometry.bvh import TriangleTree
from ...lhm.base.mesh import Floats
from ...lhm.base.progress import OnProgress, silent
from ...lhm.head.head import LayeredHead
from ...reference.face.facial import contact_regions, contact_triangles
from .face import Heads
from .folder import Corpus
from .plan import IDENTITY
from .reading import Faces
from .shard import ACCEPTED
from .simulator import describe_answer, make_face, prepare_face, solve_frame

AGAIN = 3
"""Frames, some five seconds each on the default head."""
SAME = 0.01
"""[mm] Largest difference between machines, with the rounding of 16 bits."""


def simulate_again(corpus: Corpus, heads: Heads | None = None, on_progress: OnProgress = silent) -> int:
    """Simulate AGAIN frames of people spread over a corpus, and return how many.

    There are 0 where a corpus has no frames, and where nobody fits the people's heads; by default the folder says who
    does. Of a face the frame is taken that moves its skin farthest from blendshapes. Raises InputError for one that
    comes out otherwise than it is kept, and for lids or lips that cross though the plan keeps them apart.
    """
    heads = corpus.heads() if heads is None else heads
    try:
        people = heads.people
    except InputError:
        return 0
    if not corpus.plan.frames:
        return 0
    faces = Faces(corpus.folder, None, heads=heads)
    chosen = faces.spread(AGAIN)
    for number, k in enumerate(chosen):
        on_progress("frames simulated again", number / len(chosen))
        kept, frames = faces.face(k), faces.frames(k)
        row = int(np.argmax(np.abs(frames.corrected.astype(np.float32)).max(axis=(1, 2))))
        where = f"{corpus.folder}: person {kept.identity}, a frame of face {k}"
        # As it was drawn: the kept person is rounded to 16 bits.
        person = people.person(corpus.plan.rng(IDENTITY, kept.identity))
        face = make_face(
            people, person, people.head(person), kept.parameters, contact=corpus.plan.contact, cells=corpus.plan.cells
        )
        prepare_face(face)
        solution = solve_frame(corpus.plan, face, frames.weights[row])
        answer = describe_answer(corpus.plan, face, frames.weights[row], solution)
        off = np.abs(answer.corrected.astype(np.float32) - frames.corrected[row].astype(np.float32)).max()
        if answer.status != ACCEPTED or off > SAME:
            raise InputError(f"{where}: simulated again it is {answer.status}, and {off:.3f} mm from what is kept")
        if corpus.plan.contact and (crossing := count_crossings(face.head, solution.positions)):
            raise InputError(f"{where}: {crossing} pairs of triangles of lids or lips cross in spite of contact")
    return len(chosen)


def count_crossings(head: LayeredHead, positions: Floats) -> int:
    """Count the pairs of triangles of lids and lips that cross in a solution's positions (N, 3) [mm]."""
    regions = contact_regions(head)
    return len(TriangleTree(positions, contact_triangles(head, regions)).self_crossings()) if regions else 0
