"""The weights of a trained modal network as one safetensors file: numbers only, so that reading it runs no code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from ...lhm.errors import InputError
from ...lhm.files.atomic import write_whole
from ...lhm.mesh import Floats, Surface
from ..surface_hash import surface_hash
from .features import STATIC
from .looseness import Looseness

FORMAT = "softdeca-modal-3"
PARTS = ("settled", "relaxed", "responses", "remainder")
"""The neutral face that p has settled; what it relaxes to among its targets; what is linear in w; and the rest."""
NEUTRAL = PARTS[:2]


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


@dataclass(frozen=True, eq=False)
class ModalWeights:
    """Arrays of the network by name, and the mean skin [mm] they belong to; code_mean and code_scale (c,).

    looseness: what dynamic frames need besides; None where nobody could fit heads to the people.
    """

    space: str
    mean: Surface
    code_mean: Floats
    code_scale: Floats
    network: Mapping[str, np.ndarray]
    note: TrainingNote
    looseness: Looseness | None = None

    @property
    def template(self) -> str:
        """The hash of the mean skin."""
        return surface_hash(self.mean)

    def save(self, path: str | PathLike[str]) -> None:
        """Write one .safetensors file; `path` is whole or as it was.

        Tables and matrices of the network in float16, which rounds an answer of 10 mm by some thousandths.
        """
        about = {
            "format": FORMAT,
            "space": self.space,
            "template": self.template,
            "parameters": STATIC,
            "note": asdict(self.note),
        }
        arrays = {
            f"network.{name}": np.ascontiguousarray(value, dtype=np.float16 if np.ndim(value) > 1 else np.float32)
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
        write_whole(Path(path), save(arrays, metadata={"softdeca": json.dumps(about)}))

    @classmethod
    def load(cls, path: str | PathLike[str]) -> ModalWeights:
        """Read what `save` wrote; InputError for a file that is missing, damaged, or something else."""
        path = Path(path)
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            raise InputError(f"weights {path}: no such file; `softdeca train` makes it") from None
        except OSError as error:
            raise InputError(f"weights {path}: cannot be read ({error.strerror})") from None
        try:
            size = int.from_bytes(content[:8], "little")
            about = json.loads(json.loads(content[8 : 8 + size])["__metadata__"]["softdeca"])
            if about["format"] != FORMAT:
                raise InputError(f"weights {path}: format {about['format']!r}, this version reads {FORMAT!r}")
            if tuple(about["parameters"]) != STATIC:
                raise InputError(f"weights {path}: of other parameters than this version has; train them anew")
            arrays = load(content)
            note = about["note"]
            weights = cls(
                space=about["space"],
                mean=Surface(arrays["mean.vertices"], arrays["mean.triangles"]),
                code_mean=arrays["code_mean"],
                code_scale=arrays["code_scale"],
                network={
                    name.removeprefix("network."): value.astype(np.float32)
                    for name, value in arrays.items()
                    if name.startswith("network.")
                },
                note=TrainingNote(
                    **{
                        **note,
                        "curve": tuple(note["curve"]),
                        "held": tuple(note.get("held", ())),
                        "seen": {name: (low, high) for name, (low, high) in note["seen"].items()},
                    }
                ),
                looseness=_looseness(arrays),
            )
        except InputError:
            raise
        except (SafetensorError, ValueError, KeyError, TypeError, AttributeError) as error:
            said = " ".join(str(error).split())[:80] or type(error).__name__
            raise InputError(f"weights {path}: damaged, or no weights of softdeca ({said})") from None
        if weights.template != about["template"]:
            raise InputError(
                f"weights {path}: their mesh is not the one they name ({about['template']}); train them anew"
            )
        if not all(np.isfinite(value).all() for name, value in arrays.items() if name != "mean.triangles"):
            raise InputError(f"weights {path}: some are not finite")
        return weights


def _looseness(arrays: Mapping[str, np.ndarray]) -> Looseness | None:
    if "looseness.shares" not in arrays:
        return None
    shares, pivots = arrays["looseness.shares"].astype(np.float64), arrays["looseness.pivots"]
    expected = (len(arrays["code_mean"]) + 1, len(arrays["mean.vertices"]))
    if shares.shape != expected or pivots.shape != (expected[0], 3):
        raise ValueError(f"looseness of shape {shares.shape}, {expected} is needed")
    return Looseness(shares, pivots)
