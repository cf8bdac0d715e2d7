"""Faces of a modal training: which teach and which judge, what the network is given of them, and how they move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Ints
from ..corpus.face import KeptFace
from ..corpus.reading import Faces
from ..corpus.surface_hash import surface_hash
from .features import Features, Inputs
from .trainer import hold_out_people, torch
from .weights import Weights

LEAST_PEOPLE = 10


@dataclass(frozen=True, eq=False)
class LessonFaces:
    """A corpus' faces, divided by people, and how a network is given them.

    training and validation are numbers of faces; held_out (k,) are the people of validation. neutrals, where given,
    are more faces of which only the settled neutral is known.
    """

    corpus: Faces
    neutrals: Faces | None
    inputs: Inputs
    training: Ints
    validation: Ints
    held_out: Ints

    @classmethod
    def divide(
        cls,
        corpus: Faces,
        neutrals: Faces | None,
        start: Weights | None,
        *,
        validation_share: float,
        frames: int,
        rng: np.random.Generator,
    ) -> LessonFaces:
        """Hold out a share of people; faces of fewer than `frames` frames are left out.

        Inputs are scaled as those of `start`, where given. Raises InputError for fewer than ten people, neutrals of
        another mesh, and faces that all have too few frames.
        """
        if neutrals is not None and surface_hash(neutrals.mean) != surface_hash(corpus.mean):
            raise InputError("training: the neutral faces are of another space or level than the corpus")
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
        return cls(corpus, neutrals, inputs, training, validation, held_out)

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

    def faces(self, numbers: Sequence[int] | Ints) -> list[KeptFace]:
        """Read faces of the corpus."""
        return [self.corpus.face(int(number)) for number in numbers]

    def neutral_faces(self, numbers: Sequence[int] | Ints) -> list[KeptFace]:
        """Read faces of `neutrals`; none where there are none."""
        return [] if self.neutrals is None else [self.neutrals.face(int(number)) for number in numbers]


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

    def inputs_of(self, faces: Sequence[KeptFace], parameters: Sequence[Floats], vertices) -> FaceInputs:
        """Return what the network is given of faces, under p at the vertices (n, P) each, at some vertices."""
        features = self.inputs.features
        local = [features.local(values)[vertices] for values in parameters]
        unmoved = [features.unmoved(values) for values in parameters]
        moved_summary, unmoved_summary = (
            [self.inputs.summary(face.code, values)[None] for face, values in zip(faces, at_vertices, strict=True)]
            for at_vertices in (parameters, unmoved)
        )
        return FaceInputs(self.stack(local), self.stack(moved_summary), self.stack(unmoved_summary))

    def effects_of(self, parameters: Sequence[Floats], skins: Sequence[Floats], vertices) -> torch.Tensor:
        """Return effects at some vertices, shape (b, v, EFFECTS)."""
        pairs = zip(parameters, skins, strict=True)
        return self.stack([self.inputs.features.effects(values, skin)[vertices] for values, skin in pairs])


class NeutralMotion(NamedTuple):
    """How far a neutral skin goes under p: p at the vertices (n, P), skin and displacement (n, 3) [mm]."""

    parameters: Floats
    skin: Floats
    displacement: np.ndarray


def settling(face: KeptFace, features: Features, *, mirrored: bool = False) -> NeutralMotion:
    """Return how a face settles, where a palsy does nothing; or its mirror image."""
    parameters = features.without_palsy(features.at_vertices(face.coefficients))
    if not mirrored:
        return NeutralMotion(parameters, face.skin.vertices, face.displacement)
    mirror = features.mirror_move
    return NeutralMotion(features.mirror_parameters(parameters), mirror(face.skin.vertices), mirror(face.displacement))


def relaxing(face: KeptFace, features: Features) -> NeutralMotion:
    """Return how a settled face relaxes among its targets."""
    return NeutralMotion(features.at_vertices(face.coefficients), face.skin.vertices, face.relaxed)
