"""A network trained by the energy itself, without a simulated frame (after Corigliano et al. 2025).

    x(w; p, h) = X + B w + U a(w, p, h),    loss: E(x) - E(X + B w)

E is the simulator's whole energy, of every tet, triangle and spring of a face; its gradient is the simulator's own, and
torch carries it on through U to the network. X is the settled neutral face. B moves the skin wrap by the person's own
shapes, and what lies below it as a mean of some faces' first order does. U are 128 displacements of all vertices:
principal components of what the same faces' first order has besides, turned so that all are equally stiff. So no frame
is solved, but the Hessian of six faces is, and `bind` takes the settled neutral face from the simulator. Bones turn
linearly, as B and U have them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError, SoftdecaError
from ...lhm.base.mesh import Floats, Floats32
from ...lhm.expressions import sample_weights
from ...lhm.head.head import LayeredHead
from ...reference.face.palsy import Springs, skin_activation
from ...reference.projective.terms.energy import Energy
from ...reference.projective.terms.springs import Springs as Drawn
from ..corpus.face import KeptFace
from ..corpus.reading import Faces
from ..rigs.rig import WEIGHTS, CorrectedRig, Needs
from .features import Inputs
from .layers import Arrays, concatenate, einsum, perceptron, perceptron_layers
from .ridge import find_components
from .trainer import Lesson, Trainer, TrainerConfig, draw_layers, torch


@dataclass(frozen=True)
class EnergyPolicy:
    """Constants of the network and of its displacements."""

    width: int = 128  # of hidden layers
    tables: int = 8  # of first order, that a summary of p and h mixes
    drawn: float = 0.02  # [mm] by which all springs are drawn out in the least energy that a loss of 1 means
    whitened: int = 4  # faces by whose mean stiffness the displacements are made equally stiff
    softest: float = 1e-5  # stiffness over the largest
    step: float = 1e-3  # [mm] of the differences
    tried: int = 4  # expressions by which a face's energies are made alike
    quiet: float = 0.02  # of the usual weights, in layers that begin near zero
    mixed: float = 0.1  # size of the tables in the beginning, over the mean size of amplitudes


POLICY = EnergyPolicy()
"""The constants as they were measured."""


@dataclass(frozen=True)
class EnergyTraining(TrainerConfig):
    """Options of one training, each with its reason."""

    steps: int = 1000
    learning_rate: float = 2e-3
    clip: float | None = 1.0
    batch: int = 4  # expressions a step: each is the energy of a whole head
    faces: int = 16  # that are settled for it, 4 s each on the default head
    differentiated: int = 6  # of these, whose first order gives the displacements
    modes: int = 128
    validate_every: int = 100


@dataclass(frozen=True, eq=False)
class _Scene:
    """A settled face's energy: columns of B (52, n, 3), and how the springs' ends move by each weight (52, k, 3).

    unit [µJ]: the energy that a loss of 1 means, about what expressions have by B w alone.
    """

    summary: Floats32
    energy: Energy
    base: Floats32
    ends: Floats32
    start: Floats
    unit: float

    def of(self, weights: Floats32) -> Energy:
        """Return the energy of an expression."""
        moved = np.tensordot(weights, self.ends, axes=1)
        return Energy(tuple(part.shift(moved) if isinstance(part, Drawn) else part for part in self.energy.parts))


class EnergyTrained(Lesson):
    """A method whose network has seen no simulated frame; a bind needs a head."""

    needs: Needs = "simulator"

    def __init__(self, config: EnergyTraining | None = None, policy: EnergyPolicy = POLICY):
        self._policy = policy
        self._config = EnergyTraining() if config is None else config

    def fit(self, faces: Faces) -> None:
        """Train on random expressions of some training faces; InputError where fewer than two settle."""
        config, policy, rng = self._config, self._policy, np.random.default_rng(self._config.seed)
        self._inputs = Inputs.from_faces(faces)
        settled = list(self._settle(faces, rng))
        if len(settled) < 2:
            raise InputError(f"training by the energy: {len(settled)} faces of {faces.folder} settle; 2 are needed")
        self._scenes = self._prepare(settled, rng)
        summaries = np.stack([scene.summary for scene in self._scenes])
        self._mean, self._scale = summaries.mean(axis=0), np.maximum(summaries.std(axis=0), 0.1)
        torch.manual_seed(config.seed)
        layers = perceptron_layers("bent", WEIGHTS + len(self._mean), policy.width, policy.width, config.modes)
        layers |= perceptron_layers("gain", len(self._mean), policy.width, config.modes)
        layers |= perceptron_layers("offset", len(self._mean), policy.width, config.modes)
        layers |= perceptron_layers("mix", len(self._mean), policy.width, policy.tables)
        self.network = draw_layers(layers)
        for name in ("bent.4", "gain.2", "offset.2"):
            for part in ("weight", "bias"):
                self.network[f"{name}.{part}"] *= policy.quiet
        self.network["tables"] = policy.mixed * torch.randn(policy.tables, WEIGHTS, config.modes)
        self.network["linear"] = torch.from_numpy(self._first / self._size)
        self.network["still"] = torch.from_numpy(self._still / self._size)
        for value in self.network.values():
            value.requires_grad_()
        trainer = Trainer(self, config)
        trainer.train()
        self.steps, self.arrays, self.curve = trainer.step, trainer.arrays(), trainer.curve
        del self._scenes, self.network

    def _settle(self, faces: Faces, rng: np.random.Generator):
        for index in rng.permutation(len(faces))[: self._config.faces]:
            face = faces.face(int(index))
            try:
                settled = face.live.settled()
            except SoftdecaError:
                continue
            if settled.converged:
                yield face

    def _prepare(self, settled: list[KeptFace], rng: np.random.Generator) -> list[_Scene]:
        """Make B, U and the first guess of its amplitudes from some faces' first order; and every face's energy."""
        config, policy, wrap = self._config, self._policy, len(settled[0].live.head.bone)
        known = settled[: config.differentiated]
        moves, offsets, like = [], [], None
        for face in known:
            # A copy, so that its factors, a quarter of a gigabyte, are forgotten before the next.
            live = replace(face.live, like=like).settled_as(face.live.settled())
            offsets.append((live.derivatives.answer.positions - live.settled().positions).astype(np.float32))
            moves.append(live.first_order.astype(np.float32))
            like = live.derivatives.analysis
        below = np.mean([move[:, wrap:] for move in moves], axis=0)
        tried = np.array([sample_weights(rng) for _ in range(policy.tried)], dtype=np.float32)
        scenes = [_scene(self._inputs, face, below, tried, policy.drawn) for face in settled]
        rest = [move - scene.base for move, scene in zip(moves, scenes, strict=False)]
        stacked = np.concatenate([*rest, np.stack(offsets)]).reshape(-1, rest[0][0].size)
        components, _ = find_components(stacked, config.modes, rng)
        stiffness = np.mean([_stiffness(scene, components, policy.step) for scene in scenes[: policy.whitened]], axis=0)
        values, turn = np.linalg.eigh(stiffness)
        roots = np.sqrt(np.maximum(values, policy.softest * values[-1]))[:, None]
        self._modes = (turn.T @ components / roots).astype(np.float32)
        amplitudes = (stacked @ components.T @ turn * roots.T).astype(np.float32)
        self._size = np.float32(np.sqrt(np.mean(np.square(amplitudes))))
        self._first = amplitudes[: WEIGHTS * len(rest)].reshape(len(rest), WEIGHTS, -1).mean(axis=0)
        self._still = amplitudes[WEIGHTS * len(rest) :].mean(axis=0)
        return scenes

    def loss(self, done: float, rng: np.random.Generator) -> torch.Tensor:
        """Return the mean energy of random expressions over that of B w, in each face's unit."""
        picked = rng.integers(len(self._scenes), size=self._config.batch)
        scenes = [self._scenes[k] for k in picked]
        weights = np.array([sample_weights(rng) for _ in picked], dtype=np.float32)
        summaries = np.stack([(scene.summary - self._mean) / self._scale for scene in scenes]).astype(np.float32)
        amplitudes = amplitudes_of(self.network, torch.from_numpy(weights), torch.from_numpy(summaries))
        moved = amplitudes * float(self._size)
        energies = [
            _EnergyAlong.apply(a, scene, w, self._modes) for a, scene, w in zip(moved, scenes, weights, strict=True)
        ]
        return torch.stack(energies).mean()

    def bind(self, face: KeptFace) -> CorrectedRig:
        """Take the settled neutral face of the corpus and the head's own map from wrap to skin."""
        head = face.live.head
        still, active = face.displacement.astype(np.float32), skin_activation(head, face.live.on_wraps)
        summary = ((self._inputs.summary_of(face) - self._mean) / self._scale).astype(np.float32)
        modes = self._weigh_on_skin(head) * self._size
        held = None if active is None else ((active - 1.0) * face.shapes).astype(np.float32)

        def correct(weights: Floats32) -> Floats32:
            amplitudes = amplitudes_of(self.arrays, weights[None], summary[None])[0]
            moved = still + np.tensordot(amplitudes, modes, axes=1)
            return moved if held is None else moved + np.tensordot(weights, held, axes=1)

        return CorrectedRig(face.skin, face.shapes, correct)

    def _weigh_on_skin(self, head: LayeredHead) -> Floats32:
        wrap = self._modes.reshape(len(self._modes), -1, 3)[:, : len(head.bone)]
        return np.stack([head.skin_from_wrap @ mode for mode in wrap]).astype(np.float32)


def amplitudes_of(network: Arrays, weights, summary):
    """Return a(w, p, h) over its sizes, shape (b, modes), of weights (b, 52) and normalised summaries (b, s)."""
    gains = 1.0 + perceptron(network, "gain", summary)
    mixed = einsum("bm,mjk->bjk", perceptron(network, "mix", summary), network["tables"])
    first = gains * (weights @ network["linear"]) + einsum("bj,bjk->bk", weights, mixed)
    still = network["still"] + perceptron(network, "offset", summary)
    return first + still + perceptron(network, "bent", concatenate([weights, summary]))


def _scene(inputs: Inputs, face: KeptFace, below: Floats32, tried: Floats32, drawn_mm: float) -> _Scene:
    live = face.live
    head, scene = live.head, live.neutral_scene()
    springs = Springs.from_head(head, live.on_wraps)
    drawn = live.shapes if live.activation is None else live.activation * live.shapes
    above = np.stack([head.wrap_from_skin @ shape for shape in drawn])
    energy = Energy.from_scene(scene)
    made = _Scene(
        summary=inputs.summary_of(face),
        energy=energy,
        base=np.concatenate([above, below], axis=1).astype(np.float32),
        ends=live.goals.astype(np.float32),
        start=live.settled().positions - scene.vertices,
        unit=0.5 * float(np.sum(springs.stiffness)) * drawn_mm**2,
    )
    still = energy.evaluate(made.start)[0]
    above_rest = [made.of(w).evaluate(made.start + np.tensordot(w, made.base, axes=1))[0] - still for w in tried]
    return replace(made, unit=made.unit + float(np.mean(np.abs(above_rest))))


def _stiffness(scene: _Scene, modes: Floats32, difference: float) -> Floats:
    """Return the second derivatives of a neutral face's energy along modes, by differences [mm], in its unit."""
    rest = scene.energy.evaluate(scene.start)[1].reshape(-1)
    rows = []
    for mode in modes.astype(np.float64):
        step = difference / np.abs(mode).max()
        ahead = scene.energy.evaluate(scene.start + step * mode.reshape(scene.start.shape))[1].reshape(-1)
        rows.append(modes @ (ahead - rest) / (step * scene.unit))
    matrix = np.array(rows)
    return 0.5 * (matrix + matrix.T)


class _EnergyAlong(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, amplitudes, scene: _Scene, weights, modes):
        before = scene.start + np.tensordot(weights, scene.base, axes=1)
        moved = before + (amplitudes.detach().numpy() @ modes).reshape(before.shape)
        energy = scene.of(weights)
        value, gradient = energy.evaluate(moved)
        ctx.pulled = torch.from_numpy((modes @ gradient.reshape(-1).astype(np.float32)) / np.float32(scene.unit))
        return torch.tensor((value - energy.evaluate(before)[0]) / scene.unit, dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, *cotangents):
        return cotangents[0] * ctx.pulled, None, None, None
