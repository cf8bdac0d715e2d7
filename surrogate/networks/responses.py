"""Learned responses: offset and 52 responses as combinations of training faces', by kernel ridge regression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32
from ..corpus.face import KeptFace
from ..corpus.reading import Faces
from ..rigs.bound import BoundSurrogate
from ..rigs.rig import FaceModes, Needs
from .features import Inputs


@dataclass(frozen=True)
class ResponsesPolicy:
    """Constants of the regression."""

    lengths: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)  # of the kernel, over the median distance of training faces
    penalties: tuple[float, ...] = (1e-4, 1e-3, 1e-2, 1e-1)
    block: int = 32  # faces that are added up at once
    probed: int = 2000  # coordinates of the responses by which their kernel is chosen
    seed: int = 0  # of these coordinates


POLICY = ResponsesPolicy()
"""The constants as they were measured."""


class LearnedResponses:
    """exp(-d²/2 l²) + x·x' on the summary of p and h; length and penalty by least leave-one-out error (Allen 1974)."""

    needs: Needs = "nothing"

    def __init__(self, policy: ResponsesPolicy = POLICY):
        self._policy = policy

    def fit(self, faces: Faces) -> None:
        """Keep all training faces; InputError for fewer than ten."""
        if len(faces) < 10:
            raise InputError(f"learned responses: {len(faces)} faces; at least 10 are needed")
        self._inputs = Inputs.from_faces(faces)
        every = [faces.face(k) for k in range(len(faces))]
        rows = np.array([self._inputs.summary_of(face) for face in every], dtype=np.float64)
        self._mean, self._scale = rows.mean(axis=0), np.maximum(rows.std(axis=0), 1e-3)
        self._rows = (rows - self._mean) / self._scale
        self._unit = float(np.median(np.linalg.norm(self._rows[:, None] - self._rows[None, :200], axis=2)))
        n3 = every[0].offset.size
        self._offsets = np.stack([face.offset.ravel() for face in every])
        self._responses = np.stack([face.responses.reshape(-1) for face in every])
        probe = np.random.default_rng(self._policy.seed).permutation(52 * n3)[: self._policy.probed]
        self._offset_weights, self._offset_length = self._choose_kernel(self._offsets[:, probe[probe < n3]])
        self._response_weights, self._response_length = self._choose_kernel(self._responses[:, np.sort(probe)])

    def bind(self, face: KeptFace) -> BoundSurrogate:
        """Combine all training faces."""
        row = (self._inputs.summary_of(face) - self._mean) / self._scale
        offset = self._combine(row, self._offset_weights, self._offset_length, self._offsets)
        responses = self._combine(row, self._response_weights, self._response_length, self._responses)
        n3 = face.skin.vertices.shape
        modes = FaceModes.linear(offset.reshape(n3), responses.reshape(-1, *n3))
        return BoundSurrogate(face.skin, modes, np.asarray(face.shapes, dtype=np.float32))

    def _combine(self, row: Floats, inverse: Floats, length: float, values: np.ndarray) -> Floats32:
        shares = (inverse @ self._kernel(self._rows, row[None], length)[:, 0]).astype(np.float32)
        block = self._policy.block
        total: Floats32 = np.zeros(values.shape[1], dtype=np.float32)
        for first in range(0, len(values), block):  # a corpus keeps 16 bits, in which products would be rounded
            total += shares[first : first + block] @ values[first : first + block].astype(np.float32)
        return total

    def _kernel(self, one: Floats, other: Floats, length: float) -> Floats:
        squares = (one**2).sum(axis=1)[:, None] + (other**2).sum(axis=1)[None] - 2.0 * one @ other.T
        return np.exp(-squares / (2.0 * (length * self._unit) ** 2)) + one @ other.T / one.shape[1]

    def _choose_kernel(self, values: np.ndarray) -> tuple[Floats, float]:
        """Return the regularised inverse kernel, symmetric, and its length."""
        values = values.astype(np.float64)
        best: tuple[float, Floats, float] | None = None
        for length in self._policy.lengths:
            kernel = self._kernel(self._rows, self._rows, length)
            for penalty in self._policy.penalties:
                inverse = np.linalg.inv(kernel + penalty * np.eye(len(kernel)))
                error = float((((inverse @ values) / np.diag(inverse)[:, None]) ** 2).sum())
                if best is None or error < best[0]:
                    best = error, inverse, length
        assert best is not None
        return best[1], best[2]
