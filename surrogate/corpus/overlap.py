"""How far lids and lips overlap in frames of a corpus: as blendshapes draw the wrap, and in the skin that is kept."""

from __future__ import annotations

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.geometry.bvh import TriangleTree
from ...lhm.base.mesh import Floats, Ints
from ...lhm.head.head import LayeredHead
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
    is no frame where nobody fits heads, and where these have no such regions.
    """
    try:
        faces = Faces(corpus.folder, None, partial=True, heads=Heads.from_corpus(corpus.folder))
        with_frames = [k for k, rows in enumerate(faces.frames_of) if len(rows)]
        spread = {int(k) for k in np.linspace(0, len(with_frames) - 1, SAMPLED)} if with_frames else set()
        chosen = [with_frames[k] for k in sorted(spread)]
        rows = [row for k in chosen for row in _measure(faces.face(k), faces, k)]
    except InputError:
        rows = []
    return np.array(rows).reshape(-1, 2)


def _measure(face: KeptFace, faces: Faces, number: int) -> list[list[float]]:
    head, frames = face.live.head, faces.frames(number)
    regions = contact_regions(head)
    if not regions:
        return []
    on_wrap, on_skin = contact_triangles(head, regions), _find_on_skin(head, regions)
    rows = []
    for blended, corrected in zip(face.blend(frames.weights), frames.corrected, strict=True):
        drawn = TriangleTree(head.wrap_targets(blended), on_wrap)
        simulated = TriangleTree(blended + corrected.astype(np.float64), on_skin)
        rows.append([drawn.measure_overlap()[1], simulated.measure_overlap()[1]])
    return rows


def _find_on_skin(head: LayeredHead, regions: tuple[str, ...]) -> Ints:
    """Find the skin's triangles within regions of the wrap, shape (k, 3)."""
    masks = [head.skin_from_wrap @ np.asarray(head.regions[name], dtype=np.float64) > 0.5 for name in regions]
    triangles = head.skin.triangles
    return triangles[np.any(masks, axis=0)[triangles].all(axis=1)]
