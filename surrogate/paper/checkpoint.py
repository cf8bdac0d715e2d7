"""A trained surrogate as one file: numbers only (npz), so reading it runs no code and needs no torch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...lhm.base.errors import InputError
from ...lhm.base.files.npz import read_arrays, write_arrays
from ...lhm.base.mesh import Floats, Ints, Surface
from ..surface_hash import surface_hash

FORMAT = "softdeca-surrogate-1"


@dataclass(frozen=True)
class HypernetworkConfig:
    """Widths, each with its reason; InputError for one that is not positive.

    The paper's are not public; these are chosen for a few hundred frames and minutes of a CPU.
    """

    latent: int = 32  # length of z_t, the paper's
    expression_hidden: int = 128  # f_w runs once per frame, so its width costs nothing
    position: int = 32  # π(i): smooth fields over the face; more only learns slower
    gain_hidden: int = 16  # gains are smooth in few parameters
    hidden: int = 16  # of f_ph's MLP, which runs on every face in training: time grows with its square

    def __post_init__(self):
        for name, value in vars(self).items():
            if not isinstance(value, int) or value < 1:
                raise InputError(f"hypernetwork {name}: expected a positive integer, got {value!r}")


@dataclass(frozen=True)
class TrainingPoint:
    """Mean vertex errors [mm] at one time of a training: on its own frames, and on held-out identities."""

    step: int
    seconds: float
    train_mm: float
    validation_mm: float


@dataclass(frozen=True)
class TrainingSummary:
    """What a checkpoint says of its training: frames and identities, steps made, seconds, mean vertex errors [mm]."""

    frames: int
    identities: int
    steps: int
    seconds: float
    validation_mm: float
    validation_blendshapes_mm: float
    history: tuple[TrainingPoint, ...]

    @classmethod
    def from_json(cls, content: dict) -> TrainingSummary:
        """Rebuild from what `dataclasses.asdict` gave."""
        return cls(**{**content, "history": tuple(TrainingPoint(**point) for point in content["history"])})


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Everything a run time needs: arrays of the network by name, and the mesh they belong to.

    reference: the skin [mm] whose gradients the transfer uses; anchors: its vertices that are held; code_mean and
    code_scale (c,) normalise identity codes; parameter_names are those the network was trained for.
    """

    space: str
    reference: Surface
    anchors: Ints
    parameter_names: tuple[str, ...]
    code_mean: Floats
    code_scale: Floats
    config: HypernetworkConfig
    network: Mapping[str, NDArray[np.float32]]
    summary: TrainingSummary

    @property
    def template(self) -> str:
        """The hash of the reference surface."""
        return surface_hash(self.reference)

    def save(self, path: str | PathLike[str]) -> None:
        """Write one .npz file; `path` is whole or as it was."""
        meta = {
            "format": FORMAT,
            "space": self.space,
            "template": self.template,
            "parameter_names": self.parameter_names,
            "config": asdict(self.config),
            "summary": asdict(self.summary),
        }
        arrays: dict[str, np.ndarray] = {f"network.{name}": value for name, value in self.network.items()}
        arrays |= {
            "meta": np.array(json.dumps(meta)),
            "vertices": self.reference.vertices,
            "triangles": self.reference.triangles,
            "anchors": self.anchors,
            "code_mean": self.code_mean,
            "code_scale": self.code_scale,
        }
        write_arrays(path, arrays)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Checkpoint:
        """Read what `save` wrote; InputError for a file that is missing, damaged, or something else."""
        path = Path(path)
        if not path.is_file():
            raise InputError(f"checkpoint {path}: no such file; `softdeca train` makes it, as does the study")
        try:
            arrays = read_arrays(path, of="a checkpoint of softdeca")
            meta = json.loads(str(arrays.pop("meta")))
            if meta["format"] != FORMAT:
                raise InputError(f"checkpoint {path}: its format is {meta['format']!r}, this version reads {FORMAT!r}")
            checkpoint = cls(
                space=meta["space"],
                reference=Surface(arrays["vertices"], arrays["triangles"]),
                anchors=arrays["anchors"],
                parameter_names=tuple(meta["parameter_names"]),
                code_mean=arrays["code_mean"],
                code_scale=arrays["code_scale"],
                config=HypernetworkConfig(**meta["config"]),
                network={
                    name.removeprefix("network."): value
                    for name, value in arrays.items()
                    if name.startswith("network.")
                },
                summary=TrainingSummary.from_json(meta["summary"]),
            )
        except InputError:
            raise
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f"checkpoint {path}: damaged, or no checkpoint of softdeca ({_short(error)})") from None
        if checkpoint.template != meta["template"]:
            raise InputError(f"checkpoint {path}: its mesh is not the one it names ({meta['template']}); train it anew")
        return checkpoint


def _short(error: Exception) -> str:
    return str(error).splitlines()[0][:80] if str(error) else type(error).__name__
