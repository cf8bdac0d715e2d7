"""Faces of a corpus to learn from: each a person under one parameter set, with derivatives and static frames."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32, Ints, Surface
from ..corpus.mixture import NAMES
from ..corpus.plan import Split
from ..corpus.reading import Table
from ..surface_hash import surface_hash
from .features import STATIC, Features, normalised_code
from .weights import ModalWeights

_COLUMNS = [NAMES.index(name) for name in STATIC]


def static_of(coefficients: Floats) -> Floats:
    """The rows of STATIC of all parameters' coefficients."""
    return coefficients[_COLUMNS]


@dataclass(frozen=True, eq=False)
class Face:
    """code (c,), coefficients of STATIC (P, 1 + WAVES), offset (n, 3) and responses (52, n, 3) of T - S [mm].

    shapes (52, n, 3) [mm]: what the weights add to the person's skin.
    settled (n, 3) [mm]: the part of the offset by which p moved the neutral skin, before targets hold it there.
    skin (n, 3) [mm]: the person's neutral skin without p.
    """

    identity: int
    kind: str
    code: Floats
    coefficients: Floats
    settled: np.ndarray
    offset: np.ndarray
    responses: np.ndarray
    shapes: np.ndarray
    skin: Floats

    @property
    def relaxed(self) -> Floats32:
        """The rest of the offset [mm], shape (n, 3): where the settled face comes to rest among its targets."""
        return self.offset.astype(np.float32) - self.settled


@dataclass(frozen=True, eq=False)
class Frames:
    """Static frames of a face: weights (F, 52), and T - S (F, n, 3) [mm]."""

    weights: Floats32
    corrected: np.ndarray

    def remainder(self, face: Face) -> Floats32:
        """What the linearised face leaves of T - S, shape (F, n, 3)."""
        linear = np.tensordot(self.weights, face.responses.astype(np.float32), axes=1)
        return self.corrected.astype(np.float32) - face.offset.astype(np.float32) - linear


class Faces:
    """The faces of a split of a corpus, or of both, that have derivatives; read as they are asked for.

    `partial`, `share` and what is raised: as of `reading.Table`.
    """

    def __init__(self, folder: str | PathLike[str], split: Split | None, *, partial: bool = False, share: float = 1.0):
        self._responses = Table(folder, "responses", split, partial=partial, share=share)
        self._statics = Table(folder, "statics", split, partial=partial, share=share)
        self.groups = self._responses.groups
        rows: dict[tuple[int, int], list[int]] = {}
        for row, (identity, group) in enumerate(self._statics.groups.tolist()):
            rows.setdefault((identity, group), []).append(row)
        self.frames_of: list[Ints] = [
            np.array(rows.get(key, []), dtype=np.int64) for key in map(tuple, self.groups.tolist())
        ]

    def __len__(self) -> int:
        return len(self.groups)

    @property
    def mean(self) -> Surface:
        """The mean skin of the space [mm]."""
        return self._responses.template.mean

    @property
    def space(self) -> str:
        """The name of the people's space."""
        return self._responses.people

    def check_mesh(self, weights: ModalWeights) -> None:
        """Raise InputError for weights of another mean skin."""
        if weights.template != surface_hash(self.mean):
            raise InputError(
                f"weights: of a mean skin of {len(weights.mean.vertices)} vertices, not of the corpus' space and level"
            )

    def code(self, index: int) -> Floats:
        """The code (c,) of a face's person."""
        return np.asarray(self._responses.described(index)["code"], dtype=np.float64)

    def coefficients(self, index: int) -> Floats:
        """A face's coefficients of STATIC (P, 1 + WAVES)."""
        return static_of(self._responses.described(index)["coefficients"])

    def face(self, index: int) -> Face:
        """One face."""
        row = self._responses[index]
        return Face(
            identity=int(row["identity"]),
            kind=row["kind"].decode(),
            code=np.asarray(row["code"], dtype=np.float64),
            coefficients=static_of(row["coefficients"]),
            settled=self._responses.settled(*self.groups[index]),
            offset=row["offset"],
            responses=row["expressions"],
            shapes=self._responses.shapes(int(row["identity"])),
            skin=self._responses.skin(int(row["identity"])).vertices,
        )

    def skin(self, identity: int) -> Surface:
        """A person's neutral skin [mm]."""
        return self._responses.skin(identity)

    @property
    def personal(self) -> bool:
        """Whether each person has shapes of their own."""
        return self._responses.template.shapes is None

    def moved(self, index: int) -> list[float]:
        """By how much simulation moves the face in each of a face's static frames: 95 % of |T - S| [mm]."""
        return [float(self._statics.small(int(row), "moved")[1]) for row in self.frames_of[index]]

    def frames(self, index: int, chosen: Ints | None = None) -> Frames:
        """A face's accepted static frames, or those of the given numbers."""
        rows = self.frames_of[index] if chosen is None else self.frames_of[index][chosen]
        found = [self._statics[int(row)] for row in rows]
        n = len(self.mean.vertices)
        return Frames(
            np.array([row["weights"] for row in found], dtype=np.float32).reshape(-1, 52),
            np.array([row["corrected"] for row in found]).reshape(-1, n, 3),
        )


@dataclass(frozen=True, eq=False)
class Neutral:
    """A settled neutral face: code (c,), and coefficients, settled (n, 3) and skin (n, 3) [mm] as of `Face`."""

    code: Floats
    coefficients: Floats
    settled: np.ndarray
    skin: Floats


class Neutrals:
    """The settled neutral faces of a split of a corpus; read as they are asked for. Otherwise like `Faces`."""

    def __init__(self, folder: str | PathLike[str], split: Split | None, *, partial: bool = False, share: float = 1.0):
        self._table = Table(folder, "groups", split, partial=partial, share=share)

    def __len__(self) -> int:
        return len(self._table)

    @property
    def mean(self) -> Surface:
        """The mean skin of the space [mm]."""
        return self._table.template.mean

    def face(self, index: int) -> Neutral:
        """One of them."""
        row = self._table[index]
        skin = self._table.skin(int(row["identity"])).vertices
        code = np.asarray(row["code"], dtype=np.float64)
        return Neutral(code, static_of(row["coefficients"]), row["settled"], skin)


@dataclass(frozen=True, eq=False)
class Inputs:
    """Features of faces, for a network: `code_mean` and `code_scale` (c,) normalise codes."""

    features: Features
    code_mean: Floats
    code_scale: Floats

    @classmethod
    def of(cls, faces: Faces) -> Inputs:
        """From the codes of all faces."""
        codes = np.array([faces.code(k) for k in range(len(faces))])
        people = np.unique(faces.groups[:, 0], return_index=True)[1]
        return cls(Features(faces.mean), codes[people].mean(axis=0), np.maximum(codes[people].std(axis=0), 1e-6))

    @classmethod
    def as_of(cls, weights: ModalWeights) -> Inputs:
        """As trained weights have them."""
        return cls(Features(weights.mean), weights.code_mean, weights.code_scale)

    def code(self, code: Floats) -> Floats:
        """See `normalised_code`."""
        return normalised_code(code, self.code_mean, self.code_scale)

    def summary(self, code: Floats, at_vertices: Floats) -> Floats32:
        """See `Features.summary`."""
        return self.features.summary(self.code(code), at_vertices)

    def summary_of(self, face: Face | Neutral) -> Floats32:
        """The summary of a face of a corpus."""
        return self.summary(face.code, self.features.at_vertices(face.coefficients))
