"""Simulated frames as arrays: what training and evaluation consume, wherever they come from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32, Surface
from ...reference import Parameters
from ..corpus.mixture import INFOS, NAMES
from ..corpus.plan import Split
from ..corpus.reading import Table


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


def samples_of(folder: str | PathLike[str], split: Split) -> Samples:
    """The accepted static frames of a corpus whose parameters are uniform; InputError where there are none of these."""
    table = Table(folder, "statics", split)
    rows = [row for row in (table[index] for index in range(len(table))) if not row["coefficients"][:, 1:].any()]
    if not rows:
        raise InputError(
            f"corpus {folder}: all its frames of the {split} split have parameters that vary over the face"
        )
    varied = np.any([row["varied"] for row in rows], axis=0)
    names = tuple(name for name, is_varied in zip(NAMES, varied, strict=True) if is_varied)
    normalised = np.stack([row["coefficients"][varied, 0] for row in rows]).astype(np.float64)
    moved = [np.tensordot(row["weights"], table.shapes(row["identity"]), axes=1) for row in rows]
    blended = np.stack(
        [table.skin(row["identity"]).vertices + move for row, move in zip(rows, moved, strict=True)]
    ).astype(np.float32)
    return Samples(
        reference=table.template.mean,
        space=table.people,
        parameter_names=names,
        identity=np.array([row["identity"] for row in rows]),
        codes=np.stack([row["code"] for row in rows]).astype(np.float32),
        weights=np.stack([row["weights"] for row in rows]),
        parameters=np.column_stack([INFOS[name].denormalise(normalised[:, k]) for k, name in enumerate(names)]),
        blended=blended,
        simulated=blended + np.stack([row["corrected"] for row in rows]).astype(np.float32),
    )
