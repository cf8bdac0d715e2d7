"""What networks of T - S at vertices share: training frames in memory, normalised inputs, and their lesson."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from ...lhm.base.mesh import Floats32
from ..corpus.face import KeptFace
from ..corpus.reading import Faces
from ..rigs.rig import CorrectedRig, Needs
from .features import Inputs
from .layers import EVERY, Arrays
from .ridge import sample_frames
from .trainer import Lesson, Tensors, Trainer, TrainerConfig, torch

FRAMES, BATCH, VERTICES = 6000, 32, 512
TRAINING = TrainerConfig(seed=7, steps=1500, learning_rate=2e-3)


class VertexNetwork(Lesson):
    """A method whose network gives T - S at some vertices from w and the summary of p and h, both normalised.

    Trained on vertices and frames drawn anew in each step, on the mean distance.
    """

    needs: Needs = "nothing"

    def __init__(self, config: TrainerConfig = TRAINING):
        self._config = config

    @abstractmethod
    def draw(self, vertices: int, summary: int) -> Tensors:
        """Draw a network for so many vertices and numbers of a summary."""

    @abstractmethod
    def bound(self, network: Arrays, summary: Any, vertices: Any = EVERY) -> Any:
        """Evaluate at some vertices what depends on the summary (b, s) alone."""

    @abstractmethod
    def answer(self, network: Arrays, bound: Any, weights: Any, vertices: Any = EVERY) -> Any:
        """Return T - S at some vertices, (b, v, 3), of size one, for weights (b, 52)."""

    def fit(self, faces: Faces) -> None:
        """Train on at most FRAMES frames."""
        self._inputs = Inputs.from_faces(faces)
        torch.manual_seed(self._config.seed)
        weights, summaries, motions = [], [], []
        for face, frames in sample_frames(faces, FRAMES, np.random.default_rng(self._config.seed)):
            weights.append(frames.weights)
            summaries.append(np.repeat(self._inputs.summary_of(face)[None], len(frames.weights), axis=0))
            motions.append(frames.corrected)
        summary, self._motion = np.concatenate(summaries), np.concatenate(motions)
        self._mean, self._scale = summary.mean(axis=0), np.maximum(summary.std(axis=0), 1e-3)
        step = max(1, len(self._motion) // 200)
        self._size = float(np.sqrt(np.mean(np.square(self._motion[::step], dtype=np.float32))))
        self._weights = torch.from_numpy(np.concatenate(weights))
        self._summaries = torch.from_numpy(((summary - self._mean) / self._scale).astype(np.float32))
        self.network = self.draw(self._motion.shape[1], summary.shape[1])
        for value in self.network.values():
            value.requires_grad_()
        trainer = Trainer(self, self._config)
        trainer.train()
        self.steps, self.arrays = trainer.step, trainer.arrays()
        del self._motion, self._weights, self._summaries, self.network

    def loss(self, done: float, rng: np.random.Generator) -> torch.Tensor:
        """Return the mean distance over some frames and vertices."""
        rows = rng.integers(len(self._weights), size=BATCH)
        vertices = rng.permutation(self._motion.shape[1])[:VERTICES]
        expected = torch.from_numpy(self._motion[rows][:, vertices].astype(np.float32) / self._size)
        bound = self.bound(self.network, self._summaries[rows], vertices)
        answer = self.answer(self.network, bound, self._weights[rows], vertices)
        return ((answer - expected).square().sum(dim=-1) + 1e-6).sqrt().mean()

    def bind(self, face: KeptFace) -> CorrectedRig:
        """Evaluate what of the network depends on p and h alone, where it has such a part."""
        summary = (self._inputs.summary_of(face) - self._mean) / self._scale
        bound = self.bound(self.arrays, summary.astype(np.float32)[None])

        def correct(weights: Floats32) -> Floats32:
            moved: Floats32 = self.answer(self.arrays, bound, weights[None])[0]
            return self._size * moved

        return CorrectedRig(face.skin, face.shapes, correct)
