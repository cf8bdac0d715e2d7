"""Simulated frames as arrays: what training and evaluation consume, wherever they come from."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..lhm.errors import InputError
from ..lhm.mesh import Floats, Surface
from ..reference import Parameters

Floats32 = NDArray[np.float32]


def surface_hash(surface: Surface) -> str:
    """A name for a template: its triangles, and its vertices to 0.01 mm, as 16 hexadecimal digits."""
    digest = hashlib.sha256(np.ascontiguousarray(surface.triangles, dtype="<i8").tobytes())
    digest.update(np.round(surface.vertices * 100.0).astype("<i8").tobytes())
    return digest.hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Samples:
    """N frames of one space of identities.

    reference: the template's skin [mm]; space: its name; parameter_names: those that vary. Per frame: identity number
    (N,), code (N, c), weights (N, 52), parameters (N, k) in their own units, the linear blendshapes' answer `blended`
    S_t and the simulator's `simulated` T_t [mm], shape (N, n, 3). Raises InputError for shapes that disagree.
    """

    reference: Surface
    space: str
    parameter_names: tuple[str, ...]
    identity: NDArray[np.int64]
    codes: Floats32
    weights: Floats32
    parameters: Floats
    blended: Floats32
    simulated: Floats32

    def __post_init__(self):
        count, points = len(self.identity), self.reference.vertices.shape
        expected = {
            "codes": (count, self.codes.shape[-1]),
            "weights": (count, 52),
            "parameters": (count, len(self.parameter_names)),
            "blended": (count, *points),
            "simulated": (count, *points),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"samples {name}: expected shape {shape}, got {getattr(self, name).shape}")

    def __len__(self) -> int:
        return len(self.identity)

    def take(self, index) -> Samples:
        """Some of the frames, by index or mask."""
        names = ("identity", "codes", "weights", "parameters", "blended", "simulated")
        return replace(self, **{name: getattr(self, name)[index] for name in names})

    def normalised_parameters(self) -> Floats32:
        """Parameters mapped to [-1, 1] over their ranges, shape (N, k)."""
        return normalise_parameters(self.parameter_names, self.parameters)


def normalise_parameters(names: tuple[str, ...], values: Floats) -> Floats32:
    """Values (..., k) of the named parameters mapped to [-1, 1] over their ranges; InputError for one outside."""
    columns = []
    for column, name in enumerate(names):
        info, value = Parameters.info(name), np.asarray(values[..., column], dtype=np.float64)
        outside = ~((value >= info.low) & (value <= info.high))
        if outside.any():
            raise InputError(
                f"parameter {name} = {value[outside].ravel()[0]:g} is outside [{info.low:g}, {info.high:g}] {info.unit}"
            )
        columns.append(info.normalise(value))
    return np.stack(columns, axis=-1).astype(np.float32)
