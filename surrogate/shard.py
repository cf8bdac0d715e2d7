"""One identity's frames as an HDF5 file, written whole or not at all, with a checksum over its content."""

from __future__ import annotations

import hashlib
import io
from dataclasses import dataclass, fields
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from ..lhm.errors import InputError
from ..lhm.files.atomic import write_whole
from ..lhm.mesh import Floats

ACCEPTED = "accepted"
_REMEDY = "the next study makes it anew"


@dataclass(frozen=True, eq=False)
class Shard:
    """All m frames of one identity, those that were not accepted included.

    skin (n, 3) [mm]; code (c,); expressions, parameter_sets (m,): numbers of the plan; weights (m, 52); parameters
    (m, k); moved = S_t - skin and corrected = T_t - S_t (m, n, 3) [mm]; status (m,): "accepted", or why not;
    iterations, gradient_ratio (norm over its start), smallest_volume_ratio, inverted (tets) (m,): the solver's record.
    """

    skin: Floats
    code: Floats
    expressions: NDArray[np.int64]
    parameter_sets: NDArray[np.int64]
    weights: Floats
    parameters: Floats
    moved: NDArray[np.float32]
    corrected: NDArray[np.float16]  # rounds by less than 0.001 mm below 2 mm, 0.008 mm at 20 mm
    status: NDArray[np.bytes_]
    iterations: NDArray[np.int64]
    gradient_ratio: Floats
    smallest_volume_ratio: Floats
    inverted: NDArray[np.int64]

    @property
    def accepted(self) -> NDArray[np.bool_]:
        """Mask of the frames that training and test may use, shape (m,)."""
        return self.status == ACCEPTED.encode()

    @property
    def checksum(self) -> str:
        """SHA-256 over names, shapes, types and bytes of all arrays."""
        digest = hashlib.sha256()
        for item in fields(self):
            array = np.ascontiguousarray(getattr(self, item.name))
            digest.update(f"{item.name} {array.dtype.str} {array.shape};".encode())
            digest.update(array.tobytes())
        return digest.hexdigest()


def write_shard(path: Path, shard: Shard, owner: str) -> None:
    """Write a shard of the corpus `owner` (the digest of its plan and template); `path` is whole or as it was."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file.attrs["owner"] = owner
        file.attrs["checksum"] = shard.checksum
        for item in fields(shard):
            array = getattr(shard, item.name)
            large = array.ndim == 3
            file.create_dataset(item.name, data=array, compression="gzip" if large else None, shuffle=large)
    write_whole(path, buffer.getvalue())


def read_shard(path: Path, owner: str) -> Shard:
    """Read a shard and check it; InputError for one that is missing, truncated, damaged or of another corpus."""
    if not path.is_file():
        raise InputError(f"shard {path}: missing; the next study makes it")
    try:
        with h5py.File(path, "r") as file:
            found, checksum = str(file.attrs["owner"]), str(file.attrs["checksum"])
            shard = Shard(**{item.name: file[item.name][()] for item in fields(Shard)})
    except (OSError, KeyError, RuntimeError, ValueError) as error:
        cause = str(error).splitlines()[0][:60]
        raise InputError(f"shard {path}: truncated or damaged ({cause}); {_REMEDY}") from None
    if found != owner:
        raise InputError(f"shard {path}: of another corpus ({found}, expected {owner}): its plan or template differs")
    if shard.checksum != checksum:
        raise InputError(f"shard {path}: its content does not match its checksum; {_REMEDY}")
    return shard
