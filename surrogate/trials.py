"""Some people of a corpus, and their frames as trials: static ones, sequences, and those that FEniCSx solved, too."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats32
from .corpus.face import Heads, KeptFace
from .corpus.folder import Corpus
from .corpus.plan import Split
from .corpus.reading import Faces, Table
from .corpus.shard import FEM_LAWS
from .evaluate import Answers, Contender, Trial

SIMULATOR = "projective dynamics"
AGAINST = {law: f"against FEniCSx, {law}" for law in FEM_LAWS}
"""The part of frames whose truth is FEniCSx' answer by a law."""
DYNAMIC = "dynamic"


@dataclass(frozen=True, eq=False)
class ReferenceFrame:
    """A frame with an answer of FEniCSx: weights (52,), and T - S (n, 3) [mm] `simulated` by PD and of FEniCSx' `law`.

    face: the number of its face in the corpus.
    """

    law: str
    face: int
    weights: Floats32
    simulated: Floats32
    fenicsx: Floats32


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

    def moving(self, *, only_differentiated: bool = True) -> Iterator[Trial]:
        """Read the sequences; by default only those of faces with derivatives. InputError where there is none."""
        table = self.table("sequences")
        keys = list(map(tuple, table.groups.tolist()))
        number_of = {key: k for k, key in enumerate(map(tuple, self.faces.groups.tolist()))}
        chosen = [k for k, key in enumerate(keys) if key in number_of or not only_differentiated]
        if not chosen:
            who = self.split or "whole"
            raise InputError(f"corpus {self.folder}: no sequence of the {who} split is of a face with derivatives")
        for k in chosen:
            row, face = table[k], self.faces.face(number_of[keys[k]]) if only_differentiated else table.face(k)
            yield Trial(face, row["weights"], row["corrected"].astype(np.float32), DYNAMIC, row)

    def read_references(self) -> Iterator[ReferenceFrame]:
        """Read the frames of the faces that FEniCSx solved, too, one after another."""
        table, statics = self.table("references"), self.table("statics")
        face_of = {key: index for index, key in enumerate(map(tuple, self.faces.groups.tolist()))}
        static_of = {key: index for index, key in enumerate(map(tuple, statics.rows.tolist()))}
        for row in (table[k] for k in range(len(table))):
            index = static_of.get((int(row["identity"]), int(row["static"])))
            if index is None:
                continue
            static = statics[index]
            face = face_of.get((int(row["identity"]), int(static["group"])))
            if face is not None:
                simulated, truth = (source["corrected"].astype(np.float32) for source in (static, row))
                yield ReferenceFrame(row["law"].decode(), face, static["weights"], simulated, truth)

    def by_fenicsx(self) -> Iterator[Trial]:
        """Read these frames as trials by law, whose truth is FEniCSx' answer, and which SIMULATED answers.

        InputError where no frame with references has derivatives.
        """
        grouped: dict[tuple[str, int], list[ReferenceFrame]] = {}
        for frame in self.read_references():
            grouped.setdefault((frame.law, frame.face), []).append(frame)
        if not grouped:
            raise InputError(f"corpus {self.folder}: no frame with an answer of FEniCSx has derivatives")
        for (law, index), frames in grouped.items():
            weights, truth = np.stack([f.weights for f in frames]), np.stack([f.fenicsx for f in frames])
            known = {SIMULATOR: np.stack([frame.simulated for frame in frames])}
            yield Trial(self.faces.face(index), weights, truth, AGAINST[law], known=known)


SIMULATED = Contender(SIMULATOR, lambda trial: Answers(trial.known[SIMULATOR]), "simulator")
"""Projective dynamics' own answers, which trials of FEniCSx have."""


def static_trials(faces: Faces, chosen: Sequence[int] | None = None) -> Iterator[Trial]:
    """Read the static frames of faces, or of those of some numbers."""
    for index in range(len(faces)) if chosen is None else chosen:
        frames = faces.frames(index)
        if len(frames.weights):
            yield Trial(faces.face(index), frames.weights, frames.corrected.astype(np.float32))
