"""Training of the modal network: its options, its loss on faces and frames, its errors, and the file that it ends in.

`modal_faces` has the faces, `modal_start` what the network begins with.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from os import PathLike
from typing import NamedTuple

import numpy as np

from ...lhm.base.mesh import Floats32, Ints
from ...lhm.base.progress import OnProgress, silent
from ..corpus.face import KeptFace
from ..corpus.reading import Faces
from .features import seen_ranges
from .modal import ModalConfig, basis, bind_modal, hidden_features, neutral, remainder
from .modal_faces import FaceInputs, FaceTensors, LessonFace, LessonFaces, NeutralMotion
from .modal_start import continue_network, draw_network
from .response_tables import compress, mix, solve_tables
from .trainer import Lesson, Trainer, TrainerConfig, open_device, torch
from .weights import TrainingNote, Weights

EXPRESSIVE = ("lag", "response_", "remainder_", "modes.2")
"""What a training that begins with weights, and has no `more` faces, goes on with: what w does. Neutral faces stay as
they were learned: a corpus of a few hundred faces alone leaves 5 to 10 % more of them."""


@dataclass(frozen=True)
class ModalTraining(TrainerConfig):
    """Options of one training, each with its reason."""

    network: ModalConfig = field(default_factory=ModalConfig)
    faces: int = 6  # per step
    frames: int = 4  # of each
    more: int = 10  # faces per step without frames, where there are any
    vertices: int = 1200  # of each, at random: a fourth teaches as much as all
    one_cycle: bool = True
    weight_decay: float = 0.2  # with some hundred people the summary is learnt by heart without
    clip: float | None = 1.0
    validation: float = 0.04  # share of people held out, for the learning curve alone
    sampled: int = 240  # faces whose principal components the modes start from
    solve_every: int = 300  # steps between two solutions for the tables of responses
    solved: int = 400  # faces, drawn anew, of each solution but the last, which has all


@dataclass(frozen=True)
class LessonPolicy:
    """Constants of the lesson. Floors [mm] are added to the size of what is learned: a still face must not decide."""

    response_floor: float = 0.002
    frame_floor: float = 0.02
    settled_floor: float = 0.05
    settled_share: float = 0.5  # of how far a neutral face settles, that counts as its size
    frames: float = 1.5  # weight of frames beside neutral faces and responses
    rounding: float = 1e-6  # [mm²] added to a squared distance, which at zero has no derivative
    begun_rate: float = 0.3  # of the learning rate, where a training begins with weights that know most already


POLICY = LessonPolicy()
"""The constants as they were measured."""


def train_modal(
    faces: Faces,
    config: ModalTraining | None = None,
    *,
    more: Faces | None = None,
    start: Weights | None = None,
    state: str | PathLike[str] | None = None,
    on_progress: OnProgress = silent,
) -> Weights:
    """Fit the network to a corpus' training faces, and to `more` faces of the same space without frames, where given.

    Where skins and shapes are symmetric, mirrored faces teach, too. It begins with principal components of what it
    learns, or with `start`, weights of another corpus of the same space, whose ranges then count as seen. From a start
    without `more` it learns what w does alone: neutral faces stay those of the start. With `state`, a file, the
    training is kept there now and then, and goes on from there when called again. Raises InputError for fewer than ten
    people, a device that is not there, a `start` of another mesh or of other sizes than the config's, and a state of
    another training.
    """
    config = ModalTraining() if config is None else config
    lesson = ModalLesson(faces, config, more=more, start=start, device=open_device(config.device))
    rate = config.learning_rate if start is None else lesson.policy.begun_rate * config.learning_rate
    trainer = Trainer(lesson, replace(config, learning_rate=rate))
    trainer.train(state, on_progress)
    return export_weights(lesson, trainer, start)


class _Batch(NamedTuple):
    """Faces of a step, the vertices that count, what the network is given of both, and exact responses there."""

    faces: list[LessonFace]
    vertices: Ints
    inputs: FaceInputs
    code: torch.Tensor
    hidden: torch.Tensor
    exact: torch.Tensor


class ModalLesson(Lesson):
    """The network in training: its tensors, the loss of a step, and its errors on held-out people."""

    slow = ("modes", "position", "response_position", "effects")
    """Tables over the vertices, which start near where they end."""

    def __init__(
        self,
        faces: Faces,
        config: ModalTraining,
        *,
        more: Faces | None = None,
        start: Weights | None = None,
        device: torch.device | str = "cpu",
        policy: LessonPolicy = POLICY,
    ):
        self.config, self.policy, self.renewed = config, policy, config.solve_every
        self.learns_neutral = start is None or more is not None
        rng = np.random.default_rng([config.seed, 0])
        self.data = LessonFaces.divide(
            faces, more, start, validation_share=config.validation, frames=config.frames, rng=rng
        )
        self.tensors = FaceTensors(self.data.inputs, device)
        torch.manual_seed(config.seed)
        if start is None:
            network = draw_network(self.data, config.network, config.sampled, rng)
        else:
            network = continue_network(start, self.data, config.network)
        self.network = {name: value.detach().to(device) for name, value in network.items()}
        for name, value in self.network.items():
            learns = self.learns_neutral or name.startswith(EXPRESSIVE)
            value.requires_grad_(learns and not name.startswith(("size_", "tables")))
        after = "" if start is None else f"begun after {start.note.steps} steps"
        self.about = [f"{len(faces)} faces", f"{len(more or ())} more", after]

    def renew(self, step: int) -> None:
        """Solve for the tables of responses; see `response_tables`."""
        self.network["tables"].copy_(torch.from_numpy(self.solve_tables(self._draw_faces(step))))

    def loss(self, done: float, rng: np.random.Generator) -> torch.Tensor:
        """Return mean distances of neutral faces, responses and frames after derivatives, in each face's scale."""
        config, data = self.config, self.data
        numbers = rng.choice(data.training, min(config.faces, len(data.training)), replace=False)
        n = data.vertex_count
        return self.loss_of(numbers, rng, np.sort(rng.choice(n, min(config.vertices, n), replace=False)))

    def loss_of(self, numbers: Sequence[int] | Ints, rng: np.random.Generator, vertices: Ints) -> torch.Tensor:
        """Return the loss of some faces, and of more without frames, at some vertices; each as it is or mirrored."""
        data, more = self.data, []
        if data.more is not None:
            more = data.more_faces(rng.choice(len(data.more), min(self.config.more, len(data.more)), replace=False))
        faces = data.draw_sides([*data.faces(numbers), *more], rng)
        parameters = [face.parameters for face in faces]
        inputs = self.tensors.inputs_of([face.code for face in faces], parameters, vertices)
        code = inputs.summary[..., : data.code_size]
        hidden = hidden_features(self.network, inputs.local, code, vertices)
        exact = self.tensors.stack([face.responses_at(vertices) for face in faces])
        batch = _Batch(faces, vertices, inputs, code, hidden, exact)
        loss = self._measure_response_loss(batch) + self.policy.frames * self._measure_frame_loss(batch, numbers, rng)
        return loss + self._measure_neutral_loss(batch) if self.learns_neutral else loss

    def _measure_neutral_loss(self, batch: _Batch) -> torch.Tensor:
        """Of neutral faces as they settle, and as they relax among their targets then."""
        settling = [face.settling for face in batch.faces]
        relaxing = [face.relaxing for face in batch.faces]
        scales = [self._scale_settled(motion.displacement) for motion in settling]
        vertices, codes = batch.vertices, [face.code for face in batch.faces]
        inputs = self.tensors.inputs_of(codes, [motion.parameters for motion in settling], vertices)
        hidden = hidden_features(self.network, inputs.local, batch.code, vertices)
        settled = self._miss_neutral(0, settling, inputs, hidden, vertices)
        relaxed = self._miss_neutral(1, relaxing, batch.inputs, batch.hidden, vertices)
        return self._mean_distance(settled, scales) + self._mean_distance(relaxed, scales)

    def _miss_neutral(
        self, part: int, motions: Sequence[NeutralMotion], inputs: FaceInputs, hidden: torch.Tensor, vertices: Ints
    ) -> torch.Tensor:
        """Return by how much the network errs on one of NEUTRAL at some vertices [mm], shape (b, v, 3)."""
        effects = self.tensors.effects_of(motions, vertices)
        predicted = neutral(self.network, part, hidden, inputs.summary, inputs.unmoved, effects, vertices)
        return predicted - self.tensors.stack([motion.displacement[vertices] for motion in motions])

    def _measure_response_loss(self, batch: _Batch) -> torch.Tensor:
        """Of responses."""
        shapes = self.tensors.stack([face.shapes_at(batch.vertices) for face in batch.faces])
        shares, lag = mix(self.network, batch.inputs.local, batch.code, batch.vertices)
        tables = self.network["tables"][:, :, batch.vertices]
        predicted = torch.einsum("bvk,kjvc->bjvc", shares, tables) - lag[:, None] * shapes
        return self._mean_distance(predicted - batch.exact, self.scale_responses(batch.exact))

    def _measure_frame_loss(
        self, batch: _Batch, numbers: Sequence[int] | Ints, rng: np.random.Generator
    ) -> torch.Tensor:
        """Of what frames move beyond exact responses, of the first faces; `numbers` are theirs in the corpus."""
        corpus, count = self.data.corpus, len(numbers)
        weights, motions, scales = [], [], []
        for number, face in zip(numbers, batch.faces[:count], strict=True):
            drawn = rng.choice(len(corpus.frames_of[number]), self.config.frames, replace=False)
            frames = face.see(corpus.frames(int(number), drawn))
            motion = frames.corrected.astype(np.float32) - face.offset.astype(np.float32)
            weights.append(frames.weights)
            motions.append(motion[:, batch.vertices])
            scales.append(self.policy.frame_floor + float(np.linalg.norm(motion, axis=2).mean()))
        w = self.tensors.stack(weights)
        nonlinear = self.tensors.stack(motions).flatten(2) - w @ batch.exact[:count].flatten(2)
        modes = basis(self.network, 2, batch.hidden[:count], batch.vertices)
        predicted = remainder(self.network, batch.inputs.summary[:count])(w) @ modes
        return self._mean_distance((predicted - nonlinear).unflatten(-1, (-1, 3)), scales)

    def _mean_distance(self, error: torch.Tensor, scales: Sequence[float]) -> torch.Tensor:
        """Mean distance of errors (faces, ..., 3) [mm], each face's over its scale [mm]."""
        distance = (error.square().sum(dim=-1) + self.policy.rounding).sqrt().flatten(1).mean(dim=1)
        return (distance / torch.tensor(scales, dtype=distance.dtype, device=distance.device)).mean()

    def scale_responses(self, responses: torch.Tensor) -> list[float]:
        """Return how large faces' responses (b, 52, v, 3) are [mm]: errors count by it in stiff and soft tissue."""
        size = torch.linalg.vector_norm(responses, dim=-1).mean(dim=(1, 2))
        return (self.policy.response_floor + size).tolist()

    def _scale_settled(self, displacement: np.ndarray) -> float:
        """How far a neutral face settles [mm], by which errors of it count: scaled bones move it farthest."""
        mean = float(np.linalg.norm(displacement.astype(np.float32), axis=1).mean())
        return self.policy.settled_floor + self.policy.settled_share * mean

    def solve_tables(self, faces: Iterable[LessonFace]) -> Floats32:
        """Solve for the tables of responses over some faces, shape (k, 52, n, 3)."""
        network, data = self.arrays(), self.data

        def rows():
            for face in faces:
                local = data.features.local(face.parameters)
                shares, lag = mix(network, local, data.inputs.code(face.code).astype(np.float32))
                exact = face.responses_at()
                (scale,) = self.scale_responses(torch.from_numpy(exact)[None])
                yield shares, exact + lag * face.shapes_at(), scale

        return solve_tables(rows(), data.vertex_count, self.config.network.response_tables + 1)

    def _draw_faces(self, step: int) -> Iterator[LessonFace]:
        """Draw the faces that a step solves the tables over, with frames and without."""
        data, rng = self.data, np.random.default_rng([self.config.seed, 2, step])
        count = len(data.training) + len(data.more or ())
        for number in rng.permutation(count)[: self.config.solved]:
            yield from data.draw_sides([self._read(number)], rng)

    def _read(self, number: int) -> KeptFace:
        """Read a face by its number among those of training, and behind them those without frames."""
        data, count = self.data, len(self.data.training)
        return data.faces(data.training[[number]])[0] if number < count else data.more_faces([number - count])[0]

    def every_face(self) -> Iterator[LessonFace]:
        """Read all faces that teach, one after another, each from both sides."""
        for number in range(len(self.data.training) + len(self.data.more or ())):
            yield from self.data.both_sides(self._read(number))

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the network's tensors as arrays."""
        return {name: value.detach().cpu().numpy() for name, value in self.network.items()}

    def errors(self) -> dict[str, float]:
        """Return `measure_errors` of the network as it is now, with tables over as many faces as in training."""
        return measure_errors(self.arrays(), self.solve_tables(self._draw_faces(0)), self.data)


def measure_errors(network: dict[str, np.ndarray], tables: Floats32, data: LessonFaces) -> dict[str, float]:
    """Return mean vertex errors [mm] over the static frames of held-out people.

    Of the network alone, with exact derivatives (`hybrid`), of these derivatives alone, and of T = S.
    """
    sums, count = dict.fromkeys(("network", "hybrid", "linearised", "blendshapes"), 0.0), 0
    for number in data.validation:
        face, frames = data.corpus.face(int(number)), data.corpus.frames(int(number))
        at_vertices = data.features.at_vertices(face.coefficients)
        code = data.inputs.code(face.code)
        modes = bind_modal(network, tables, data.features, code, face.skin.vertices, at_vertices, face.shapes)
        nonlinear, predicted = frames.remainder(face), modes.remainder(frames.weights)
        motion = frames.corrected.astype(np.float32)
        linear = motion - modes.offset - np.tensordot(frames.weights, modes.responses, axes=1)
        all_errors = linear - predicted, nonlinear - predicted, nonlinear, motion
        for name, error in zip(sums, all_errors, strict=True):
            sums[name] += float(np.linalg.norm(error, axis=2).mean(axis=1).sum())
        count += len(frames.weights)
    return {name: value / max(count, 1) for name, value in sums.items()}


def export_weights(lesson: ModalLesson, trainer: Trainer, start: Weights | None) -> Weights:
    """Return the trained network with tables over all faces, and with what it was made from."""
    data, corpus = lesson.data, lesson.data.corpus
    seen: list[Mapping[str, tuple[float, float]]] = [seen_ranges(corpus, data.training, data.features)]
    if data.more is not None:
        seen.append(seen_ranges(data.more, np.arange(len(data.more)), data.features))
    if start is not None:
        seen.append(start.note.seen)
    joined = {name: [end for ranges in seen for end in ranges[name]] for name in seen[0]}
    note = TrainingNote(
        people=len(np.unique(corpus.groups[data.training, 0])),
        faces=len(data.training),
        frames=int(sum(len(corpus.frames_of[number]) for number in data.training)),
        steps=trainer.step,
        config=asdict(lesson.config),
        curve=tuple(trainer.curve),
        seen={name: (min(ends), max(ends)) for name, ends in joined.items()},
        held=tuple(data.held_out.tolist()),
        neutrals=len(data.more or ()),
        before=None if start is None else asdict(start.note),
    )
    network = {name: value for name, value in trainer.arrays().items() if name != "tables"}
    network |= compress(lesson.solve_tables(lesson.every_face()))
    looseness = None if start is None else start.looseness
    inputs = data.inputs
    return Weights("modal", corpus.space, corpus.mean, inputs.code_mean, inputs.code_scale, network, note, looseness)
