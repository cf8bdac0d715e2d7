"""The weights of a trained network as one safetensors file: numbers only, so that reading it runs no code."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from ...lhm.base.checks import finite, in_range, integers, text
from ...lhm.base.errors import InputError, escape, quote
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.files.text import parse_json, read_bytes
from ...lhm.base.limits import CURVE_POINTS, WEIGHTS_BYTES
from ...lhm.base.mesh import Floats, Surface
from ..corpus.mixture import STATIC
from ..corpus.surface_hash import surface_hash
from ..rigs.inertia import Looseness
from .forms import FORMS
from .modal import check_modal
from .recurrence import LearnedRecurrence

CHECKS = {"modal": check_modal} | {kind: form.check for kind, form in FORMS.items()}
"""What checks the arrays of each kind of network by the sizes that its training noted: run time indexes them without
looking."""
UNSEALED = "0" * 64
"""What stands for a checksum while it is computed."""
FARTHEST = 1e5
"""[mm] Of any vertex or pivot, and of a number of a code: a hundred metres."""


@dataclass(frozen=True)
class TrainingNote:
    """What weights say of their training: people, faces (each under one p), frames, neutrals, steps, options, curve.

    seen: lowest and highest value of each parameter that it saw, mapped to [-1, 1]. held: numbers of the people that
    were held out for the curve, besides `people`. before: the same of the weights that the training began with, if it
    did.
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


@dataclass(frozen=True, eq=False)
class Weights:
    """Arrays of a network by name, and the mean skin [mm] they belong to; code_mean and code_scale (c,).

    kind: one of CHECKS. looseness: what dynamic frames need besides; None where nobody could fit heads to the people.
    recurrence: learned coefficients of Eq. 21, which take its place.
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

    def save(self, path: str | PathLike[str]) -> None:
        """Write one .safetensors file; `path` is whole or as it was.

        Modes and matrices of the network in float16, which rounds an answer of 10 mm by some thousandths; the
        other tables in bytes (see `tables`).
        """
        about = {
            "format": _format(self.kind),
            "space": self.space,
            "template": self.template,
            "parameters": STATIC,
            "note": asdict(self.note),
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
        about["checksum"] = UNSEALED
        write_whole(Path(path), seal(save(arrays, metadata={"softdeca": json.dumps(about)})))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Weights:
        """Read what `save` wrote, each array and note checked; InputError names the file and what is wrong."""
        path = Path(path)
        if not path.exists():
            raise InputError(f"weights {path}: no such file; `softdeca train` makes it")
        content = read_bytes(path, WEIGHTS_BYTES)
        try:
            size = int.from_bytes(content[:8], "little")
            about = parse_json(parse_json(content[8 : 8 + size])["__metadata__"]["softdeca"])
            formats = {_format(kind): kind for kind in CHECKS}
            if about["format"] not in formats:
                raise InputError(f"format {quote(about['format'])!r}, this version reads {', '.join(formats)}")
            if tuple(about["parameters"]) != STATIC:
                raise InputError("of other parameters than this version has; train them anew")
            if "checksum" not in about:
                raise InputError("without a checksum")
            if _digest(content, said := text("checksum", about["checksum"])) != said:
                raise InputError("their content does not match their checksum")
            return cls._from_arrays(formats[about["format"]], about, load(content))
        except (SafetensorError, ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
            said = escape(" ".join(str(error).split()))[:200] or type(error).__name__
            raise InputError(f"weights {path}: damaged, or no weights of softdeca ({said})") from None

    @classmethod
    def _from_arrays(cls, kind: str, about: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Weights:
        mean = Surface(
            finite("mean.vertices", arrays["mean.vertices"], (None, 3), most=FARTHEST), arrays["mean.triangles"]
        )
        code_mean = finite("code_mean", arrays["code_mean"], (None,), most=FARTHEST)
        code_scale = in_range("code_scale", arrays["code_scale"], 1e-9, FARTHEST, code_mean.shape)
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite then is refused
            network = {
                name.removeprefix("network."): value.astype(np.float32)
                for name, value in arrays.items()
                if name.startswith("network.")
            }
        space, note = text("space", about["space"]), _read_note(about["note"])
        CHECKS[kind](network, note.config["network"], mean, len(code_mean))
        looseness = _read_looseness(arrays, len(code_mean), len(mean.vertices))
        recurrence = _read_recurrence(arrays, len(code_mean), len(mean.vertices))
        weights = cls(kind, space, mean, code_mean, code_scale, network, note, looseness, recurrence)
        if weights.template != about["template"]:
            raise InputError(f"their mesh is not the one they name ({quote(about['template'])}); train them anew")
        return weights


def _format(kind: str) -> str:
    return f"softdeca-{kind.replace(' ', '-')}-5"


def _choose_type(name: str, value: np.ndarray) -> type:
    if name.endswith("_table"):
        return np.int8
    return np.float16 if np.ndim(value) > 1 else np.float32


def seal(content: bytes) -> bytes:
    """Put the checksum of a whole file, header included, in the place of its zeros."""
    return content.replace(UNSEALED.encode(), _digest(content, UNSEALED).encode(), 1)


def _digest(content: bytes, checksum: str) -> str:
    """SHA-256 of a file in which zeros stand for its checksum."""
    return hashlib.sha256(content.replace(checksum.encode(), UNSEALED.encode(), 1)).hexdigest()


def _read_note(said: Mapping[str, Any]) -> TrainingNote:
    """Read the note of a training; check its counts, curve and ranges."""
    counts = {name: said[name] for name in ("people", "faces", "frames", "neutrals", "steps")}
    for name, count in counts.items():
        integers(f"note {name}", count, 0, 2**53, ())
    curve = said["curve"]
    CURVE_POINTS.check("note curve", len(curve))
    for point in curve:
        finite("note curve", list(point.values()), (len(point),))
    if not curve or "seconds" not in curve[-1]:
        raise InputError("note curve: no point with its seconds")
    unknown = set(said["seen"]) ^ set(STATIC)
    if unknown:
        raise InputError(f"note seen: {quote(min(unknown))} is not known, or missing")
    seen = {name: tuple(in_range(f"note seen {name}", said["seen"][name], -1.0, 1.0, (2,)).tolist()) for name in STATIC}
    held = integers("note held", np.array(said.get("held", ()), dtype=np.int64), 0, 2**53, (None,)).tolist()
    config, before = said["config"], said.get("before")
    if not isinstance(config, dict) or not isinstance(before, (dict, type(None))):
        raise InputError("note config and before: expected objects")
    if before is not None:
        before = asdict(_read_note(before))
    return TrainingNote(**counts, config=config, curve=tuple(curve), seen=seen, held=tuple(held), before=before)


def _read_looseness(arrays: Mapping[str, np.ndarray], code_size: int, vertices: int) -> Looseness | None:
    if "looseness.shares" not in arrays:
        return None
    shares = finite("looseness.shares", arrays["looseness.shares"], (code_size + 1, vertices), most=FARTHEST)
    return Looseness(shares, finite("looseness.pivots", arrays["looseness.pivots"], (code_size + 1, 3), most=FARTHEST))


def _read_recurrence(arrays: Mapping[str, np.ndarray], code_size: int, vertices: int) -> LearnedRecurrence | None:
    if "recurrence.pivot" not in arrays:
        return None
    read = {k.removeprefix("recurrence."): value for k, value in arrays.items() if k.startswith("recurrence.")}
    learned = LearnedRecurrence({k: value for k, value in read.items() if k != "pivot"}, read["pivot"])
    learned.check(vertices, code_size)
    return learned
