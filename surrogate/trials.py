"""Some people of a corpus, and their frames as trials: static ones, sequences, and those that FEniCSx solved, too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats32
from ..reference.face.facial import PD_ENERGY
from .corpus.face import Heads, KeptFace
from .corpus.folder import Corpus
from .corpus.plan import Split
from .corpus.reading import Faces, Row, Table
from .methods import Method

SIMULATOR = "projective dynamics"
AGAINST = {PD_ENERGY: "against converged elements (P2)", "neo-Hookean": "against FEniCSx, neo-Hookean"}
"""The part of frames whose truth is FEniCSx' answer by a law; see `corpus.references`."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Frames of one face of a corpus to answer: weights (F, 52), their `truth` T - S (F, n, 3) [mm].

    number: of the face among those tested, or of the sequence. part: a name that groups trials. sequence: the corpus'
    row where the frames follow one another. simulated: projective dynamics' T - S, where another truth stands.
    """

    number: int
    face: KeptFace
    weights: Floats32
    truth: Floats32
    part: str = ""
    sequence: Row | None = None
    simulated: Floats32 | None = None


@dataclass(eq=False)
class Player:
    """A rig that gives skins (n, 3) [mm] in their order, whatever the weights."""

    skins: Iterator[np.ndarray]

    def frame(self, weights) -> np.ndarray:
        """Give the next skin."""
        return next(self.skins)


def play(name: str, trial: Trial, corrections: Callable[[], Iterable[np.ndarray]]) -> Method:
    """Make a method of T - S (n, 3) [mm] of a trial's frames, which are made when they are asked for."""

    def bind(face: KeptFace) -> Any:
        return Player(s + correction for s, correction in zip(face.blend(trial.weights), corrections(), strict=True))

    return Method(name, bind)


@dataclass(frozen=True, eq=False)
class CorpusTrials:
    """The people of a corpus' split, or all for None, on whom methods are tested.

    partial: of a corpus that is not complete, the people that are there. heads: who fits their heads; by default the
    corpus' folder says so. What is read raises what `Table` raises.
    """

    folder: Path
    split: Split | None = "test"
    partial: bool = False
    heads: Heads | None = None

    @cached_property
    def faces(self) -> Faces:
        """The faces that are tested."""
        return self._faces(self.split)

    @cached_property
    def training(self) -> Faces:
        """The corpus' training faces."""
        return self._faces("train")

    @cached_property
    def corpus(self) -> Corpus:
        """The corpus itself."""
        return Corpus.open(self.folder)

    def _faces(self, split: Split | None) -> Faces:
        return Faces(self.folder, split, partial=self.partial, heads=self.heads)

    def table(self, name: str, split: Split | None = None) -> Table:
        """Open a table of these people, or of another split."""
        return Table(self.folder, name, split or self.split, partial=self.partial, heads=self.heads)

    def spread(self, count: int) -> list[KeptFace]:
        """Read `count` faces, spread over all."""
        numbers = np.unique(np.linspace(0, len(self.faces) - 1, count).round().astype(int))
        return [self.faces.face(int(number)) for number in numbers]

    def static(self, chosen: Sequence[int] | None = None) -> Iterator[Trial]:
        """Read the static frames of the faces, or of those of some numbers."""
        return static_trials(self.faces, chosen)

    def moving(self) -> Iterator[Trial]:
        """Read the sequences of faces with derivatives. InputError where there is none."""
        table = self.table("sequences")
        number_of = {key: k for k, key in enumerate(map(tuple, self.faces.groups.tolist()))}
        chosen = [(k, number_of[key]) for k, key in enumerate(map(tuple, table.groups.tolist())) if key in number_of]
        if not chosen:
            who = self.split or "whole"
            raise InputError(f"corpus {self.folder}: no sequence of the {who} split is of a face with derivatives")
        for k, face in chosen:
            row = table[k]
            yield Trial(k, self.faces.face(face), row["weights"], row["corrected"].astype(np.float32), sequence=row)

    def by_fenicsx(self) -> Iterator[Trial]:
        """Read the frames that FEniCSx solved, too, as trials by law, whose truth is its answer.

        InputError where no such frame is of a face with derivatives.
        """
        table, statics = self.table("references"), self.table("statics")
        face_of = {key: index for index, key in enumerate(map(tuple, self.faces.groups.tolist()))}
        static_of = {key: index for index, key in enumerate(map(tuple, statics.rows.tolist()))}
        grouped: dict[tuple[str, int], list[tuple[Row, Row]]] = {}
        for row in (table[k] for k in range(len(table))):
            index = static_of.get((int(row["identity"]), int(row["static"])))
            if index is None:
                continue
            static = statics[index]
            face = face_of.get((int(row["identity"]), int(static["group"])))
            if face is not None:
                grouped.setdefault((row["law"].decode(), face), []).append((static, row))
        if not grouped:
            raise InputError(f"corpus {self.folder}: no frame with an answer of FEniCSx has derivatives")
        for (law, face), pairs in grouped.items():
            weights = np.stack([static["weights"] for static, _ in pairs])
            simulated, truth = (
                np.stack([row["corrected"] for row in rows]).astype(np.float32) for rows in zip(*pairs, strict=True)
            )
            yield Trial(face, self.faces.face(face), weights, truth, AGAINST[law], simulated=simulated)


def static_trials(faces: Faces, chosen: Sequence[int] | None = None) -> Iterator[Trial]:
    """Read the static frames of faces, or of those of some numbers."""
    for index in range(len(faces)) if chosen is None else chosen:
        frames = faces.frames(index)
        if len(frames.weights):
            yield Trial(index, faces.face(index), frames.weights, frames.corrected.astype(np.float32))
