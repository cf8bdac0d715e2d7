"""SoftSMPL in motion (Santesteban et al. 2020), as SoftDECA compares with it: a GRU between its perceptron and J.

    e_t = MLP(w_t, p, h),    g_t = GRU(e_t, g_{t-1}),    J_t = I + last(g_t)

with the widths of the large static one. It begins with a state that follows from the two skins before a sequence.
As the paper says of it, dynamics live in a latent space and not at vertices; so p may not vary over the face.
"""

from __future__ import annotations

import numpy as np

from ...lhm.base.geometry.deformation import DeformationTransfer
from ...lhm.base.mesh import Floats32, Surface
from ..corpus.reading import Row, Table
from ..rigs.rig import Needs
from .components import find_components
from .features import Inputs
from .gradient_training import SparseTransfer, still_vertices
from .layers import elu, perceptron, perceptron_layers
from .softsmpl import LARGE
from .trainer import Lesson, Trainer, TrainerConfig, draw_layers, torch

BEFORE = 24
"""Principal components of the two skins before a sequence."""
SAMPLED = 64
"""Sequences, at most, of which what training begins with is made."""


class SoftSMPLInMotion(Lesson):
    """A method that learns from sequences and plays them."""

    needs: Needs = "nothing"

    def __init__(self, config: TrainerConfig | None = None, *, batch: int = 2):
        self._config = TrainerConfig(steps=1000, learning_rate=1e-3, clip=1.0) if config is None else config
        self._batch = batch

    def fit(self, table: Table) -> None:
        """Train on a corpus' sequences, read as batches need them."""
        config, self._table = self._config, table
        rng = np.random.default_rng(config.seed)
        torch.manual_seed(config.seed)
        codes = np.array([table.described(k)["code"] for k in range(len(table))], dtype=np.float64)
        self._inputs = Inputs.from_few(table.mean, codes)
        sample = [table[int(k)] for k in np.sort(rng.permutation(len(table))[:SAMPLED])]
        before = np.stack([row["before"].astype(np.float32).reshape(2, -1) for row in sample])
        self._begin, size = find_components(before.reshape(-1, before.shape[-1]), BEFORE, rng)
        self._begin /= np.maximum(size, 1e-3)[:, None].astype(np.float32)
        motion = np.concatenate([row["corrected"].astype(np.float32) for row in sample])
        self._transfer = _open_transfer(table.mean, motion)
        wide, latent = LARGE.expression, LARGE.latent
        layers = perceptron_layers("hidden", self._inputs.of_sequence(sample[0]).shape[1], wide, latent)
        layers |= {"begin": (latent, 2 * BEFORE), "last": (9 * len(table.mean.triangles), latent)}
        layers |= {"into": (3 * latent, latent), "again": (3 * latent, latent)}
        self.network = draw_layers(layers)
        for part in ("weight", "bias"):
            self.network[f"last.{part}"] *= 0.02
        for value in self.network.values():
            value.requires_grad_()
        trainer = Trainer(self, config)
        trainer.train()
        self.steps, self.curve = trainer.step, trainer.curve

    def loss(self, done: float, rng: np.random.Generator) -> torch.Tensor:
        """Return the mean distance [mm] over all frames of some sequences."""
        errors = []
        for k in rng.choice(len(self._table), size=min(self._batch, len(self._table)), replace=False):
            row = self._table[int(k)]
            away = self._answer(row, self._table) - torch.from_numpy(row["corrected"].astype(np.float32))
            errors.append(torch.linalg.vector_norm(away, dim=-1))
        return torch.stack([error.mean() for error in errors]).mean()

    def play(self, row: Row, table: Table) -> Floats32:
        """Return T - S [mm], shape (L, n, 3), of a table's sequence after the two skins that were before it."""
        with torch.no_grad():
            answer: Floats32 = self._answer(row, table).numpy()
        return answer

    def _answer(self, row: Row, table: Table) -> torch.Tensor:
        network = self.network
        inputs = torch.from_numpy(self._inputs.of_sequence(row).astype(np.float32))
        encoded = elu(perceptron(network, "hidden", inputs, elu))
        before = torch.from_numpy(row["before"].astype(np.float32).reshape(2, -1) @ self._begin.T).reshape(-1)
        state = torch.tanh(before @ network["begin.weight"].T + network["begin.bias"])
        cell = [network[f"{layer}.{part}"] for part in ("weight", "bias") for layer in ("into", "again")]
        states = []
        for now in encoded:
            state = torch.gru_cell(now[None], state[None], *cell)[0]
            states.append(state)
        gradients = torch.stack(states) @ network["last.weight"].T + network["last.bias"]
        person = table.person(int(row["identity"]))
        blended = (person.skin.vertices + np.tensordot(row["weights"], person.shapes, axes=1)).astype(np.float32)
        gradients = gradients.reshape(len(states), -1, 9)
        return self._transfer(gradients, torch.from_numpy(blended))


def _open_transfer(mean: Surface, motion: Floats32) -> SparseTransfer:
    return SparseTransfer(DeformationTransfer(mean, still_vertices(mean, motion), dtype=np.float32))
