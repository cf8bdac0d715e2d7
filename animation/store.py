"""The folder of a simulated take: a file per frame, a log, and the state from which the next frame follows."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..lhm.base.checks import finite, integers, text
from ..lhm.base.errors import InputError
from ..lhm.base.files.atomic import write_whole
from ..lhm.base.files.npz import read_arrays, write_arrays
from ..lhm.base.files.resumable import RowStore
from ..lhm.base.limits import TAKE_FRAMES

NEUTRAL = ("positions", "displacement", "reason")
LOGGED = {"frame", "method", "error", "certain", "seconds"}
"""Of each line of the log: what the outcome of a take is told by."""


def digest(*arrays) -> str:
    """A short hash of arrays' shapes, types and bytes."""
    found = hashlib.sha256()
    for array in map(np.ascontiguousarray, arrays):
        found.update(f"{array.dtype.str} {array.shape};".encode())
        found.update(array.tobytes())
    return found.hexdigest()[:16]


class TakeStore:
    """Frames in frames/NNNNNN.npz (`moved`: the skin less its neutral [mm], float32), log.jsonl, state.npz, take.json.

    Beside them neutral.npz: the face at rest under p. A frame counts as done once the state after it is written: what a
    killed run left beyond that is made anew, and the state is kept in full precision, so that a run that goes on makes
    the bytes of one that was never stopped. InputError if the folder holds a take with another `manifest`.
    """

    def __init__(self, folder: Path, manifest: Mapping[str, Any]):
        self.folder, self._log = folder, RowStore(folder, "take", manifest, file="log.jsonl")

    def done(self, *names: str) -> tuple[int, dict[str, np.ndarray] | None]:
        """How many frames are done, and the state after them, arrays of these names; the log is cut to these.

        All begin anew where a frame, a line of the log or the state is missing or damaged.
        """
        try:
            arrays = read_arrays(self.folder / "state.npz", "frames", *names)
            count = int(integers("frames", arrays["frames"], 0, TAKE_FRAMES.most, ()))
            state = {name: finite(name, arrays[name]) for name in names}
            shapes = {finite("moved", self.moved(number), (None, 3)).shape for number in range(count)}
            if len(shapes) > 1:
                raise InputError(f"{self.folder}: frames of several heads")
        except InputError:
            count, state = 0, None
        lines = [line for line in self._log.rows() if LOGGED <= line.keys() and isinstance(line["frame"], int)]
        records = {line["frame"]: line for line in lines}
        if not records.keys() >= set(range(count)):
            count, state = 0, None
        self._log.keep(records[number] for number in range(count))
        return count, state

    def neutral(self) -> dict[str, np.ndarray] | None:
        """The neutral face under p, arrays NEUTRAL as `keep_neutral` had them; None if missing or damaged."""
        try:
            arrays = read_arrays(self.folder / "neutral.npz", *NEUTRAL)
            for name in NEUTRAL[:2]:
                finite(name, arrays[name], (None, 3))
            text("reason", arrays["reason"])
        except InputError:
            return None
        return arrays

    def keep_neutral(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Write the neutral face under p, from which a run that goes on starts as the first did."""
        write_arrays(self.folder / "neutral.npz", {name: arrays[name] for name in NEUTRAL})

    def add(
        self, number: int, moved: NDArray[np.float32], record: Mapping[str, Any], state: Mapping[str, np.ndarray]
    ) -> None:
        """Write frame `number` (they come in order), its line of the log, and the state after it.

        `record` has the number as "frame".
        """
        write_arrays(self._path(number), {"moved": moved})
        self._log.add(record)
        buffer = io.BytesIO()
        np.savez(buffer, frames=np.int64(number + 1), **state)
        write_whole(self.folder / "state.npz", buffer.getvalue())

    def moved(self, number: int) -> NDArray[np.float32]:
        """A frame's skin less its neutral [mm], shape (n, 3); InputError if it is missing or damaged."""
        return read_arrays(self._path(number), "moved", of="a frame of a take")["moved"]

    def log(self) -> list[dict[str, Any]]:
        """The log's lines, in the frames' order."""
        return self._log.rows()

    def _path(self, number: int) -> Path:
        return self.folder / "frames" / f"{number:06d}.npz"
