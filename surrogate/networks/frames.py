"""Static frames of a corpus in batches, read from its shards as they are drawn; memory does not grow with it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats32, Ints
from ..corpus.reading import Faces

MORE_UNIFORM = "a corpus planned with a smaller `varying`, as varying = 0, has more"
"""Advice where too few frames are under uniform parameters."""
PEOPLE = 32
"""People whose skins and shapes are kept between two batches: 1.4 MB each on the default head."""


@dataclass(frozen=True, eq=False)
class FrameBatch:
    """Frames as arrays: face and person (N,), code (N, c), weights (N, 52), coefficients of STATIC (N, P, 1 + WAVES).

    blended and simulated (N, n, 3) [mm]: the S on which a network's J acts, and the simulator's T. moved (N,) [mm]: how
    far T is on average from blendshapes that are carried along by scaled bones.
    """

    face: Ints
    person: Ints
    codes: Floats32
    weights: Floats32
    coefficients: Floats32
    blended: Floats32
    simulated: Floats32
    moved: Floats32

    def __len__(self) -> int:
        return len(self.face)


class FrameSource:
    """The accepted static frames of faces: with `fields` of all, else under uniform parameters, as the paper has them.

    S are blendshapes carried along by scaled bones, or with `first_order` right to first order by the simulator.
    face (F,): numbers among `faces`; codes (F, c), coefficients (F, P, 1 + WAVES) of STATIC and counts (F,) of frames.
    All else is read when it is asked for. Raises InputError where there is no such frame.
    """

    def __init__(self, faces: Faces, chosen: Ints | None = None, *, fields: bool = False, first_order: bool = False):
        self.faces, self.first_order = faces, first_order
        numbers = range(len(faces)) if chosen is None else map(int, chosen)
        rows = [(k, faces.coefficients(k)) for k in numbers if len(faces.frames_of[k])]
        rows = [(k, coefficients) for k, coefficients in rows if fields or not coefficients[:, 1:].any()]
        if not rows:
            raise InputError(
                f"corpus {faces.folder}: no static frame of it is under uniform parameters; {MORE_UNIFORM}"
            )
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
        simulated, moved = np.empty_like(blended), np.empty(len(picked), dtype=np.float32)
        for k in np.unique(picked):
            of_face = np.flatnonzero(picked == k)
            number = int(self.face[k])
            read, carried = faces.frames(number, frame[of_face]), faces.carried(number)
            skin, shapes = self._neutral(int(faces.groups[number, 0]))
            weights[of_face], corrected = read.weights, read.corrected.astype(np.float32)
            expression = skin + (read.weights @ shapes.reshape(52, -1).astype(np.float32)).reshape(-1, n, 3)
            simulated[of_face] = expression + corrected
            moved[of_face] = np.linalg.norm(corrected - carried, axis=2).mean(axis=1)
            if self.first_order:
                first = faces.derivatives(number)
                blended[of_face] = simulated[of_face] - read.remainder(first.offset, first.responses)
            else:
                blended[of_face] = expression + carried
        person = faces.groups[self.face[picked], 0]
        return FrameBatch(
            picked, person, self.codes[picked], weights, self.coefficients[picked], blended, simulated, moved
        )

    def _read_neutral(self, identity: int) -> tuple[Floats32, np.ndarray]:
        person = self.faces.person(identity)
        return person.skin.vertices.astype(np.float32), np.asarray(person.shapes)
