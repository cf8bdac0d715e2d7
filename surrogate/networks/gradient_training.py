"""Training of networks of deformation gradients: the loss of Eq. 16 through the transfer, and the paper's protocol.

| name           | form                                   | protocol                                     |
|----------------|----------------------------------------|----------------------------------------------|
| hyper          | the hypernetwork with tables and gains | from a regression on, quick                  |
| paper          | the hypernetwork as it is printed      | the paper's, 200,000 steps of 128 frames     |
| softsmpl-small | one perceptron, the paper's widths     | the paper's                                  |
| softsmpl-large | one perceptron, wider                  | the paper's                                  |
| face-wise      | one perceptron at every face           | the paper's                                  |

Options stop a training earlier; nothing else does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.geometry.deformation import DeformationTransfer
from ...lhm.base.geometry.topology import connected_parts
from ...lhm.base.mesh import Floats32, Ints, Surface
from ...lhm.base.progress import OnProgress, silent
from ..corpus.reading import Faces
from .features import Features, Inputs, seen_ranges
from .forms import FORMS
from .frames import FrameBatch, FrameSource
from .gradient_start import LEAST_MOTION, regress
from .gradients import HELD, GradientForm, Sizes, Widths
from .softsmpl import LARGE, SMALL
from .trainer import (
    Lesson,
    Tensors,
    Trainer,
    TrainerConfig,
    draw_layers,
    draw_positions,
    hold_out_people,
    open_device,
    torch,
)
from .weights import TrainingNote, Weights

SAMPLED, JUDGED = 400, 200
"""Frames that tell which vertices stand still, and those of held-out people by which a training is judged, at most."""


@dataclass(frozen=True)
class GradientTraining(TrainerConfig):
    """Options of one training, each with its reason: those of our hypernetwork."""

    form: str = "hypernetwork"
    network: Widths = field(default_factory=lambda: Widths(latent=64, hidden=96, position=48))
    steps: int = 3000
    batch: int = 24  # frames per step; a larger one takes proportionally longer on a CPU
    frames: int = 6  # of one face among these, for which p and h are evaluated once
    fields: bool = True  # faces under p that vary over them teach, too
    in_own_size: bool = True  # errors count in shares of how far a frame is from carried blendshapes
    learning_rate: float = 3e-3
    warm_up: int = 100
    final_rate: float = 1e-4
    weight_decay: float = 0.01
    clip: float | None = 1.0
    validation: float = 0.05  # share of people held out, to choose the best step: more of them teach than judge
    validate_every: int = 200
    best_by: str = "share"


def follow_paper(form: str, widths: Widths) -> GradientTraining:
    """Return the paper's protocol (4.2.1): Adam, 200,000 steps of 128, the rate from 1e-4 down to 5e-5 on a line.

    The loss is Eq. 16 alone. Sixteen faces with eight frames each make a batch, since p and h are dear.
    """
    return GradientTraining(
        form=form, network=widths, steps=200_000, batch=128, frames=8, fields=False,
        in_own_size=False, learning_rate=1e-4, final_rate=5e-5, falls="line", warm_up=1, weight_decay=0.0, clip=None,
        best_by="network",
    )  # fmt: skip


NETWORKS: Mapping[str, GradientTraining] = {
    "hyper": GradientTraining(),
    "paper": follow_paper("printed hypernetwork", Widths(hidden=128)),
    "softsmpl-small": follow_paper("softsmpl", SMALL),
    "softsmpl-large": follow_paper("softsmpl", LARGE),
    "face-wise": follow_paper("face-wise", Widths(hidden=64)),
}
"""Trainings by the name that a command knows."""


def with_batch(config: GradientTraining, batch: int) -> GradientTraining:
    """Return the training with so many frames a step, of at least four faces where there are as many frames."""
    most = min(config.frames, max(1, batch // 4))
    frames = max(k for k in range(1, most + 1) if batch % k == 0)
    return replace(config, batch=batch, frames=frames)


def train_gradients(
    faces: Faces,
    config: GradientTraining | None = None,
    *,
    state: str | PathLike[str] | None = None,
    on_progress: OnProgress = silent,
) -> Weights:
    """Fit a network to a corpus' training frames; return the weights of least error on held-out people.

    Frames are read as batches need them. With `state`, a file, the training is kept there now and then and goes on from
    there when called again. Raises InputError for fewer than two people, a device that is not there, a loss that is
    not finite, and for a state of another training.
    """
    config = GradientTraining() if config is None else config
    lesson = GradientLesson(faces, config)
    trainer = Trainer(lesson, config)
    trainer.train(state, on_progress)
    return lesson.weights(trainer)


class GradientLesson(Lesson):
    """A form's tensors, the loss of a batch of frames, and the error on those of held-out people."""

    def __init__(self, faces: Faces, config: GradientTraining):
        if config.frames < 1 or config.batch % config.frames:
            raise InputError(f"training batch {config.batch}: expected a multiple of {config.frames} frames of a face")
        self.faces, self.config, self.form = faces, config, FORMS[config.form]
        self.device = open_device(config.device)
        people = np.unique(faces.groups[:, 0])
        if len(people) < 2:
            raise InputError(f"training needs frames of at least two people, there are {len(people)}")
        self.held = hold_out_people(people, config.validation, np.random.default_rng(config.seed))
        is_held = np.isin(faces.groups[:, 0], self.held)
        self.training = np.flatnonzero(~is_held)
        self.source = FrameSource(faces, self.training, fields=config.fields)
        codes = self.source.codes
        mean = codes.mean(axis=0).astype(np.float64)
        # All of a code counts as much as one parameter: with fewer people than numbers it is mostly learnt by heart.
        scale = 0.5 * codes.shape[1] * np.maximum(codes.std(axis=0), 1e-6).astype(np.float64)
        self.inputs = Inputs(Features(faces.mean), mean, scale)
        self.seen = seen_ranges(faces, self.training, self.inputs.features)
        self.followed = np.ptp(self.source.coefficients[:, :, 0], axis=0) > 0.0
        torch.manual_seed(config.seed)
        rng = np.random.default_rng([config.seed, 2])
        sample = self.source.sample(SAMPLED, rng)
        anchors = still_vertices(faces.mean, sample.simulated - sample.blended)
        self.network = self._start(sample, anchors)
        transfer = DeformationTransfer(faces.mean, anchors, dtype=np.float32)
        self.transfer = open_differentiable(transfer, self.device)
        held = FrameSource(faces, np.flatnonzero(is_held), fields=config.fields)
        self.judged = self._tensors(held.sample(JUDGED, rng), 1)
        self.about = [f"{len(faces)} faces"]

    def _start(self, sample: FrameBatch, anchors: Ints) -> Tensors:
        config = self.config
        network = draw_form(self.form, config, self.faces.mean, sample.codes.shape[1], self.followed)
        if "responses" in network:
            rng, parameters = np.random.default_rng([config.seed, 3]), self.inputs.features.at_vertices
            begun = regress(self.faces, self.training, parameters, self.followed, config.network.latent, rng)
            network |= {name: torch.from_numpy(value).reshape(network[name].shape) for name, value in begun.items()}
        network["anchored"][anchors] = 1.0
        network = {name: value.to(self.device) for name, value in network.items()}
        for name, value in network.items():
            value.requires_grad_(name not in HELD)
        return network

    def _tensors(self, batch: FrameBatch, frames: int) -> tuple[torch.Tensor, ...]:
        """Weights (g, m, 52), codes (g, c), parameters (g, 1 or faces, k), S and T (g m, n, 3), m frames a face."""
        codes = np.array([self.inputs.code(code) for code in batch.codes[::frames]]).astype(np.float32)
        weights = batch.weights.reshape(len(codes), frames, -1)
        parts = weights, codes, self._parameters(batch.coefficients[::frames]), batch.blended, batch.simulated
        return tuple(torch.from_numpy(np.ascontiguousarray(part)).to(self.device) for part in parts)

    def _parameters(self, coefficients: Floats32) -> Floats32:
        """Return p mapped to [-1, 1], shape (g, 1, k), or (g, faces, k) where some varies over the face."""
        if not self.config.fields or not coefficients[..., 1:].any():
            return np.clip(coefficients[:, None, self.followed, 0], -1.0, 1.0)
        features, triangles = self.inputs.features, self.faces.mean.triangles
        rows = [features.at_vertices(each)[:, self.followed][triangles].mean(axis=1) for each in coefficients]
        return np.stack(rows).astype(np.float32)

    def loss(self, done: float, rng: np.random.Generator) -> torch.Tensor:
        """Return the mean error of a batch's vertices (Eq. 16) [mm], or in shares of each frame's own size."""
        config = self.config
        batch = self.source.draw(config.batch // config.frames, config.frames, rng)
        weights, codes, parameters, blended, simulated = self._tensors(batch, config.frames)
        gradients = self.form.gradients(self.network, weights, codes, parameters).flatten(0, 1)
        delta = self.transfer(gradients, blended)
        error = torch.linalg.vector_norm(delta + blended - simulated, dim=-1).mean(dim=-1)
        if config.in_own_size:
            error = error / (torch.linalg.vector_norm(simulated - blended, dim=-1).mean(dim=-1) + LEAST_MOTION)
        return error.mean()

    def errors(self) -> dict[str, float]:
        """Return errors on held-out people: of the network and of T = S, carried, [mm], and the network's share."""
        weights, codes, parameters, blended, simulated = self.judged
        sums = {"network": 0.0, "blendshapes": 0.0, "share": 0.0}
        with torch.no_grad():
            for part in torch.arange(len(weights)).split(8):
                gradients = self.form.gradients(self.network, weights[part], codes[part], parameters[part])
                moved = simulated[part] - blended[part]
                delta = self.transfer(gradients.flatten(0, 1), blended[part])
                missed, motion = (torch.linalg.vector_norm(x, dim=-1).mean(dim=-1) for x in (delta - moved, moved))
                parts = missed, motion, missed / (motion + LEAST_MOTION)
                for name, error in zip(sums, parts, strict=True):
                    sums[name] += float(error.sum()) / len(weights)
        return sums

    def weights(self, trainer: Trainer) -> Weights:
        """Return the trained network with what it was made from."""
        note = TrainingNote(
            people=len(self.source.people),
            faces=len(self.source.face),
            frames=len(self.source),
            neutrals=0,
            steps=trainer.step,
            config=asdict(self.config),
            curve=tuple(trainer.curve),
            seen=self.seen,
            held=tuple(self.held.tolist()),
        )
        return Weights(
            self.form.kind, self.faces.space, self.faces.mean, self.inputs.code_mean, self.inputs.code_scale,
            trainer.arrays(), note,
        )  # fmt: skip


def draw_form(form: GradientForm, config: GradientTraining, mean: Surface, code_size: int, followed) -> Tensors:
    """Draw a network of a form that follows some of STATIC, a mask; tables but π's are zero, and no vertex is held."""
    sizes = Sizes(config.network, len(mean.vertices), len(mean.triangles), code_size, int(followed.sum()))
    network = draw_layers(form.layers(sizes), form.without_bias)
    for name, share in form.quiet.items():
        network[name] *= share
    network |= {name: torch.zeros(shape) for name, shape in form.tables(sizes).items()}
    if "position" in network:
        centres, rng = mean.vertices[mean.triangles].mean(axis=1), np.random.default_rng(config.seed)
        positions = draw_positions(centres, mean.face_normals, config.network.position, rng)
        network["position"] = torch.from_numpy(positions)
    network["followed"] = torch.from_numpy(followed.astype(np.float32))
    network["anchored"] = torch.zeros(len(mean.vertices))
    return network


class _Transfer(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, gradients, blended, transfer: DeformationTransfer):
        ctx.blended, ctx.transfer = blended.detach().numpy(), transfer
        delta = transfer.delta(np.ascontiguousarray(gradients.detach().numpy()), ctx.blended)
        return torch.from_numpy(np.ascontiguousarray(delta))

    @staticmethod
    def backward(ctx: Any, *cotangents):
        pulled = ctx.transfer.pull_back(cotangents[0].numpy(), ctx.blended)
        return torch.from_numpy(pulled), None, None


@dataclass(frozen=True, eq=False)
class SparseTransfer:
    """`DeformationTransfer.delta` as a torch operation: its backward pass is a solve with the same factor."""

    transfer: DeformationTransfer

    def __call__(self, gradients: torch.Tensor, blended: torch.Tensor) -> torch.Tensor:
        """Return x - S [mm], shape (batch, n, 3), of J - I (batch, m, 9) and S (batch, n, 3)."""
        return _Transfer.apply(gradients, blended, self.transfer)


@dataclass(frozen=True, eq=False)
class DenseTransfer:
    """The same by a dense factor of torch, on any device: 80 MB for the default skin."""

    transfer: DeformationTransfer
    device: torch.device

    @cached_property
    def _parts(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """K's factor, the triangles, and their stiffness as (m, 2, 2)."""
        c11, c12, c22 = torch.from_numpy(self.transfer.stiffness.copy()).to(self.device).unbind(-1)
        both = torch.stack([torch.stack([c11, c12], -1), torch.stack([c12, c22], -1)], -2)
        factor = torch.linalg.cholesky(torch.from_numpy(self.transfer.matrix.toarray()).to(self.device))
        return factor, torch.from_numpy(self.transfer.triangles.astype(np.int64)).to(self.device), both

    def __call__(self, gradients: torch.Tensor, blended: torch.Tensor) -> torch.Tensor:
        """Return x - S [mm]; see `SparseTransfer`."""
        factor, triangles, stiffness = self._parts
        corners = blended[:, triangles]
        edges = (corners[:, :, 1:] - corners[:, :, :1]).transpose(-1, -2)
        pulls = (gradients.unflatten(-1, (3, 3)) @ edges @ stiffness).transpose(-1, -2)
        forces = torch.zeros_like(blended)
        for corner, pull in enumerate((-pulls.sum(dim=2), pulls[:, :, 0], pulls[:, :, 1])):
            forces = forces.index_add(1, triangles[:, corner], pull)
        flat = forces.transpose(0, 1).flatten(1)
        return torch.cholesky_solve(flat, factor).unflatten(1, (len(blended), 3)).transpose(0, 1)


def open_differentiable(transfer: DeformationTransfer, device: torch.device) -> SparseTransfer | DenseTransfer:
    """Return the transfer as a torch operation, by the solver that the device has."""
    return SparseTransfer(transfer) if device.type == "cpu" else DenseTransfer(transfer, device)


def still_vertices(reference: Surface, moved: Floats32, share: float = 0.05) -> Ints:
    """Find the transfer's anchors: vertices that T - S (N, n, 3) moves least, `share` of each connected part's."""
    motion = np.sqrt((moved**2).sum(axis=2).mean(axis=0))
    count, part = connected_parts(reference.triangles, len(motion))
    still = []
    for number in range(count):
        members = np.flatnonzero(part == number)
        still.append(members[np.argsort(motion[members], kind="stable")[: max(1, round(share * len(members)))]])
    return np.sort(np.concatenate(still))
