"""SoftDECA's ablation without deformation gradients: z(w) times a matrix L(p, h) at each vertex, bound once."""

from __future__ import annotations

from functools import partial

import numpy as np

from ...lhm.base.mesh import Floats32, Surface
from ..corpus.face import KeptFace
from ..corpus.reading import Faces
from ..rigs.rig import WEIGHTS, CorrectedRig, Needs, silu
from .features import Inputs
from .layers import EVERY, Arrays, concatenate, einsum, linear, perceptron, perceptron_layers
from .trainer import Lesson, Tensors, Trainer, TrainerConfig, draw_layers, draw_positions, torch

LATENT, POSITION, WIDTH = 32, 16, 128
FRAMES, BATCH, VERTICES = 6000, 32, 512
TRAINING = TrainerConfig(seed=7, steps=1500, learning_rate=1e-3, weight_decay=0.01, clip=1.0)


class VerticesOnly(Lesson):
    """T - S = L₀(p, h, v) + Σ_k z_k(w) L_k(p, h, v), of w and the summary of p and h.

    Trained on vertices and frames drawn anew in each step, on the mean distance.
    """

    needs: Needs = "nothing"

    def __init__(self, config: TrainerConfig = TRAINING):
        self._config = config

    def fit(self, faces: Faces) -> None:
        """Train on at most FRAMES frames, about as many of each face."""
        self._inputs = Inputs.from_few(faces.mean, faces.codes)
        torch.manual_seed(self._config.seed)
        rng = np.random.default_rng(self._config.seed)
        each = max(1, FRAMES // max(len(faces), 1))
        weights, summaries, motions = [], [], []
        for index in range(len(faces)):
            frames = faces.frames(index, rng.permutation(len(faces.frames_of[index]))[:each])
            summary = self._inputs.summary_of(faces.face(index))
            weights.append(frames.weights)
            summaries.append(np.repeat(summary[None], len(frames.weights), axis=0))
            motions.append(frames.corrected)
        summary, self._motion = np.concatenate(summaries), np.concatenate(motions)
        step = max(1, len(self._motion) // 200)
        self._size = float(np.sqrt(np.mean(np.square(self._motion[::step], dtype=np.float32))))
        self._weights = torch.from_numpy(np.concatenate(weights))
        self._summaries = torch.from_numpy(summary)
        self.network = _draw(faces.mean, summary.shape[1], rng)
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
        answer = self.answer(self.network, bound, self._weights[rows])
        return ((answer - expected).square().sum(dim=-1) + 1e-6).sqrt().mean()

    def bound(self, network: Arrays, summary, vertices=EVERY):
        """Return L at some vertices, shape (b, v, 1 + LATENT, 3), of summaries (b, s)."""
        whole = perceptron(network, "whole", summary)[:, None]
        # The first layer of `local` in two parts, which add up: nothing is concatenated per vertex.
        first = network["local.0.weight"]
        hidden = whole @ first[:, :WIDTH].T + network["position"][vertices] @ first[:, WIDTH:].T
        answer = linear(network, "local.2", silu(hidden + network["local.0.bias"]))
        return answer.reshape(*answer.shape[:2], LATENT + 1, 3)

    def answer(self, network: Arrays, bound, weights):
        """Return T - S, (b, v, 3), of size one, for weights (b, 52) and L at some vertices."""
        latent = concatenate([0.0 * weights[:, :1] + 1.0, perceptron(network, "expression", weights)])
        return einsum("bk,bvkc->bvc", latent, bound)

    def bind(self, face: KeptFace) -> CorrectedRig:
        """Evaluate L, which depends on p and h alone."""
        bound = self.bound(self.arrays, self._inputs.summary_of(face)[None])
        return CorrectedRig(face.skin, face.shapes, partial(self._correct, bound))

    def _correct(self, bound: Floats32, weights: Floats32) -> Floats32:
        moved: Floats32 = self.answer(self.arrays, bound, weights[None])[0]
        return self._size * moved


def _draw(mean: Surface, summary: int, rng: np.random.Generator) -> Tensors:
    """Draw a network for the vertices of a mean skin and so many numbers of a summary."""
    network = draw_layers(perceptron_layers("expression", WEIGHTS, WIDTH, WIDTH, LATENT))
    network |= draw_layers(perceptron_layers("whole", summary, WIDTH, WIDTH))
    network["position"] = torch.from_numpy(draw_positions(mean.vertices, mean.vertex_normals, POSITION, rng))
    return network | draw_layers(perceptron_layers("local", WIDTH + POSITION, WIDTH, 3 * (LATENT + 1)))
