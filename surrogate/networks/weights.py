"""The weights of a trained network as one safetensors file: numbers only, so that reading it runs no code.

The file has a version, and a checksum over all its bytes; a reader trusts it after these.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load, save

from ...lhm.base.errors import InputError, quote
from ...lhm.base.files.atomic import UNSEALED, is_sealed, seal, write_whole
from ...lhm.base.files.text import parse_json, read_bytes
from ...lhm.base.limits import WEIGHTS_BYTES
from ...lhm.base.mesh import Floats, Surface
from ...reference.face.tissue import CellKind
from ..corpus.face import surface_hash
from ..corpus.mixture import STATIC
from ..rigs.inertia import Looseness
from .face_wise import FaceWise
from .features import Features, Inputs
from .gradients import GradientForm
from .hypernetwork import Hypernetwork, PrintedHypernetwork
from .recurrence import LearnedRecurrence
from .softsmpl import SoftSMPL

FORMAT = 8
"""Format version. Raise it when layout or meaning changes; others are refused."""
MODAL = "modal"
"""The kind of the network that is no form of deformation gradients."""
FORMS: Mapping[str, GradientForm] = {
    form.kind: form for form in (Hypernetwork(), PrintedHypernetwork(), SoftSMPL(), FaceWise())
}
"""The forms of networks of deformation gradients, by kind."""


def has_tables(kind: str) -> bool:
    """Whether a network of a kind has an offset and responses, which the simulator's can replace."""
    return kind == MODAL or FORMS[kind].has_tables


@dataclass(frozen=True)
class TrainingNote:
    """A record of weights' training: people, faces (each under one p), frames, neutrals, steps, options, curve.

    seen: lowest and highest value of each parameter that it saw, mapped to [-1, 1]. held: numbers of the people that
    were held out for the curve, besides `people`. before: the same of the weights that the training began with, if it
    did. cells: of the simulations that it learned.
    """

    people: int
    faces: int
    frames: int
    neutrals: int
    steps: int
    config: Mapping[str, Any]
    curve: tuple[Mapping[str, float], ...]
    seen: Mapping[str, tuple[float, float]]
    held: tuple[int, ...] = ()
    before: Mapping[str, Any] | None = None
    cells: CellKind = "tets"

    @property
    def trainings(self) -> tuple[TrainingNote, ...]:
        """List all that was trained, from the last one back."""
        return (self,) if self.before is None else (self, *TrainingNote(**self.before).trainings)

    @property
    def seconds(self) -> float:
        """Seconds of this training and of all before it."""
        return sum(float(note.curve[-1]["seconds"]) for note in self.trainings)

    @property
    def all_faces(self) -> int:
        """How many faces this training learned from, with frames or without."""
        return self.faces + self.neutrals


def join_people(start: Weights | None, *groups: frozenset[str]) -> frozenset[str]:
    """Join the people of a training and of the weights that it began with; none where nobody knows the latter."""
    if start is not None and not start.people:
        return frozenset()
    return frozenset().union(*groups, () if start is None else start.people)


@dataclass(frozen=True, eq=False)
class Weights:
    """Arrays of a network by name, and the mean skin [mm] they belong to; code_mean and code_scale (c,).

    kind: MODAL, or one of FORMS. looseness: what dynamic frames need besides; None where nobody could fit heads to the
    people. recurrence: learned coefficients of Eq. 21, which take its place. people: names of all that it learned from
    (`name_person`), those of weights that it began with among them; empty where they are unknown.
    """

    kind: str
    space: str
    mean: Surface
    code_mean: Floats
    code_scale: Floats
    network: Mapping[str, np.ndarray]
    note: TrainingNote
    looseness: Looseness | None = None
    recurrence: LearnedRecurrence | None = None
    people: frozenset[str] = frozenset()

    @cached_property
    def inputs(self) -> Inputs:
        """Features of faces, normalised as in training."""
        return Inputs(Features(self.mean), self.code_mean, self.code_scale)

    @property
    def template(self) -> str:
        """The hash of the mean skin."""
        return surface_hash(self.mean)

    def check_mesh(self, mean: Surface) -> None:
        """Raise InputError for faces over another mean skin."""
        if self.template != surface_hash(mean):
            raise InputError(
                f"weights: of a mean skin of {len(self.mean.vertices)} vertices, not of the corpus' space and level"
            )

    def check_unseen(self, people: frozenset[str], whose: str) -> None:
        """Raise InputError where some people, by their names, are among those that it learned from."""
        if seen := people & self.people:
            raise InputError(
                f"{whose}: the weights learned from {len(seen)} of its {len(people)} people that are tested; a corpus "
                "of another seed has others"
            )

    def save(self, path: str | PathLike[str]) -> None:
        """Write one .safetensors file; `path` is whole or as it was.

        Modes and matrices of the network in float16, which rounds an answer of 10 mm by some thousandths; the
        other tables in bytes (see `tables`).
        """
        about = {
            "format": FORMAT,
            "kind": self.kind,
            "space": self.space,
            "template": self.template,
            "parameters": STATIC,
            "note": asdict(self.note),
            "people": sorted(self.people),
            "checksum": UNSEALED,
        }
        arrays: dict[str, np.ndarray] = {
            f"network.{name}": np.ascontiguousarray(value, dtype=_choose_type(name, value))
            for name, value in self.network.items()
        }
        arrays |= {
            "mean.vertices": np.ascontiguousarray(self.mean.vertices),
            "mean.triangles": np.ascontiguousarray(self.mean.triangles, dtype=np.int32),
            "code_mean": np.ascontiguousarray(self.code_mean),
            "code_scale": np.ascontiguousarray(self.code_scale),
        }
        if self.looseness is not None:
            arrays["looseness.shares"] = np.ascontiguousarray(self.looseness.shares, dtype=np.float16)
            arrays["looseness.pivots"] = np.ascontiguousarray(self.looseness.pivots)
        if self.recurrence is not None:
            learned = self.recurrence.network.items()
            arrays |= {f"recurrence.{name}": np.ascontiguousarray(value, dtype=np.float32) for name, value in learned}
            arrays["recurrence.pivot"] = np.ascontiguousarray(self.recurrence.pivot, dtype=np.float64)
        write_whole(Path(path), seal(save(arrays, metadata={"softdeca": json.dumps(about)})))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Weights:
        """Read what `save` wrote; InputError, one line, for a file that is missing, damaged or of another version."""
        path = Path(path)
        if not path.exists():
            raise InputError(f"weights {path}: no such file; `softdeca train` makes it")
        content = read_bytes(path, WEIGHTS_BYTES)
        about = _read_about(path, content)
        if about["format"] != FORMAT:
            raise InputError(
                f"weights {path}: of format {quote(about['format'])}, this version reads {FORMAT}; train them anew"
            )
        if not is_sealed(content, about["checksum"]):
            raise InputError(f"weights {path}: damaged, their content does not match their checksum; train them anew")
        arrays, note = load(content), about["note"]
        loose, swing = _select(arrays, "looseness"), _select(arrays, "recurrence")
        seen = {name: (low, high) for name, (low, high) in note["seen"].items()}
        return cls(
            kind=about["kind"],
            space=about["space"],
            mean=Surface(arrays["mean.vertices"], arrays["mean.triangles"]),
            code_mean=arrays["code_mean"],
            code_scale=arrays["code_scale"],
            network={name: value.astype(np.float32) for name, value in _select(arrays, "network").items()},
            note=TrainingNote(**note | {"curve": tuple(note["curve"]), "seen": seen, "held": tuple(note["held"])}),
            looseness=Looseness(**{k: v.astype(np.float64) for k, v in loose.items()}) if loose else None,
            recurrence=LearnedRecurrence(swing, swing.pop("pivot")) if swing else None,
            people=frozenset(about.get("people", ())),
        )


def _read_about(path: Path, content: bytes) -> dict[str, Any]:
    """Read what a file says of itself; InputError for one that has no format or checksum of ours."""
    size = int.from_bytes(content[:8], "little")
    try:
        about = parse_json(parse_json(content[8 : 8 + size])["__metadata__"]["softdeca"])
        return about | {"format": about["format"], "checksum": str(about["checksum"])}
    except (ValueError, LookupError, TypeError):
        raise InputError(f"weights {path}: damaged, or no weights of softdeca") from None


def _select(arrays: Mapping[str, np.ndarray], part: str) -> dict[str, np.ndarray]:
    """Return the arrays of a part of a file, without its name."""
    beginning = f"{part}."
    return {name.removeprefix(beginning): value for name, value in arrays.items() if name.startswith(beginning)}


def _choose_type(name: str, value: np.ndarray) -> type:
    if name.endswith("_table"):
        return np.int8
    return np.float16 if np.ndim(value) > 1 else np.float32
