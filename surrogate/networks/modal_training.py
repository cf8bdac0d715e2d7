"""Training of the modal network: of its tables, then of its remainder, and the file that it ends in.

`modal_faces` has the faces, `table_training` how its tables learn.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from os import PathLike
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats32, Ints
from ...lhm.base.progress import OnProgress, silent
from ..corpus.reading import Faces
from .components import find_components
from .features import seen_ranges
from .modal import (
    QUIET,
    WITHOUT_BIAS,
    ModalConfig,
    basis,
    bind_modal,
    modal_shapes,
    remainder,
    remainder_layers,
)
from .modal_faces import LessonFaces
from .table_training import TableTraining, draw_mixers, learn_tables
from .tables import expand, find_first_order
from .trainer import (
    Lesson,
    Trainer,
    TrainerConfig,
    draw_layers,
    draw_positions,
    join_curves,
    open_device,
    quieten,
    to_tensors,
    torch,
)
from .weights import MODAL, TrainingNote, Weights, join_people

OF_REMAINDER = ("gain_", "remainder_", "modes", "size_")
"""Beginnings of the names of arrays that frames teach."""


@dataclass(frozen=True)
class ModalTraining(TrainerConfig):
    """Options of one training, each with its reason. `steps` are those at the remainder."""

    network: ModalConfig = field(default_factory=ModalConfig)
    tables: TableTraining = field(default_factory=TableTraining)
    faces: int = 6  # per step at the remainder
    frames: int = 4  # of each
    vertices: int = 1200  # of each, at random: a fourth teaches as much as all
    one_cycle: bool = True
    weight_decay: float = 0.2  # with some hundred people the summary is learnt by heart without
    clip: float | None = 1.0
    validation: float = 0.04  # share of people held out, for the learning curve alone
    sampled: int = 240  # faces whose principal components the modes start from


BEGUN_RATE = 0.3
"""Factor of the learning rate where a remainder begins with weights."""
FRAME_FLOOR = 0.02
"""[mm] Added to a face's motion, by which errors of its frames count: a still face must not decide."""
SAMPLED_FRAMES = 4
"""Frames of each face from whose remainders the modes start."""
ROUNDING = 1e-6
"""[mm²] Added to a squared distance, which at zero has no derivative."""


def train_modal(
    faces: Faces,
    config: ModalTraining | None = None,
    *,
    extra_faces: Faces | None = None,
    start: Weights | None = None,
    state: str | PathLike[str] | None = None,
    on_progress: OnProgress = silent,
) -> Weights:
    """Fit the network to a corpus' training faces, and its tables to `extra_faces` of the same space, too.

    Where skins and shapes are symmetric, mirrored faces teach, too. Faces teach the tables, frames the remainder, which
    begins with principal components; or networks and remainder begin with those of `start`, weights of the same space.
    What the faces at hand cannot teach stays that of `start`: the remainder where the corpus has no frames, and the
    tables where it has frames and there are no `extra_faces`: faces of a corpus of frames are few. With `state`, a
    file, the training is kept there now and then, that of tables beside it, and goes on when called again. Raises
    InputError for fewer than ten people, a corpus without frames and without `start`, a device that is not there, a
    `start` of another mesh or of other sizes than the config's, and a state of another training.
    """
    config, begun = ModalTraining() if config is None else config, time.process_time()
    if start is None and not faces.has_frames:
        raise InputError(f"training: {faces.folder} has no frames; give weights to begin with, whose remainder stays")
    device, rng = open_device(config.device), np.random.default_rng([config.seed, 0])
    data = LessonFaces.divide(faces, extra_faces, start, validation_share=config.validation, rng=rng)
    torch.manual_seed(config.seed)
    shapes = modal_shapes(config.network, data.features, data.code_size)
    network, curve = learn_tables(
        data, start, shapes, lambda: draw_network(data, config, rng), config.tables, config, state, on_progress
    )
    if faces.has_frames:
        at_remainder = RemainderLesson(data, network, config, device)
        rest = config if start is None else replace(config, learning_rate=BEGUN_RATE * config.learning_rate)
        at_remainder.begun = begun
        trainer = Trainer(at_remainder, rest)
        trainer.train(state, on_progress)
        network |= trainer.arrays()
        curve = join_curves(curve, trainer.curve)
    return _export(data, network, curve, config, start)


def draw_network(data: LessonFaces, training: ModalTraining, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return a network without tables, whose modes are principal components of the remainders of some faces."""
    mean, config = data.corpus.mean, training.network
    framed = rng.permutation(data.find_framed(training.frames))[: training.sampled]
    modes, sizes = find_components(_sample_remainders(data, framed, rng), config.modes, rng)
    place = draw_positions(mean.vertices, mean.vertex_normals, config.position, rng)
    mixers = draw_mixers(config, mean, data.code_size, rng)
    layers = draw_layers(remainder_layers(config, data.features, data.code_size), WITHOUT_BIAS)
    quieten(layers, QUIET)
    layers["remainder_linear.weight"] *= 0.0
    return mixers | {
        **{name: value.numpy() for name, value in layers.items()},
        "gain_position": place,
        "modes": modes.reshape(len(modes), *mean.vertices.shape) * np.sqrt(np.float32(mean.vertices.size)),
        "size_remainder": sizes.astype(np.float32),
    }


def _sample_remainders(data: LessonFaces, framed: Ints, rng: np.random.Generator) -> Floats32:
    """Return what some frames of faces have beyond first order [mm], a row (3 n,) each."""
    rows = []
    for number in framed.tolist():
        (face,) = data.draw_sides(data.faces([number]), rng)
        frames = data.corpus.frames(number, rng.permutation(len(data.corpus.frames_of[number]))[:SAMPLED_FRAMES])
        rows.append(face.as_mirrored(frames).remainder(face.offset, face.responses).reshape(len(frames.weights), -1))
    return np.vstack(rows)


class RemainderLesson(Lesson):
    """The remainder in training: modes, their gains and amplitudes, by frames."""

    slow = ("modes", "gain_position")
    """Tables over the vertices, which start near where they end."""

    def __init__(self, data: LessonFaces, network: Mapping[str, np.ndarray], config: ModalTraining, device: Any):
        self.data, self.config, self.device, self.dtype = data, config, device, torch.float32
        self.whole, self.tables = network, expand(network)
        self.network = to_tensors({k: value for k, value in network.items() if k.startswith(OF_REMAINDER)}, device)
        for name, value in self.network.items():
            value.requires_grad_(not name.startswith("size_"))
        self.framed = data.find_framed(config.frames)
        self.about = [f"remainder of {len(data.corpus)} faces and {len(data.extra_faces or ())} more"]

    def loss(self, done: float, rng: np.random.Generator) -> torch.Tensor:
        """Return the mean distance of what frames move beyond exact responses, in each face's scale."""
        config, n = self.config, self.data.vertex_count
        numbers = rng.choice(self.framed, min(config.faces, len(self.framed)), replace=False)
        return self.loss_of(numbers, rng, np.sort(rng.choice(n, min(config.vertices, n), replace=False)))

    def loss_of(self, numbers: Sequence[int] | Ints, rng: np.random.Generator, vertices: Ints) -> torch.Tensor:
        """Return the loss of some faces at some vertices; each as it is or mirrored."""
        data, rows = self.data, []
        for number, face in zip(numbers, data.draw_sides(data.faces(numbers), rng), strict=True):
            drawn = rng.choice(len(data.corpus.frames_of[number]), self.config.frames, replace=False)
            frames = face.as_mirrored(data.corpus.frames(int(number), drawn))
            motion = frames.corrected.astype(np.float32) - face.offset
            linear = np.tensordot(frames.weights, face.responses_at(vertices).astype(np.float32), axes=1)
            rows.append((
                data.features.local(face.parameters)[vertices],
                data.inputs.code(face.code)[None],
                data.inputs.summary(face.code, face.parameters)[None],
                frames.weights,
                motion[:, vertices] - linear,
                np.array(FRAME_FLOOR + np.linalg.norm(motion, axis=2).mean()),
            ))  # fmt: skip
        columns = (torch.from_numpy(np.stack(column)) for column in zip(*rows, strict=True))
        local, code, summary, w, nonlinear, scale = (column.to(self.device, self.dtype) for column in columns)
        predicted = remainder(self.network, summary)(w) @ basis(self.network, local, code, vertices)
        error = predicted.unflatten(-1, (-1, 3)) - nonlinear
        distance = (error.square().sum(dim=-1) + ROUNDING).sqrt().flatten(1).mean(dim=1)
        return (distance / scale).mean()

    def errors(self) -> dict[str, float]:
        """Return mean vertex errors [mm] over the static frames of held-out people.

        Of the network alone, with exact derivatives (`hybrid`), of these derivatives alone, and of T = S.
        """
        data, sums, count = self.data, dict.fromkeys(("network", "hybrid", "linearised", "blendshapes"), 0.0), 0
        arrays = {**self.whole, **{name: value.detach().cpu().numpy() for name, value in self.network.items()}}
        for number in data.held.tolist():
            face, frames = data.corpus.face(number), data.corpus.frames(number)
            at_vertices, code = data.features.at_vertices(face.coefficients), data.inputs.code(face.code)
            first = find_first_order(arrays, self.tables, data.features, code, at_vertices, face.shapes)
            modes = bind_modal(arrays, first, data.features, code, at_vertices)
            nonlinear, predicted = frames.remainder(face.offset, face.responses), modes.remainder(frames.weights)
            motion = frames.corrected.astype(np.float32)
            linear = motion - modes.offset - np.tensordot(frames.weights, modes.responses, axes=1)
            all_errors = linear - predicted, nonlinear - predicted, nonlinear, motion
            for name, error in zip(sums, all_errors, strict=True):
                sums[name] += float(np.linalg.norm(error, axis=2).mean(axis=1).sum())
            count += len(frames.weights)
        return {name: value / max(count, 1) for name, value in sums.items()}


def _export(
    data: LessonFaces,
    arrays: Mapping[str, np.ndarray],
    curve: Sequence[Mapping[str, float]],
    config: ModalTraining,
    start: Weights | None,
) -> Weights:
    """Return a trained network with what it was made from."""
    corpus, extra_faces, inputs = data.corpus, data.extra_faces, data.inputs
    seen: list[Mapping[str, tuple[float, float]]] = [
        seen_ranges(data.features, map(corpus.coefficients, data.training.tolist()))
    ]
    if extra_faces is not None:
        seen.append(seen_ranges(data.features, map(extra_faces.coefficients, range(len(extra_faces)))))
    if start is not None:
        seen.append(start.note.seen)
    joined = {name: [end for ranges in seen for end in ranges[name]] for name in seen[0]}
    note = TrainingNote(
        people=len(np.unique(corpus.groups[data.training, 0])),
        faces=len(data.training),
        frames=sum(len(corpus.frames_of[number]) for number in data.training) if corpus.has_frames else 0,
        steps=int(curve[-1]["step"]),
        config=asdict(config),
        curve=tuple(curve),
        seen={name: (min(ends), max(ends)) for name, ends in joined.items()},
        held=tuple(data.held_out.tolist()),
        neutrals=len(extra_faces or ()),
        before=None if start is None else asdict(start.note),
        cells=corpus.cells,
    )
    looseness = None if start is None else start.looseness
    learned = join_people(
        start, corpus.name_people(data.training), *([] if extra_faces is None else [extra_faces.name_people()])
    )
    return Weights(
        MODAL, corpus.space, corpus.mean, inputs.code_mean, inputs.code_scale, arrays, note, looseness, people=learned
    )
