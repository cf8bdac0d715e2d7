"""What rivals with networks share: training frames in memory, normalised inputs, and one loop."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from ...lhm.base.mesh import Floats32, Ints
from ..corpus.face import Face
from ..corpus.reading import Faces
from ..learning import nn, torch
from ..modal.features import Inputs
from .protocol import Bound, Takes

FRAMES, STEPS, BATCH, VERTICES, RATE = 6000, 1500, 32, 512, 2e-3
SEED = 7


def perceptron(*widths: int) -> nn.Sequential:
    """Linear layers of these widths with SiLU between."""
    layers: list[nn.Module] = []
    for inside, outside in zip(widths[:-1], widths[1:], strict=True):
        layers += [nn.Linear(inside, outside), nn.SiLU()]
    return nn.Sequential(*layers[:-1])


class Trained(ABC):
    """A method whose `network` gives T - S at some vertices from w and the summary of p and h, both normalised.

    Trained on vertices and frames drawn anew in each of STEPS, by Adam whose rate falls along a cosine, on the mean
    distance.
    """

    simulates = False
    takes: Takes = "nothing"
    name: str

    def __init__(self, steps: int = STEPS):
        self._steps = steps

    @abstractmethod
    def network(self, vertices: int, summary: int) -> nn.Module:
        """A fresh network; called with (w (b, 52), summary (b, s), vertices (v,)) it gives (b, v, 3) of size one."""

    def fit(self, faces: Faces) -> None:
        """Train on at most FRAMES frames."""
        self._inputs = Inputs.of(faces)
        rng = np.random.default_rng(SEED)
        torch.manual_seed(SEED)
        each = max(1, FRAMES // max(len(faces), 1))
        weights, summaries, motions = [], [], []
        for index in range(len(faces)):
            face = faces.face(index)
            frames = faces.frames(index, rng.permutation(len(faces.frames_of[index]))[:each])
            weights.append(frames.weights)
            summaries.append(np.repeat(self._inputs.summary_of(face)[None], len(frames.weights), axis=0))
            motions.append(frames.corrected)
        known, motion = np.concatenate(summaries), np.concatenate(motions)
        self._mean, self._scale = known.mean(axis=0), np.maximum(known.std(axis=0), 1e-3)
        self._size = float(np.sqrt(np.mean(np.square(motion[:: max(1, len(motion) // 200)], dtype=np.float32))))
        self._network = self.network(motion.shape[1], known.shape[1])
        self._train(np.concatenate(weights), ((known - self._mean) / self._scale).astype(np.float32), motion, rng)

    def _train(self, weights: Floats32, summaries: Floats32, motion: np.ndarray, rng: np.random.Generator) -> None:
        optimiser = torch.optim.Adam(self._network.parameters(), lr=RATE)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, self._steps)
        for _ in range(self._steps):
            rows = rng.integers(len(weights), size=BATCH)
            vertices = rng.permutation(motion.shape[1])[:VERTICES]
            wanted = torch.from_numpy(motion[rows][:, vertices].astype(np.float32) / self._size)
            found = self._network(torch.from_numpy(weights[rows]), torch.from_numpy(summaries[rows]), vertices)
            loss = ((found - wanted).square().sum(dim=-1) + 1e-6).sqrt().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()

    def bind(self, face: Face) -> Bound:
        """What of the network depends on p and h alone, where it has such a part."""
        summary = (self._inputs.summary_of(face) - self._mean) / self._scale
        known = torch.from_numpy(summary.astype(np.float32))[None]
        every: Ints = np.arange(len(face.offset))
        with torch.no_grad():
            frames = self.bound(self._network, known, every)

        def corrected(weights: Floats32) -> Floats32:
            with torch.no_grad():
                found: Floats32 = frames(torch.from_numpy(np.ascontiguousarray(weights, dtype=np.float32))).numpy()
            return self._size * found

        return corrected

    def bound(self, network: nn.Module, summary, vertices: Ints):
        """Frames (b, v, 3) of w (b, 52), as a function."""
        return lambda weights: network(weights, summary.expand(len(weights), -1), vertices)
