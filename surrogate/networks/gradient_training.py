"""Training of networks of deformation gradients: the loss of Eq. 16 through the transfer, and the paper's protocol.

| name           | form                                   | protocol                                     |
|----------------|----------------------------------------|----------------------------------------------|
| hyper          | the hypernetwork with a table and gains | thousands of steps of few frames: minutes   |
| paper          | the hypernetwork as it is printed      | the paper's, 200,000 steps of 128 frames     |
| softsmpl-small | one perceptron, the paper's widths     | the paper's                                  |
| softsmpl-large | one perceptron, wider                  | the paper's                                  |
| face-wise      | one perceptron at every face           | the paper's                                  |

Options stop a training earlier; nothing else does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
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
    start_processes,
    torch,
)
from .weights import TrainingNote, Weights

FLOOR = 1e-4
"""Added to each squared singular value of a face's edges, relative to their sum: lids that close flatten faces."""
SAMPLED, JUDGED = 400, 200
"""Frames by which a training begins, and those of held-out people by which it is judged, at most."""


@dataclass(frozen=True)
class GradientTraining(TrainerConfig):
    """Options of one training, each with its reason: those of our hypernetwork."""

    form: str = "hypernetwork"
    network: Widths = field(default_factory=Widths)
    steps: int = 3200
    batch: int = 8  # frames per step; a larger one takes proportionally longer on a CPU
    frames: int = 1  # of one face among these, for which p and h are evaluated once
    learning_rate: float = 6e-3
    warm_up: int = 20
    final_rate: float = 1e-4
    weight_decay: float = 0.3  # a few hundred frames overfit without
    gradient_weight: float = 100.0  # mm per squared gradient error: teaches faces that the vertex term sees late
    validation: float = 0.05  # share of people held out, to choose the best step: more of them teach than judge
    validate_every: int = 100
    best_by: str = "network"


def follow_paper(form: str, widths: Widths) -> GradientTraining:
    """Return the paper's protocol (4.2.1): Adam, 200,000 steps of 128, the rate from 1e-4 down to 5e-5 on a line.

    The loss is Eq. 16 alone. Sixteen faces with eight frames each make a batch, since p and h are dear.
    """
    return GradientTraining(
        form=form, network=widths, steps=200_000, batch=128, frames=8, learning_rate=1e-4, final_rate=5e-5,
        falls="line", warm_up=1, weight_decay=0.0, gradient_weight=0.0,
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
    there when called again. Raises InputError for fewer than two people, a device that is not there, a loss that is not
    finite, and for a state of another training.
    """
    config = GradientTraining() if config is None else config
    with start_processes(config.device) as group:
        lesson = GradientLesson(faces, config)
        trainer = Trainer(lesson, config, group)
        trainer.train(state, on_progress if group.first else silent)
        return lesson.weights(trainer)


class GradientLesson(Lesson):
    """A form's tensors, the loss of a batch of frames, and the error on those of held-out people."""

    def __init__(self, faces: Faces, config: GradientTraining):
        if config.device != "cpu":
            raise InputError(f"training: the transfer of this network is solved on the cpu, not on {config.device!r}")
        if config.precision != "float32":
            raise InputError(f"training: the transfer of this network needs float32, not {config.precision}")
        if config.frames < 1 or config.batch % config.frames:
            raise InputError(f"training batch {config.batch}: expected a multiple of {config.frames} frames of a face")
        self.faces, self.config, self.form = faces, config, FORMS[config.form]
        people = np.unique(faces.groups[:, 0])
        if len(people) < 2:
            raise InputError(f"training needs frames of at least two people, there are {len(people)}")
        self.held = hold_out_people(people, config.validation, np.random.default_rng(config.seed))
        is_held = np.isin(faces.groups[:, 0], self.held)
        self.training = np.flatnonzero(~is_held)
        self.source = FrameSource(faces, self.training)
        codes = self.source.codes
        mean = codes.mean(axis=0).astype(np.float64)
        # All of a code counts as much as one parameter: with fewer people than numbers it is mostly learnt by heart.
        scale = 0.5 * codes.shape[1] * np.maximum(codes.std(axis=0), 1e-6).astype(np.float64)
        self.inputs = Inputs(Features(faces.mean), mean, scale)
        self.seen = seen_ranges(faces, self.training, self.inputs.features)
        self.followed = np.ptp(self.source.levels, axis=0) > 0.0
        torch.manual_seed(config.seed)
        rng = np.random.default_rng([config.seed, 2])
        sample = self.source.sample(SAMPLED, rng)
        anchors = still_vertices(faces.mean, sample.simulated - sample.blended)
        self.network = self._start(sample, anchors)
        self.transfer = DeformationTransfer(faces.mean, anchors, dtype=np.float32)
        self.triangles = torch.from_numpy(faces.mean.triangles.copy())
        self.stiffness = torch.from_numpy(self.transfer.stiffness / faces.mean.areas.sum()).float()
        held = FrameSource(faces, np.flatnonzero(is_held))
        self.judged = self._tensors(held.sample(JUDGED, rng), 1)
        self.about = [f"{len(faces)} faces"]

    def _start(self, sample: FrameBatch, anchors: Ints) -> Tensors:
        network = draw_form(self.form, self.config, self.faces.mean, sample.codes.shape[1], self.followed)
        if "table" in network:
            table = torch.from_numpy(principal_gradients(sample, self.config.network.latent))
            network["scale"] = table.square().mean().sqrt().clamp(min=1e-9).reshape(1)
            network["table"] = table / network["scale"]
        network["anchored"][anchors] = 1.0
        for name, value in network.items():
            value.requires_grad_(name not in ("scale", *HELD))
        return network

    def _tensors(self, batch: FrameBatch, frames: int) -> tuple[torch.Tensor, ...]:
        """Weights (g, m, 52), codes (g, c), parameters (g, k), S and T (g m, n, 3) of a batch, m frames a face."""
        codes = np.array([self.inputs.code(code) for code in batch.codes[::frames]]).astype(np.float32)
        weights = batch.weights.reshape(len(codes), frames, -1)
        parts = weights, codes, batch.parameters[::frames][:, self.followed], batch.blended, batch.simulated
        return tuple(torch.from_numpy(np.ascontiguousarray(part)) for part in parts)

    def loss(self, step: int, rng: np.random.Generator) -> torch.Tensor:
        """Return the mean vertex error [mm] of a batch (Eq. 16), and its weighted gradient error if there is one."""
        config = self.config
        batch = self.source.draw(config.batch // config.frames, config.frames, rng)
        weights, codes, parameters, blended, simulated = self._tensors(batch, config.frames)
        gradients = self.form.gradients(self.network, weights, codes, parameters).flatten(0, 1)
        delta = transfer_delta(gradients, blended, self.transfer)
        vertex = torch.linalg.vector_norm(delta + blended - simulated, dim=-1).mean()
        if not config.gradient_weight:
            return vertex
        # Mean squared (J - I) G S - G (T - S), which has no degenerate faces as |J - J*|² has.
        edges, moved = self._edges(blended), self._edges(simulated - blended)
        u, v = (gradients.view(*gradients.shape[:2], 3, 3) @ edges - moved).unbind(-1)
        c11, c12, c22 = self.stiffness.unbind(-1)
        per_face = c11 * (u * u).sum(-1) + 2.0 * c12 * (u * v).sum(-1) + c22 * (v * v).sum(-1)
        return vertex + config.gradient_weight * per_face.sum(-1).mean()

    def _edges(self, positions):
        corners = positions[:, self.triangles]
        return (corners[:, :, 1:] - corners[:, :, :1]).transpose(-1, -2)

    def errors(self) -> dict[str, float]:
        """Return the mean vertex errors [mm] on held-out people of the network, and of T = S."""
        weights, codes, parameters, blended, simulated = self.judged
        sums = {"network": 0.0, "blendshapes": 0.0}
        with torch.no_grad():
            for part in torch.arange(len(weights)).split(8):
                gradients = self.form.gradients(self.network, weights[part], codes[part], parameters[part])
                moved = simulated[part] - blended[part]
                delta = transfer_delta(gradients.flatten(0, 1), blended[part], self.transfer)
                for name, error in (("network", delta - moved), ("blendshapes", moved)):
                    sums[name] += float(torch.linalg.vector_norm(error, dim=-1).mean()) * len(part) / len(weights)
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


def transfer_delta(gradients, blended, transfer: DeformationTransfer):
    """`DeformationTransfer.delta` as a torch operation: its backward pass is a solve with the same factor."""
    return _Transfer.apply(gradients, blended, transfer)


def still_vertices(reference: Surface, moved: Floats32, share: float = 0.05) -> Ints:
    """Find the transfer's anchors: vertices that T - S (N, n, 3) moves least, `share` of each connected part's."""
    motion = np.sqrt((moved**2).sum(axis=2).mean(axis=0))
    count, part = connected_parts(reference.triangles, len(motion))
    still = []
    for number in range(count):
        members = np.flatnonzero(part == number)
        still.append(members[np.argsort(motion[members], kind="stable")[: max(1, round(share * len(members)))]])
    return np.sort(np.concatenate(still))


def least_gradients(samples: FrameBatch) -> Floats32:
    """The smallest J - I per face that takes the edges of S_t to those of T_t, shape (N, faces, 9)."""
    edges = _edges(samples.blended, samples.reference.triangles)
    moved = _edges(samples.simulated - samples.blended, samples.reference.triangles)
    gram = np.einsum("nfia,nfib->nfab", edges, edges)
    trace = gram[..., 0, 0] + gram[..., 1, 1]
    gram += FLOOR * trace[..., None, None] * np.eye(2, dtype=np.float32)
    a, b, d = gram[..., 0, 0], gram[..., 0, 1], gram[..., 1, 1]
    adjugate = np.stack([np.stack([d, -b], axis=-1), np.stack([-b, a], axis=-1)], axis=-2)
    inverse = adjugate / (a * d - b * b)[..., None, None]
    return np.einsum("nfia,nfab,nfjb->nfij", moved, inverse, edges, optimize=True).reshape(*moved.shape[:2], 9)


def _edges(positions: Floats32, triangles) -> Floats32:
    corners = positions[:, triangles]
    return np.ascontiguousarray((corners[:, :, 1:] - corners[:, :, :1]).transpose(0, 1, 3, 2))


def principal_gradients(samples: FrameBatch, count: int) -> Floats32:
    """Area-weighted principal components of `least_gradients`, shape (count, faces, 9).

    Each is scaled so that its coefficients over the samples have unit mean square; those beyond the rank are zero.
    """
    gradients = least_gradients(samples)
    weight = np.sqrt(samples.reference.areas / samples.reference.areas.mean()).astype(np.float32)[:, None]
    flat = (gradients * weight).reshape(len(samples), -1)
    size, vectors = np.linalg.eigh((flat @ flat.T).astype(np.float64))
    table = np.zeros((count, *gradients.shape[1:]), dtype=np.float32)
    kept = min(count, int(np.count_nonzero(size > 1e-7 * size[-1])))
    leading = vectors[:, ::-1][:, :kept].T.astype(np.float32)
    table[:kept] = (leading @ flat).reshape(kept, *gradients.shape[1:]) / weight / np.sqrt(len(samples))
    return table
