"""Static frames of a corpus in batches, read from its shards as they are drawn; memory does not grow with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats32, Ints
from ..corpus.reading import Faces

PEOPLE = 32
"""People whose skins and shapes are kept between two batches: 1.4 MB each on the default head."""


@dataclass(frozen=True, eq=False)
class FrameBatch:
    """Frames as arrays: face and person (N,), code (N, c), weights (N, 52), coefficients of STATIC (N, P, 1 + WAVES).

    blended and simulated (N, n, 3) [mm]: the linear blendshapes' S, carried along by scaled bones, and the simulator's
    T.
    """

    face: Ints
    person: Ints
    codes: Floats32
    weights: Floats32
    coefficients: Floats32
    blended: Floats32
    simulated: Floats32

    def __len__(self) -> int:
        return len(self.face)


class FrameSource:
    """The accepted static frames of faces: with `fields` of all, else under uniform parameters, as the paper has them.

    face (F,): numbers among `faces`; codes (F, c), coefficients (F, P, 1 + WAVES) of STATIC and counts (F,) of frames.
    All else is read when it is asked for. Raises InputError where there is no such frame.
    """

    def __init__(self, faces: Faces, chosen: Ints | None = None, *, fields: bool = False):
        self.faces = faces
        numbers = range(len(faces)) if chosen is None else map(int, chosen)
        rows = [(k, faces.coefficients(k)) for k in numbers if len(faces.frames_of[k])]
        rows = [(k, coefficients) for k, coefficients in rows if fields or not coefficients[:, 1:].any()]
        if not rows:
            raise InputError(f"corpus {faces.folder}: no static frame of it is under uniform parameters")
        self.face = np.array([k for k, _ in rows])
        self.coefficients = np.array([coefficients for _, coefficients in rows], dtype=np.float32)
        self.codes = np.array([faces.code(k) for k in self.face], dtype=np.float32)
        self.counts = np.array([len(faces.frames_of[k]) for k in self.face])
        self._neutral = lru_cache(maxsize=PEOPLE)(self._read_neutral)

    def __len__(self) -> int:
        return int(self.counts.sum())

    @property
    def people(self) -> Ints:
        """Numbers of the people that have frames."""
        return np.unique(self.faces.groups[self.face, 0])

    def draw(self, faces: int, frames: int, rng: np.random.Generator) -> FrameBatch:
        """Draw `frames` frames of each of `faces` faces; some twice where there are fewer."""
        picked = rng.choice(len(self.face), size=faces, replace=faces > len(self.face))
        rows = [rng.choice(self.counts[k], size=frames, replace=frames > self.counts[k]) for k in picked]
        return self.read(np.repeat(picked, frames), np.concatenate(rows))

    def sample(self, most: int, rng: np.random.Generator) -> FrameBatch:
        """Draw at most so many frames, each once; all in their order where there are no more."""
        face = np.repeat(np.arange(len(self.face)), self.counts)
        frame = np.concatenate([np.arange(count) for count in self.counts])
        kept = np.sort(rng.permutation(len(face))[:most])
        return self.read(face[kept], frame[kept])

    def read(self, picked: Ints, frame: Ints) -> FrameBatch:
        """Read frames by the number of their face here and their number there, both (N,)."""
        faces, n = self.faces, len(self.faces.mean.vertices)
        weights = np.empty((len(picked), 52), dtype=np.float32)
        blended = np.empty((len(picked), n, 3), dtype=np.float32)
        simulated = np.empty_like(blended)
        for k in np.unique(picked):
            of_face = np.flatnonzero(picked == k)
            read = faces.frames(int(self.face[k]), frame[of_face])
            skin, shapes = self._neutral(int(faces.groups[self.face[k], 0]))
            weights[of_face] = read.weights
            moved = read.weights @ shapes.reshape(52, -1).astype(np.float32)
            expression = skin + moved.reshape(-1, n, 3)
            blended[of_face] = expression + faces.carried(int(self.face[k]))
            simulated[of_face] = expression + read.corrected.astype(np.float32)
        person = faces.groups[self.face[picked], 0]
        return FrameBatch(picked, person, self.codes[picked], weights, self.coefficients[picked], blended, simulated)

    def _read_neutral(self, identity: int) -> tuple[Floats32, np.ndarray]:
        person = self.faces.person(identity)
        return person.skin.vertices.astype(np.float32), np.asarray(person.shapes)
