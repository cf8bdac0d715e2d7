"""Faces of a modal training: which teach and which judge, as they are or mirrored, and what the network is given."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.geometry.mirror import is_symmetric
from ...lhm.base.mesh import Floats, Floats32, Ints
from ...lhm.identities.arkit import MIRRORED
from ..corpus.face import Frames, KeptFace, surface_hash
from ..corpus.reading import Faces
from .features import Features, Inputs
from .layers import EVERY
from .trainer import hold_out_people
from .weights import Weights

LEAST_PEOPLE = 10
LOPSIDED = 0.05
"""Share of a face's shapes by which their mirror images may miss them, for the mirrored face to be one, too."""


@dataclass(frozen=True, eq=False)
class LessonFace:
    """A kept face as it teaches: with p at the vertices, and where `is_mirrored` as its own mirror image."""

    kept: KeptFace
    features: Features
    is_mirrored: bool = False

    @property
    def code(self) -> Floats:
        """The person's code (c,), which a mirrored face shares."""
        return self.kept.code

    @cached_property
    def parameters(self) -> Floats:
        """The p at the vertices, shape (n, P)."""
        values = self.features.at_vertices(self.kept.coefficients)
        return self.features.mirror_parameters(values) if self.is_mirrored else values

    @property
    def offset(self) -> Floats32:
        """T - S at w = 0 [mm], shape (n, 3)."""
        return self._turn(self.kept.offset.astype(np.float32))

    @property
    def carried(self) -> Floats32:
        """How far scaled bones carry the neutral skin [mm], shape (n, 3)."""
        return self._turn(self.kept.carried)

    def shapes_at(self, vertices: Any = EVERY) -> np.ndarray:
        """Return the motion of each of the 52 weights at some vertices [mm], shape (52, v, 3)."""
        return self._turn_shapes(self.kept.shapes, vertices)

    def responses_at(self, vertices: Any = EVERY) -> np.ndarray:
        """The derivatives of T - S by weights at some vertices [mm], shape (52, v, 3)."""
        return self._turn_shapes(self.kept.responses, vertices)

    @property
    def responses(self) -> np.ndarray:
        """The derivatives of T - S by weights [mm], shape (52, n, 3)."""
        return self.responses_at()

    def as_mirrored(self, frames: Frames) -> Frames:
        """Return frames of the kept face as this face shows them."""
        if not self.is_mirrored:
            return frames
        return Frames(frames.weights[:, MIRRORED], self.features.mirror_move(frames.corrected))

    def _turn(self, move: np.ndarray) -> np.ndarray:
        return self.features.mirror_move(move) if self.is_mirrored else move

    def _turn_shapes(self, shapes: np.ndarray, vertices: Any) -> np.ndarray:
        if not self.is_mirrored:
            return np.asarray(shapes[:, vertices])
        return self.features.mirror_shapes(shapes, vertices)


class FaceArrays(NamedTuple):
    """Faces at some vertices, as tables learn from them: arrays of numpy, or torch's tensors.

    codes (b, c), normalised; bones (b, BONES); sizes (b, 2) [mm]: how far a face moves beyond what bones carry, and how
    large its responses are. Local features (b, v, f); effects (b, v, EFFECTS); how far bones carry vertices and how
    far physics moves them beyond (b, v, 3); responses and shapes (b, v, 52, 3), in half precision.
    """

    codes: Any
    bones: Any
    sizes: Any
    local: Any
    effects: Any
    carried: Any
    beyond: Any
    responses: Any
    shapes: Any

    def take(self, rows: Ints, places: Any = None) -> FaceArrays:
        """Take some faces, at some of their vertices."""
        of_faces, at_vertices = self[:3], self[3:]
        picked = (rows,) if places is None else (rows[:, None], places)
        return FaceArrays(*(array[rows] for array in of_faces), *(array[picked] for array in at_vertices))


def read_arrays(faces: Sequence[LessonFace], inputs: Inputs, vertices: Any = EVERY) -> FaceArrays:
    """Read what tables learn from faces at some vertices."""
    features, rows = inputs.features, []
    for face in faces:
        beyond, responses = face.offset - face.carried, face.responses_at(vertices).astype(np.float16)
        fields = beyond, responses.astype(np.float32)
        rows.append((
            inputs.code(face.code).astype(np.float32),
            features.bones(face.parameters),
            np.array([np.linalg.norm(field, axis=-1).mean() for field in fields], dtype=np.float32),
            features.local(face.parameters)[vertices],
            features.effects(face.parameters)[vertices],
            face.carried[vertices],
            beyond[vertices],
            responses.transpose(1, 0, 2),
            face.shapes_at(vertices).astype(np.float16).transpose(1, 0, 2),
        ))  # fmt: skip
    return FaceArrays(*(np.stack(column) for column in zip(*rows, strict=True)))


@dataclass(frozen=True, eq=False)
class LessonFaces:
    """A corpus' faces, divided by people, and how a network is given them.

    training and held (F,) are numbers of its faces; held_out (k,) are the people whose faces are held. `extra_faces`
    are faces of which frames are not asked. `has_mirror`: whether a mirrored face is one, too, and teaches as
    well.
    """

    corpus: Faces
    extra_faces: Faces | None
    inputs: Inputs
    training: Ints
    held: Ints
    held_out: Ints
    has_mirror: bool

    @classmethod
    def divide(
        cls,
        corpus: Faces,
        extra_faces: Faces | None,
        start: Weights | None,
        *,
        validation_share: float,
        rng: np.random.Generator,
    ) -> LessonFaces:
        """Hold out a share of people. Inputs are scaled as those of `start`, where given.

        Raises InputError for fewer than ten people, and more faces of another mesh.
        """
        if extra_faces is not None and surface_hash(extra_faces.mean) != surface_hash(corpus.mean):
            raise InputError("training: the second corpus is of another space or level than the first")
        people = corpus.people
        if len(people) < LEAST_PEOPLE:
            raise InputError(
                f"training: {len(people)} people of {corpus.folder} have derivatives; at least 10 are needed, "
                "`softdeca corpus generate --preset small --people 12 --out FOLDER` makes them"
            )
        held_out = hold_out_people(people, validation_share, rng)
        is_held_out = np.isin(corpus.groups[:, 0], held_out)
        training, held = np.flatnonzero(~is_held_out), np.flatnonzero(is_held_out)
        inputs = Inputs.from_codes(corpus.mean, corpus.codes) if start is None else start.inputs
        has_mirror = _is_mirrored(corpus.face(int(training[0])), inputs.features)
        return cls(corpus, extra_faces, inputs, training, held, held_out, has_mirror)

    @property
    def features(self) -> Features:
        """The features of p."""
        return self.inputs.features

    @property
    def vertex_count(self) -> int:
        """The number of the skin's vertices."""
        return len(self.corpus.mean.vertices)

    @property
    def code_size(self) -> int:
        """Numbers of an identity code, with which a summary begins."""
        return len(self.inputs.code_mean)

    @property
    def count(self) -> int:
        """How many faces teach tables."""
        return len(self.training) + len(self.extra_faces or ())

    def find_framed(self, frames: int) -> Ints:
        """List the training faces with at least so many frames; InputError where there are none."""
        counts = np.array([len(rows) for rows in self.corpus.frames_of])
        if not (framed := self.training[counts[self.training] >= frames]).size:
            raise InputError(f"training: a step draws {frames} frames of a face, and faces have at most {counts.max()}")
        return framed

    def draw_sides(self, faces: Sequence[KeptFace], rng: np.random.Generator) -> list[LessonFace]:
        """Show each face as it is or mirrored, at random."""
        sides = self.has_mirror & (rng.random(len(faces)) < 0.5)
        return [LessonFace(face, self.features, bool(side)) for face, side in zip(faces, sides, strict=True)]

    def faces(self, numbers: Iterable[int]) -> list[KeptFace]:
        """Read faces of the corpus."""
        return [self.corpus.face(int(number)) for number in numbers]

    def read_teaching(self, each: int, vertices: Any = EVERY, *, every: int = 1) -> Iterator[FaceArrays]:
        """Read faces that teach tables, so many at a time, each as it is and, where that is a face, mirrored.

        One of `every` so many.
        """
        numbers = [(self.corpus, number) for number in self.training.tolist()]
        if self.extra_faces is not None:
            numbers += [(self.extra_faces, number) for number in range(len(self.extra_faces))]
        numbers, sides = numbers[::every], (False, True)[: 1 + self.has_mirror]
        for first in range(0, len(numbers), each):
            kept = [source.face(number) for source, number in numbers[first : first + each]]
            shown = [LessonFace(face, self.features, side) for face in kept for side in sides]
            yield read_arrays(shown, self.inputs, vertices)

    def read_held(self, vertices: Any = EVERY) -> FaceArrays:
        """Read the faces of the people that are held out, as they are."""
        return read_arrays([LessonFace(face, self.features) for face in self.faces(self.held)], self.inputs, vertices)


def _is_mirrored(face: KeptFace, features: Features) -> bool:
    """Whether the mirror image of a face is a face of the same person: skin and shapes are symmetric."""
    if features.mirror is None:
        return False
    shapes, skin = np.asarray(face.shapes, dtype=np.float64), face.skin.vertices
    missed = np.linalg.norm(features.mirror_shapes(shapes) - shapes)
    return bool(missed <= LOPSIDED * np.linalg.norm(shapes) and is_symmetric(skin, features.mirror))
