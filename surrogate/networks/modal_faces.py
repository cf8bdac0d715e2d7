"""Faces of a modal training: which teach and which judge, as they are or mirrored, and what the network is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.geometry.mirror import is_symmetric
from ...lhm.base.mesh import Floats, Floats32, Ints
from ...lhm.identities.arkit import MIRRORED
from ..corpus.face import Frames, KeptFace
from ..corpus.reading import Faces
from ..corpus.surface_hash import surface_hash
from .features import Features, Inputs
from .layers import EVERY
from .trainer import hold_out_people, torch
from .weights import Weights

LEAST_PEOPLE = 10
LOPSIDED = 0.05
"""Share of a face's shapes by which their mirror images may miss them, for the mirrored face to be one, too."""


class NeutralMotion(NamedTuple):
    """How far a neutral skin goes under p: p at the vertices (n, P), skin and displacement (n, 3) [mm]."""

    parameters: Floats
    skin: Floats
    displacement: np.ndarray


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
    def skin(self) -> Floats:
        """The neutral skin without p [mm], shape (n, 3)."""
        return self._turn(self.kept.skin.vertices)

    def shapes_at(self, vertices: Any = EVERY) -> Floats32:
        """What the 52 weights add to the skin at some vertices [mm], shape (52, v, 3)."""
        return self._turn_shapes(self.kept.shapes, vertices)

    @property
    def offset(self) -> np.ndarray:
        """T - S at w = 0 [mm], shape (n, 3)."""
        return self._turn(self.kept.offset)

    def responses_at(self, vertices: Any = EVERY) -> Floats32:
        """The derivatives of T - S by weights at some vertices [mm], shape (52, v, 3)."""
        return self._turn_shapes(self.kept.responses, vertices)

    @property
    def responses(self) -> Floats32:
        """The derivatives of T - S by weights [mm], shape (52, n, 3)."""
        return self.responses_at()

    @property
    def settling(self) -> NeutralMotion:
        """How it settles, where a palsy does nothing."""
        displacement = self._turn(self.kept.displacement)
        return NeutralMotion(self.features.without_palsy(self.parameters), self.skin, displacement)

    @property
    def relaxing(self) -> NeutralMotion:
        """How the settled face relaxes among its targets."""
        return NeutralMotion(self.parameters, self.skin, self._turn(self.kept.relaxed))

    def see(self, frames: Frames) -> Frames:
        """Return frames of the kept face as this face shows them."""
        if not self.is_mirrored:
            return frames
        return Frames(frames.weights[:, MIRRORED], self.features.mirror_move(frames.corrected))

    def _turn(self, move: np.ndarray) -> np.ndarray:
        return self.features.mirror_move(move) if self.is_mirrored else move

    def _turn_shapes(self, shapes: np.ndarray, vertices: Any) -> Floats32:
        if not self.is_mirrored:
            return np.asarray(shapes[:, vertices], dtype=np.float32)
        return self.features.mirror_shapes(shapes, vertices).astype(np.float32)


@dataclass(frozen=True, eq=False)
class LessonFaces:
    """A corpus' faces, divided by people, and how a network is given them.

    training and validation are numbers of faces with frames; held_out (k,) are the people of validation. `more`, where
    given, are faces without frames. `has_mirror`: whether a mirrored face is one, too, and teaches as well.
    """

    corpus: Faces
    more: Faces | None
    inputs: Inputs
    training: Ints
    validation: Ints
    held_out: Ints
    has_mirror: bool

    @classmethod
    def divide(
        cls,
        corpus: Faces,
        more: Faces | None,
        start: Weights | None,
        *,
        validation_share: float,
        frames: int,
        rng: np.random.Generator,
    ) -> LessonFaces:
        """Hold out a share of people; faces of fewer than `frames` frames are left out.

        Inputs are scaled as those of `start`, where given. Raises InputError for fewer than ten people, more faces of
        another mesh, and faces that all have too few frames.
        """
        if more is not None and surface_hash(more.mean) != surface_hash(corpus.mean):
            raise InputError("training: the faces without frames are of another space or level than the corpus")
        people = np.unique(corpus.groups[:, 0])
        if len(people) < LEAST_PEOPLE:
            raise InputError(
                f"training: {len(people)} people of {corpus.folder} have derivatives; at least 10 are needed, "
                "`softdeca corpus generate --preset small --people 12 --out FOLDER` makes them"
            )
        held_out = hold_out_people(people, validation_share, rng)
        is_held_out = np.isin(corpus.groups[:, 0], held_out)
        has_frames = np.array([len(rows) >= frames for rows in corpus.frames_of])
        training, validation = np.flatnonzero(~is_held_out & has_frames), np.flatnonzero(is_held_out & has_frames)
        if not len(training) or not len(validation):
            most = max(map(len, corpus.frames_of), default=0)
            raise InputError(f"training: a step draws {frames} frames of a face, and faces have at most {most}")
        inputs = Inputs.from_faces(corpus) if start is None else Inputs.from_weights(start)
        has_mirror = _is_mirrored(corpus.face(int(training[0])), inputs.features)
        return cls(corpus, more, inputs, training, validation, held_out, has_mirror)

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

    def draw_sides(self, faces: Sequence[KeptFace], rng: np.random.Generator) -> list[LessonFace]:
        """Show each face as it is or mirrored, at random."""
        sides = self.has_mirror & (rng.random(len(faces)) < 0.5)
        return [LessonFace(face, self.features, bool(side)) for face, side in zip(faces, sides, strict=True)]

    def both_sides(self, face: KeptFace) -> list[LessonFace]:
        """Show a face as it is and, where that is a face, mirrored."""
        return [LessonFace(face, self.features, side) for side in (False, True)[: 1 + self.has_mirror]]

    def faces(self, numbers: Sequence[int] | Ints) -> list[KeptFace]:
        """Read faces of the corpus."""
        return [self.corpus.face(int(number)) for number in numbers]

    def more_faces(self, numbers: Sequence[int] | Ints) -> list[KeptFace]:
        """Read faces of `more`; none where there are none."""
        return [] if self.more is None else [self.more.face(int(number)) for number in numbers]


def _is_mirrored(face: KeptFace, features: Features) -> bool:
    """Whether the mirror image of a face is a face of the same person: skin and shapes are symmetric."""
    if features.mirror is None:
        return False
    shapes, skin = np.asarray(face.shapes, dtype=np.float64), face.skin.vertices
    missed = np.linalg.norm(features.mirror_shapes(shapes) - shapes)
    return bool(missed <= LOPSIDED * np.linalg.norm(shapes) and is_symmetric(skin, features.mirror))


class FaceInputs(NamedTuple):
    """Tensors of b faces at v vertices: `local` (b, v, f), `summary` (b, 1, s), and that of nothing moved."""

    local: torch.Tensor
    summary: torch.Tensor
    unmoved: torch.Tensor


@dataclass(frozen=True, eq=False)
class FaceTensors:
    """Makes tensors of faces on a device, as the network takes them."""

    inputs: Inputs
    device: torch.device | str = "cpu"
    dtype: type = np.float32

    def stack(self, rows) -> torch.Tensor:
        """Stack arrays of equal shape."""
        return torch.from_numpy(np.stack(rows).astype(self.dtype)).to(self.device)

    def inputs_of(self, codes: Sequence[Floats], parameters: Sequence[Floats], vertices) -> FaceInputs:
        """Return what the network is given of faces with codes (c,) and p at the vertices (n, P), at some vertices."""
        features = self.inputs.features
        local = [features.local(values)[vertices] for values in parameters]
        unmoved = [features.unmoved(values) for values in parameters]
        moved_summary, unmoved_summary = (
            [self.inputs.summary(code, values)[None] for code, values in zip(codes, at_vertices, strict=True)]
            for at_vertices in (parameters, unmoved)
        )
        return FaceInputs(self.stack(local), self.stack(moved_summary), self.stack(unmoved_summary))

    def effects_of(self, motions: Sequence[NeutralMotion], vertices) -> torch.Tensor:
        """Return effects at some vertices, shape (b, v, EFFECTS)."""
        effects = self.inputs.features.effects
        return self.stack([effects(motion.parameters, motion.skin)[vertices] for motion in motions])
