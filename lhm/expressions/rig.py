"""The 52 ARKit expressions as motions of one head's skin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.checks import array_of_kind, real
from ..base.errors import InputError, MeshError
from ..base.mesh import Floats
from ..identities.arkit import ARKIT, check_weights
from ..identities.space import LinearSpace


@dataclass(frozen=True, eq=False)
class Rig:
    """`deltas` [mm], float32, shape (52, n, 3): what each expression adds to a neutral skin, in ARKit's order.

    `source` says in words where they come from; `missing` names those that nothing is known of (zero). Raises MeshError
    for another shape, or values that are not finite.
    """

    deltas: NDArray[np.float32]
    source: str
    missing: tuple[str, ...] = ()

    def __post_init__(self):
        deltas = np.array(real("rig", self.deltas, (len(ARKIT), None, 3), error=MeshError), dtype=np.float32)
        deltas.flags.writeable = False
        object.__setattr__(self, "deltas", deltas)

    def moved(self, weights) -> Floats:
        """Add up what ARKit weights (52,) do to the skin [mm], shape (n, 3); InputError for another shape."""
        values = np.asarray(array_of_kind("weights", weights, "fiub", "numbers"), dtype=np.float64)
        if values.shape != (len(ARKIT),):
            raise InputError(f"weights: expected shape ({len(ARKIT)},), got {values.shape}")
        used = np.flatnonzero(values)
        return np.tensordot(values[used], self.deltas[used].astype(np.float64), axes=1)


def blend(space: LinearSpace, code, weights) -> Floats:
    """Blend skins [mm] of an identity under ARKit weights, S = skin + sum_k w_k delta_k.

    `code` as in `space.skin`, `weights` (frames, 52) or (52,) in [0, 1] (clipped with a warning that counts them);
    returns (frames, n, 3). Raises InputError for another shape and for weights that are not finite.
    """
    values = np.atleast_2d(check_weights(weights))
    deltas = space.expression_deltas(code)
    used = np.flatnonzero(values.any(axis=0))
    displacement = np.tensordot(values[:, used], deltas[used], axes=1)
    return space.skin(code).vertices + displacement
