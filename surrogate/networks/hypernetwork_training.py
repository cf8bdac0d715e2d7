"""Training of the hypernetwork: its start from principal deformation gradients, and its loss through the transfer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
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
from .hypernetwork import LAYERS, WITHOUT_BIAS, HypernetworkConfig, deformation_gradients
from .trainer import Trainer, TrainerConfig, draw_layers, hold_out_people, start_processes, torch
from .weights import TrainingNote, Weights

FLOOR = 1e-4
"""Added to each squared singular value of a face's edges, relative to their sum: lids that close flatten faces."""


@dataclass(frozen=True)
class HypernetworkTraining(TrainerConfig):
    """Options of one training, each with its reason."""

    network: HypernetworkConfig = field(default_factory=HypernetworkConfig)
    steps: int = 3200
    batch: int = 8  # frames per step; a larger one takes proportionally longer on a CPU
    learning_rate: float = 6e-3
    warm_up: int = 20
    final_rate: float = 1e-4
    weight_decay: float = 0.3  # a few hundred frames overfit without
    gradient_weight: float = 100.0  # mm per squared gradient error: teaches faces that the vertex term sees late
    validation: float = 0.05  # share of people held out, to choose the best step: more of them teach than judge
    validate_every: int = 100
    best_by: str = "network"


@dataclass(frozen=True, eq=False)
class FrameArrays:
    """Static frames as arrays: person (N,), code (N, c), weights (N, 52), parameters of STATIC mapped to [-1, 1].

    blended and simulated (N, n, 3) [mm]: the linear blendshapes' S and the simulator's T.
    """

    reference: Surface
    person: Ints
    codes: Floats32
    weights: Floats32
    parameters: Floats32
    blended: Floats32
    simulated: Floats32

    @classmethod
    def from_faces(cls, faces: Faces, chosen: Ints | None = None) -> FrameArrays:
        """Read the frames of faces under uniform parameters; InputError where there are none of these."""
        rows: list[tuple[Any, ...]] = []
        for index in range(len(faces)) if chosen is None else chosen:
            coefficients = faces.coefficients(int(index))
            if coefficients[:, 1:].any() or not len(faces.frames_of[int(index)]):
                continue
            face, frames = faces.face(int(index)), faces.frames(int(index))
            blended = (face.skin + np.tensordot(frames.weights, face.shapes, axes=1)).astype(np.float32)
            simulated = blended + frames.corrected.astype(np.float32)
            one = (face.identity, face.code, coefficients[:, 0])
            rows += [(*one, w, s, t) for w, s, t in zip(frames.weights, blended, simulated, strict=True)]
        if not rows:
            raise InputError(f"corpus {faces.folder}: all its faces have parameters that vary over the face")
        person, code, level, weights, blended, simulated = map(np.array, zip(*rows, strict=True))
        narrow = (part.astype(np.float32) for part in (code, weights, level, blended, simulated))
        return cls(faces.mean, person, *narrow)

    def __len__(self) -> int:
        return len(self.person)

    def take(self, index: Ints) -> FrameArrays:
        """Return some of the frames, by index or mask."""
        names = ("person", "codes", "weights", "parameters", "blended", "simulated")
        return FrameArrays(self.reference, *(getattr(self, name)[index] for name in names))


def train_hypernetwork(
    faces: Faces,
    config: HypernetworkTraining | None = None,
    *,
    state: str | PathLike[str] | None = None,
    on_progress: OnProgress = silent,
) -> Weights:
    """Fit a hypernetwork to a corpus' training frames; return the weights of least error on held-out people.

    With `state`, a file, the training is kept there now and then and goes on from there when called again.
    Raises InputError for fewer than two people, a device that is not there, and for a state of another training.
    """
    config = HypernetworkTraining() if config is None else config
    with start_processes(config.device) as group:
        lesson = HypernetworkLesson(faces, config)
        trainer = Trainer(lesson, config, group)
        trainer.train(state, on_progress if group.first else silent)
        return lesson.weights(trainer)


class HypernetworkLesson:
    """Frames of a corpus as tensors, the loss of a batch of them, and the error on those of held-out people."""

    slow: tuple[str, ...] = ("-",)  # none

    def __init__(self, faces: Faces, config: HypernetworkTraining):
        self.faces, self.config = faces, config
        people = np.unique(faces.groups[:, 0])
        if len(people) < 2:
            raise InputError(f"training needs frames of at least two people, there are {len(people)}")
        self.held = hold_out_people(people, config.validation, np.random.default_rng(config.seed))
        is_held = np.isin(faces.groups[:, 0], self.held)
        self.training = np.flatnonzero(~is_held)
        self.samples = FrameArrays.from_faces(faces, self.training)
        codes = self.samples.codes
        mean = codes.mean(axis=0).astype(np.float64)
        # All of a code counts as much as one parameter: with fewer people than numbers it is mostly learnt by heart.
        scale = 0.5 * codes.shape[1] * np.maximum(codes.std(axis=0), 1e-6).astype(np.float64)
        self.inputs = Inputs(Features(faces.mean), mean, scale)
        self.seen = seen_ranges(faces, self.training, self.inputs.features)
        followed = np.ptp(self.samples.parameters, axis=0) > 0.0
        torch.manual_seed(config.seed)
        self.network = self._start(followed)
        self.transfer = DeformationTransfer(
            faces.mean, np.flatnonzero(self.network["anchored"].numpy()), dtype=np.float32
        )
        self.triangles = torch.from_numpy(faces.mean.triangles.copy())
        self.stiffness = torch.from_numpy(self.transfer.stiffness / faces.mean.areas.sum()).float()
        self.frames = self._tensors(self.samples, followed)
        self.validation = self._tensors(FrameArrays.from_faces(faces, np.flatnonzero(is_held)), followed)
        self.about: Sequence[str] = [f"{len(faces)} faces"]

    def _start(self, followed: np.ndarray) -> dict[str, torch.Tensor]:
        config, samples, mean = self.config.network, self.samples, self.faces.mean
        sizes = config.sizes(mean, samples.codes.shape[1], int(followed.sum()))
        network = draw_layers({name: (sizes[a], sizes[b]) for name, (a, b) in LAYERS.items()}, WITHOUT_BIAS)
        for name, share in (("expression.4.weight", 0.1), ("last.weight", 0.0), ("gain.2.weight", 0.1)):
            network[name] *= share
        network["gain.2.bias"] *= 0.0
        table = torch.from_numpy(principal_gradients(samples, config.latent))
        network["scale"] = table.square().mean().sqrt().clamp(min=1e-9).reshape(1)
        network["table"] = table / network["scale"]
        positions = smooth_positions(mean, config.position, np.random.default_rng(self.config.seed))
        network["position"] = torch.from_numpy(positions)
        for name, value in network.items():
            value.requires_grad_(name != "scale")
        network["followed"] = torch.from_numpy(followed.astype(np.float32))
        anchored = np.zeros(len(mean.vertices), dtype=np.float32)
        anchored[still_vertices(samples)] = 1.0
        network["anchored"] = torch.from_numpy(anchored)
        return network

    def _tensors(self, samples: FrameArrays, followed: np.ndarray) -> tuple[torch.Tensor, ...]:
        """Weights, codes, parameters, S and T."""
        codes = np.array([self.inputs.code(code) for code in samples.codes]).astype(np.float32)
        parts = samples.weights, codes, samples.parameters[:, followed], samples.blended, samples.simulated
        return tuple(map(torch.from_numpy, parts))

    def loss(self, step: int, rng: np.random.Generator) -> torch.Tensor:
        """Return the mean vertex error [mm] of a batch and its weighted gradient error."""
        # Each epoch is a permutation drawn from seed and epoch, so a resumed training sees the same.
        config, count = self.config, len(self.frames[0])
        epoch, place = divmod(step, max(count // config.batch, 1))
        order = np.random.default_rng([config.seed, epoch]).permutation(count)
        index = torch.from_numpy(order[place * config.batch : (place + 1) * config.batch])
        weights, codes, parameters, blended, simulated = (part[index] for part in self.frames)
        gradients = deformation_gradients(self.network, weights, codes, parameters)
        delta = transfer_delta(gradients, blended, self.transfer)
        vertex = torch.linalg.vector_norm(delta + blended - simulated, dim=-1).mean()
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
        weights, codes, parameters, blended, simulated = self.validation
        sums = {"network": 0.0, "blendshapes": 0.0}
        with torch.no_grad():
            for part in torch.arange(len(weights)).split(self.config.batch):
                gradients = deformation_gradients(self.network, weights[part], codes[part], parameters[part])
                moved = simulated[part] - blended[part]
                delta = transfer_delta(gradients, blended[part], self.transfer)
                for name, error in (("network", delta - moved), ("blendshapes", moved)):
                    sums[name] += float(torch.linalg.vector_norm(error, dim=-1).mean()) * len(part) / len(weights)
        return sums

    def weights(self, trainer: Trainer) -> Weights:
        """Return the trained network with what it was made from."""
        note = TrainingNote(
            people=len(np.unique(self.samples.person)),
            faces=len(self.training),
            frames=len(self.samples),
            neutrals=0,
            steps=trainer.step,
            config=asdict(self.config),
            curve=tuple(trainer.curve),
            seen=self.seen,
            held=tuple(self.held.tolist()),
        )
        return Weights(
            "hypernetwork", self.faces.space, self.faces.mean, self.inputs.code_mean, self.inputs.code_scale,
            trainer.arrays(), note,
        )  # fmt: skip


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


def smooth_positions(reference: Surface, size: int, rng: np.random.Generator) -> Floats32:
    """Draw a start for π: random Fourier features of face centres and normals, unit variance, shape (faces, size).

    Neighbours start alike, and the two sides of a lip, close in space, differ by their normals.
    """
    centres = reference.vertices[reference.triangles].mean(axis=1)
    centres = (centres - centres.mean(axis=0)) / np.sqrt(centres.var(axis=0).sum())
    length = np.linalg.norm(reference.face_normals, axis=1, keepdims=True)
    inputs = np.hstack([2.0 * centres, 0.5 * reference.face_normals / length])
    frequencies = rng.normal(size=(inputs.shape[1], size))
    features = np.cos(inputs @ frequencies + rng.uniform(0.0, 2.0 * np.pi, size))
    return ((features - features.mean(axis=0)) / features.std(axis=0)).astype(np.float32)


def still_vertices(samples: FrameArrays, share: float = 0.05) -> Ints:
    """Find the transfer's anchors: vertices that simulation moves least off S, `share` of each connected part's."""
    motion = np.sqrt(((samples.simulated - samples.blended) ** 2).sum(axis=2).mean(axis=0))
    count, part = connected_parts(samples.reference.triangles, len(motion))
    still = []
    for number in range(count):
        members = np.flatnonzero(part == number)
        still.append(members[np.argsort(motion[members], kind="stable")[: max(1, round(share * len(members)))]])
    return np.sort(np.concatenate(still))


def least_gradients(samples: FrameArrays) -> Floats32:
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


def principal_gradients(samples: FrameArrays, count: int) -> Floats32:
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
