"""Subspace Neural Physics (Holden et al. 2019) as SoftDECA compares with it: sequences alone, in one linear subspace.

    z̄_t = a z_{t-1} + b (z_{t-1} - z_{t-2}),    z_t = z̄_t + MLP(z̄_t, z_{t-1}, w_t, p, h)

z are the principal components of T - S. What a turning head does to flesh is no input, as in the paper.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.mesh import Floats, Floats32
from ..corpus.reading import Row, Table
from ..rigs.rig import Needs
from .components import find_components
from .features import Inputs
from .layers import perceptron, perceptron_layers
from .trainer import Lesson, Trainer, TrainerConfig, draw_layers, torch

MODES, WIDTH, BATCH = 128, 512, 16
TRAINING = TrainerConfig(seed=7, steps=1500, learning_rate=1e-3, clip=1.0)
SEQUENCES = 256
"""At most: 1 MB each on the default head."""


class SubspacePhysics(Lesson):
    """A step of a sequence from the two before it; trained on whole sequences, so that its errors are its own."""

    needs: Needs = "nothing"

    def __init__(self, config: TrainerConfig = TRAINING):
        self._config = config

    def fit(self, table: Table) -> None:
        """Train on a corpus' sequences, SEQUENCES of them at most: its subspace is made of all at once."""
        rng = np.random.default_rng(self._config.seed)
        torch.manual_seed(self._config.seed)
        rows = [table[int(k)] for k in np.sort(rng.permutation(len(table))[:SEQUENCES])]
        codes = np.array([row["code"] for row in rows], dtype=np.float64)
        self._inputs = Inputs.from_few(table.mean, codes)
        motion = np.stack([_motion(row) for row in rows])
        count, length = motion.shape[:2]
        flat = motion.reshape(count * length, -1)
        self._mean = flat.mean(axis=0)
        self._modes = find_components(flat - self._mean, min(MODES, len(flat)), rng)[0]
        z = ((flat - self._mean) @ self._modes.T).reshape(count, length, -1)
        self._size = np.maximum(z.std(axis=(0, 1)), 1e-6)
        z /= self._size
        self._before = _momentum(z)
        inputs = np.stack([self._inputs.of_sequence(row) for row in rows]).astype(np.float32)
        size = z.shape[2]
        self.network = draw_layers(perceptron_layers("step", 2 * size + inputs.shape[2], WIDTH, WIDTH, size))
        for value in self.network.values():
            value.requires_grad_()
        self._z, self._frames = torch.from_numpy(z.astype(np.float32)), torch.from_numpy(inputs)
        trainer = Trainer(self, self._config)
        trainer.train()
        self.steps = trainer.step
        del self._z, self._frames

    def loss(self, done: float, rng: np.random.Generator) -> torch.Tensor:
        """Return the mean distance over the steps of some sequences."""
        rows = torch.from_numpy(rng.integers(len(self._z), size=min(BATCH, len(self._z))))
        z = self._z[rows]
        weight = torch.from_numpy((self._size / self._size.max()).astype(np.float32))
        rolled = self._roll(z[:, 0], z[:, 1], self._frames[rows])
        return (weight * (rolled - z[:, 2:])).square().sum(dim=-1).add(1e-8).sqrt().mean()

    def _roll(self, earlier, last, inputs):
        """Steps (b, L, k) after two states (b, k) under inputs (b, L, ...)."""
        kept, momentum = (torch.from_numpy(part.astype(np.float32)) for part in self._before)
        steps = []
        for now in inputs.unbind(dim=1):
            ahead = kept * last + momentum * (last - earlier)
            earlier, last = last, ahead + perceptron(self.network, "step", torch.cat([ahead, last, now], dim=1))
            steps.append(last)
        return torch.stack(steps, dim=1)

    def play(self, row: Row, table: Table) -> Floats32:
        """T - S [mm], shape (L, n, 3), of a table's sequence after the two skins that were before it."""
        inputs = self._inputs.of_sequence(row).astype(np.float32)
        flat = _motion(row)[:2].reshape(2, -1)
        z = ((flat - self._mean) @ self._modes.T / self._size).astype(np.float32)
        with torch.no_grad():
            steps = self._roll(torch.from_numpy(z[:1]), torch.from_numpy(z[1:]), torch.from_numpy(inputs)[None])
        moved: Floats32 = (steps[0].numpy() * self._size.astype(np.float32)) @ self._modes + self._mean
        return moved.reshape(len(inputs), -1, 3)


def _motion(row: Row) -> Floats32:
    """The two skins before a sequence, the earlier first, and its own, less S, shape (2 + L, n, 3) [mm]."""
    before = np.asarray(row["before"], dtype=np.float32)
    return np.concatenate([before[::-1], np.asarray(row["corrected"], dtype=np.float32)])


def _momentum(z: Floats) -> tuple[Floats, Floats]:
    """A and b of each component, by least squares over all steps."""
    last, moving, now = z[:, 1:-1], z[:, 1:-1] - z[:, :-2], z[:, 2:]
    aa, ab, bb = (
        np.einsum("qtk,qtk->k", one, other) for one, other in ((last, last), (last, moving), (moving, moving))
    )
    an, bn = (np.einsum("qtk,qtk->k", one, now) for one in (last, moving))
    ridge = 1e-6 * (aa + bb) + 1e-12
    matrix = np.stack([np.stack([aa + ridge, ab], axis=-1), np.stack([ab, bb + ridge], axis=-1)], axis=-2)
    ab_of = np.linalg.solve(matrix, np.stack([an, bn], axis=-1)[..., None])[..., 0]
    return ab_of[:, 0], ab_of[:, 1]
