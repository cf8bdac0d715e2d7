"""How far lids and lips overlap in frames of a corpus: as blendshapes draw the wrap, and in the skin that is kept."""

from __future__ import annotations

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.geometry.bvh import TriangleTree
from ...lhm.base.mesh import Floats
from ...reference.face.facial import contact_regions, contact_triangles
from .face import KeptFace
from .folder import Corpus
from .heads import Heads
from .reading import Faces

SAMPLED = 12
"""Faces, for each of which a head is fitted: half a second on the default head."""


def sample_overlaps(corpus: Corpus) -> Floats:
    """Measure overlaps [mm], shape (k, 2), over the frames of some faces that are spread over a corpus.

    Of the skin wrap as blendshapes draw it, and of the simulated skin, which is finer: the longest shift that two
    crossing triangles of lids and lips need to be parted. What the simulated wrap does is in `Statics.crossings`. There
    is no frame where nobody fits heads, these have no such regions, or no face has derivatives.
    """
    heads = Heads.from_corpus(corpus.folder)
    try:
        _ = heads.people
        faces = Faces(corpus.folder, None, partial=True, heads=heads)
    except InputError:
        return np.zeros((0, 2))
    chosen = faces.spread(SAMPLED) if corpus.plan.frames else []
    return np.array([row for k in chosen for row in _measure(faces.face(k), faces, k)]).reshape(-1, 2)


def _measure(face: KeptFace, faces: Faces, number: int) -> list[list[float]]:
    head, frames = face.live.head, faces.frames(number)
    regions = contact_regions(head)
    if not regions:
        return []
    triangles, touching = head.skin.triangles, head.on_skin(regions)
    on_wrap, on_skin = contact_triangles(head, regions), triangles[touching[triangles].all(axis=1)]
    rows = []
    for blended, corrected in zip(face.blend(frames.weights), frames.corrected, strict=True):
        drawn = TriangleTree(head.wrap_targets(blended), on_wrap)
        simulated = TriangleTree(blended + corrected.astype(np.float64), on_skin)
        rows.append([drawn.measure_overlap()[1], simulated.measure_overlap()[1]])
    return rows
