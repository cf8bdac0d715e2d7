"""Training: a config, a visible loop, a checkpoint that carries what it was made with."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.geometry.deformation import DeformationTransfer
from ...lhm.base.progress import OnProgress, silent
from ..learning import keep_state, kept_state, torch
from .anchors import still_vertices
from .checkpoint import Checkpoint, HypernetworkConfig, TrainingPoint, TrainingSummary
from .hypernetwork import Hypernetwork, smooth_positions, transfer_delta
from .principal import principal_gradients
from .samples import Samples


@dataclass(frozen=True)
class TrainConfig:
    """Options of one training, each with its reason."""

    network: HypernetworkConfig = field(default_factory=HypernetworkConfig)
    seed: int = 0
    steps: int = 3200  # the learning rate's decay ends here
    batch: int = 8  # frames per step; a larger one takes proportionally longer on a CPU
    learning_rate: float = 6e-3  # of AdamW, after 20 steps' warm-up
    final_rate: float = 1e-4
    weight_decay: float = 0.3  # AdamW; a few hundred frames overfit without
    gradient_weight: float = 100.0  # mm per squared gradient error: teaches faces that the vertex term sees late
    validation_identities: float = 0.05  # share held out, to choose the best step: more of them teach than judge
    validate_every: int = 100
    seconds: float = 900.0  # for slow machines: beyond it the best checkpoint so far is kept


STUDY = TrainConfig()


class _Frames:
    """Samples as tensors, normalised."""

    def __init__(self, samples: Samples, mean, scale):
        self.codes = torch.from_numpy(((samples.codes - mean) / scale).astype(np.float32))
        self.weights = torch.from_numpy(samples.weights)
        self.parameters = torch.from_numpy(samples.normalised_parameters())
        self.blended = torch.from_numpy(samples.blended)
        self.simulated = torch.from_numpy(samples.simulated)

    def __len__(self) -> int:
        return len(self.codes)


def train(
    samples: Samples,
    config: TrainConfig = STUDY,
    *,
    state: str | PathLike[str] | None = None,
    on_progress: OnProgress = silent,
) -> Checkpoint:
    """Fit a hypernetwork to simulated frames and return the checkpoint of the best validation error.

    With `state`, a file, the training is kept there now and then and goes on from there when called again.
    Raises InputError for fewer than two identities and for a state of another training.
    """
    training, validation = split_identities(samples, config)
    mean = training.codes.mean(axis=0).astype(np.float64)
    # All of a code counts as much as one parameter: with fewer people than coefficients it is mostly learnt by heart.
    scale = training.codes.shape[1] * np.maximum(training.codes.std(axis=0), 1e-6).astype(np.float64)
    loop = _Loop(_Frames(training, mean, scale), _Frames(validation, mean, scale), training, config)
    if state is not None and Path(state).is_file():
        loop.restore(state)
    while loop.step < config.steps and loop.seconds < config.seconds:
        loop.run(min(config.validate_every, config.steps - loop.step))
        if state is not None:
            loop.keep(state)
        last = loop.history[-1]
        on_progress(f"training: {last.validation_mm:.4f} mm on held-out identities", loop.step / config.steps)
    return Checkpoint(
        space=samples.space,
        reference=samples.reference,
        anchors=loop.anchors,
        parameter_names=samples.parameter_names,
        code_mean=mean,
        code_scale=scale,
        config=config.network,
        network={name: value.numpy() for name, value in loop.best.items()},
        summary=TrainingSummary(
            frames=len(training),
            identities=len(np.unique(training.identity)),
            steps=loop.step,
            seconds=loop.seconds,
            validation_mm=loop.best_error,
            validation_blendshapes_mm=_mean_distance(loop.validation.blended, loop.validation.simulated),
            history=tuple(loop.history),
        ),
    )


class _Loop:
    """The state of a training between two steps."""

    def __init__(self, frames: _Frames, validation: _Frames, training: Samples, config: TrainConfig):
        self.frames, self.validation, self.config = frames, validation, config
        torch.manual_seed(config.seed)
        reference = training.reference
        positions = smooth_positions(reference, config.network.position, np.random.default_rng(config.seed))
        self.network = Hypernetwork(
            config.network,
            code_size=training.codes.shape[1],
            n_parameters=len(training.parameter_names),
            table=principal_gradients(training, config.network.latent),
            positions=positions,
        )
        self.anchors = still_vertices(training)
        self.transfer = DeformationTransfer(reference, self.anchors, dtype=np.float32)
        self.triangles = torch.from_numpy(reference.triangles.copy())
        self.stiffness = torch.from_numpy(self.transfer.stiffness / reference.areas.sum()).float()
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay
        )
        self.step, self.seconds, self.best_error = 0, 0.0, float("inf")
        self.best = self._copy()
        self.history: list[TrainingPoint] = []

    def run(self, steps: int):
        """Some steps, then a look at the held-out identities; the network is kept if it is the best so far."""
        begin, errors = time.perf_counter(), []
        for _ in range(steps):
            errors.append(self.advance())
        error = self.validate()
        if error < self.best_error:
            self.best_error, self.best = error, self._copy()
        self.seconds += time.perf_counter() - begin
        self.history.append(TrainingPoint(self.step, self.seconds, float(np.mean(errors)), error))

    def advance(self) -> float:
        """One step of AdamW on the next batch; returns the batch's mean vertex error [mm]."""
        config = self.config
        for group in self.optimiser.param_groups:
            group["lr"] = _rate(self.step, config)
        index = torch.from_numpy(_batch(self.step, len(self.frames), config))
        blended, simulated = self.frames.blended[index], self.frames.simulated[index]
        gradients = self.network(self.frames.weights[index], self.frames.codes[index], self.frames.parameters[index])
        delta = transfer_delta(gradients, blended, self.transfer)
        vertex = torch.linalg.vector_norm(delta + blended - simulated, dim=-1).mean()
        loss = vertex + config.gradient_weight * self._gradient_error(gradients, blended, simulated)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.optimiser.step()
        self.step += 1
        return float(vertex.detach())

    def _gradient_error(self, gradients, blended, simulated):
        """Mean squared (J - I) G S - G (T - S), which has no degenerate faces as |J - J*|² has."""
        edges, wanted = self._edges(blended), self._edges(simulated - blended)
        u, v = (gradients.view(*gradients.shape[:2], 3, 3) @ edges - wanted).unbind(-1)
        c11, c12, c22 = self.stiffness.unbind(-1)
        per_face = c11 * (u * u).sum(-1) + 2.0 * c12 * (u * v).sum(-1) + c22 * (v * v).sum(-1)
        return per_face.sum(-1).mean()

    def _edges(self, positions):
        corners = positions[:, self.triangles]
        return (corners[:, :, 1:] - corners[:, :, :1]).transpose(-1, -2)

    def validate(self) -> float:
        """Mean vertex error [mm] on the held-out identities."""
        error, frames = 0.0, self.validation
        with torch.no_grad():
            for part in torch.arange(len(frames)).split(self.config.batch):
                gradients = self.network(frames.weights[part], frames.codes[part], frames.parameters[part])
                answer = frames.blended[part] + transfer_delta(gradients, frames.blended[part], self.transfer)
                error += _mean_distance(answer, frames.simulated[part]) * len(part) / len(frames)
        return error

    def _copy(self) -> dict[str, torch.Tensor]:
        return {name: value.detach().clone() for name, value in self.network.state_dict().items()}

    def keep(self, path):
        """Write all that `restore` needs, whole or not at all."""
        state = {
            "of": repr(self.config),
            "step": self.step,
            "seconds": self.seconds,
            "history": [asdict(point) for point in self.history],
            "network": self.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "best": self.best,
            "best_error": self.best_error,
        }
        keep_state(path, state)

    def restore(self, path):
        """Go on where `keep` was called last; InputError for a file of another training."""
        state = kept_state(path, repr(self.config))
        self.network.load_state_dict(state["network"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step, self.seconds = state["step"], state["seconds"]
        self.best, self.best_error = state["best"], state["best_error"]
        self.history = [TrainingPoint(**point) for point in state["history"]]


def _rate(step: int, config: TrainConfig) -> float:
    decay = 0.5 * (1.0 + np.cos(np.pi * step / config.steps))
    rate = config.final_rate + (config.learning_rate - config.final_rate) * decay
    return float(rate * min(1.0, (step + 1) / 20))


def _batch(step: int, count: int, config: TrainConfig) -> np.ndarray:
    """The step's frames: each epoch is a permutation drawn from seed and epoch, so a resumed training sees the same."""
    per_epoch = max(count // config.batch, 1)
    epoch, position = divmod(step, per_epoch)
    order = np.random.default_rng([config.seed, epoch]).permutation(count)
    return order[position * config.batch : (position + 1) * config.batch]


def _mean_distance(a, b) -> float:
    return float(torch.linalg.vector_norm(a - b, dim=-1).mean())


def split_identities(samples: Samples, config: TrainConfig) -> tuple[Samples, Samples]:
    """Training and validation frames, which share no identity."""
    people = np.unique(samples.identity)
    if len(people) < 2:
        raise InputError(f"training needs frames of at least two identities, there are {len(people)}")
    held = max(1, round(config.validation_identities * len(people)))
    chosen = np.random.default_rng(config.seed).permutation(people)[:held]
    out = np.isin(samples.identity, chosen)
    return samples.take(~out), samples.take(out)
