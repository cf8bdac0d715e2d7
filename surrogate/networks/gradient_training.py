"""Training of networks of deformation gradients: the loss of Eq. 16 through the transfer, and the paper's protocol.

| name           | form                                   | protocol                                     |
|----------------|----------------------------------------|----------------------------------------------|
| hyper          | the hypernetwork beyond first order    | quick, after its tables                      |
| paper          | the hypernetwork as it is printed      | the paper's, 200,000 steps of 128 frames     |
| softsmpl-small | one perceptron, the paper's widths     | the paper's                                  |
| softsmpl-large | one perceptron, wider                  | the paper's                                  |
| face-wise      | one perceptron at every face           | the paper's                                  |

Options stop a training earlier; nothing else does.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from os import PathLike
from typing import Any

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.geometry.deformation import DeformationTransfer, least_gradients
from ...lhm.base.geometry.topology import connected_parts
from ...lhm.base.mesh import Floats32, Ints, Surface
from ...lhm.base.progress import OnProgress, silent
from ..corpus.reading import Faces
from .components import find_components
from .features import Inputs, seen_ranges
from .frames import MORE_UNIFORM, FrameBatch, FrameSource
from .gradients import HELD, GradientForm, Sizes, Widths
from .modal_faces import LessonFaces
from .softsmpl import LARGE, SMALL
from .table_training import TableTraining, draw_mixers, learn_tables
from .tables import table_shapes
from .trainer import (
    Lesson,
    Tensors,
    Trainer,
    TrainerConfig,
    draw_layers,
    draw_positions,
    hold_out_people,
    join_curves,
    torch,
)
from .weights import FORMS, TrainingNote, Weights, join_people

LEAST_MOTION = 0.02
"""[mm] Added to a frame's own size: a still one must not decide."""
SAMPLED, JUDGED = 400, 200
"""Frames that tell which vertices stand still, and those of held-out people by which a training is judged, at most."""


@dataclass(frozen=True)
class GradientTraining(TrainerConfig):
    """Options of one training, each with its reason: those of our hypernetwork."""

    form: str = "hypernetwork"
    network: Widths = field(default_factory=lambda: Widths(latent=24, hidden=32, position=16))
    tables: TableTraining = field(default_factory=TableTraining)  # where the form has some
    steps: int = 3000
    batch: int = 24  # frames per step; a larger one takes proportionally longer on a CPU
    frames: int = 6  # of one face among these, for which p and h are evaluated once
    fields: bool = True  # faces under p that vary over them teach, too
    in_own_size: bool = True  # errors count in shares of how far a frame is from carried blendshapes
    learning_rate: float = 6e-3
    warm_up: int = 100
    final_rate: float = 1e-4
    weight_decay: float = 0.01
    clip: float | None = 1.0
    validation: float = 0.05  # share of people held out, to choose the best step: more of them teach than judge
    validate_every: int = 200
    best_by: str = "share"
    patience: int = 6  # held-out people end it, not the count of steps


def follow_paper(form: str, widths: Widths) -> GradientTraining:
    """Return the paper's protocol (4.2.1): Adam, 200,000 steps of 128, the rate from 1e-4 down to 5e-5 on a line.

    The loss is Eq. 16 alone. Sixteen faces with eight frames each make a batch, since p and h are dear.
    """
    return GradientTraining(
        form=form, network=widths, steps=200_000, batch=128, frames=8, fields=False,
        in_own_size=False, learning_rate=1e-4, final_rate=5e-5, falls="line", warm_up=1, weight_decay=0.0, clip=None,
        best_by="network", patience=0,
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
    extra_faces: Faces | None = None,
    start: Weights | None = None,
    state: str | PathLike[str] | None = None,
    on_progress: OnProgress = silent,
) -> Weights:
    """Fit a network to a corpus' training frames; return the weights of least error on held-out people.

    Frames are read as batches need them. A form with tables learns these first, from the corpus' and `extra_faces`; or
    they are those of `start`, weights of either kind that has them. With `state`, a file, the training is kept there
    now and then, that of tables beside it, and goes on from there when called again. Raises InputError for fewer than
    two people, or ten where tables are learned, another device than the CPU, a loss that is not finite, a `start`
    without tables of these sizes, and for a state of another training.
    """
    config, begun = GradientTraining() if config is None else config, time.process_time()
    form, data = FORMS[config.form], None
    first: dict[str, np.ndarray] = {}
    curve: list[dict[str, float]] = []
    if config.device != "cpu":
        raise InputError(f"training: a {form.kind} network learns on the cpu, not on {config.device!r}")
    if not form.has_tables and (extra_faces is not None or start is not None):
        raise InputError(f"training: a {form.kind} network has no tables that more faces or a start could teach")
    if form.has_tables:
        torch.manual_seed(config.seed)
        data = LessonFaces.divide(
            faces, extra_faces, start, validation_share=config.validation, rng=np.random.default_rng([config.seed, 0])
        )
        shapes = table_shapes(config.network, data.vertex_count, data.code_size)
        rng = np.random.default_rng([config.seed, 3])
        begin = partial(draw_mixers, config.network, faces.mean, data.code_size, rng)
        whole, curve = learn_tables(data, start, shapes, begin, config.tables, config, state, on_progress)
        first = {name: whole[name] for name in shapes}
    lesson = GradientLesson(faces, config, data)
    lesson.begun = begun
    trainer = Trainer(lesson, config)
    trainer.train(state, on_progress)
    note = TrainingNote(
        people=len(lesson.source.people),
        faces=len(lesson.source.face),
        frames=len(lesson.source),
        neutrals=len(extra_faces or ()),
        steps=trainer.step,
        config=asdict(config),
        curve=tuple(join_curves(curve, trainer.curve)),
        seen=lesson.seen,
        held=tuple(lesson.held.tolist()),
        before=None if start is None else asdict(start.note),
        cells=faces.cells,
    )
    inputs, arrays = lesson.inputs, first | trainer.arrays()
    looseness = None if start is None else start.looseness
    learned = join_people(
        start, faces.name_people(lesson.training), *([] if extra_faces is None else [extra_faces.name_people()])
    )
    return Weights(
        form.kind, faces.space, faces.mean, inputs.code_mean, inputs.code_scale, arrays, note, looseness, people=learned
    )


class GradientLesson(Lesson):
    """A form's tensors, the loss of a batch of frames, and the error on those of held-out people."""

    def __init__(self, faces: Faces, config: GradientTraining, data: LessonFaces | None = None):
        """Learn from a corpus' faces. `data`, of a form with tables, tells its inputs and who is held out.

        Raises InputError as `train_gradients`.
        """
        if config.frames < 1 or config.batch % config.frames:
            raise InputError(f"training batch {config.batch}: expected a multiple of {config.frames} frames of a face")
        self.faces, self.config, self.form = faces, config, FORMS[config.form]
        people = faces.people if config.fields else FrameSource(faces).people
        if len(people) < 2:
            uniform = "" if config.fields else f" under uniform parameters; {MORE_UNIFORM}"
            raise InputError(f"training needs frames of at least two people, there are {len(people)}{uniform}")
        if data is None:
            self.held = hold_out_people(people, config.validation, np.random.default_rng([config.seed, 0]))
        else:
            self.held = data.held_out
        is_held = np.isin(faces.groups[:, 0], self.held)
        self.training = np.flatnonzero(~is_held)
        self.source = self._open(self.training)
        self.inputs = Inputs.from_few(faces.mean, self.source.codes) if data is None else data.inputs
        self.seen = seen_ranges(self.inputs.features, map(faces.coefficients, self.training.tolist()))
        self.followed = np.ptp(self.source.coefficients[:, :, 0], axis=0) > 0.0
        torch.manual_seed(config.seed)
        rng = np.random.default_rng([config.seed, 2])
        sample = self.source.sample(SAMPLED, rng)
        anchors = still_vertices(faces.mean, sample.simulated - sample.blended)
        self.network = draw_form(self.form, config, faces.mean, sample.codes.shape[1], self.followed)
        self.network["anchored"][anchors] = 1.0
        if "modes" in self.network:
            self.network |= _begin_modes(sample, faces.mean, config.network.latent, rng)
        for name, value in self.network.items():
            value.requires_grad_(name not in HELD)
        self.transfer = SparseTransfer(DeformationTransfer(faces.mean, anchors, dtype=np.float32))
        self.judged = self._tensors(self._open(np.flatnonzero(is_held)).sample(JUDGED, rng), 1)
        self.about = [f"{len(faces)} faces"]

    def _open(self, chosen: Ints) -> FrameSource:
        return FrameSource(self.faces, chosen, fields=self.config.fields, first_order=self.form.has_tables)

    def _tensors(self, batch: FrameBatch, frames: int) -> tuple[torch.Tensor, ...]:
        """Weights (g, m, 52), codes (g, c), parameters (g, 1 or faces, k), S and T (g m, n, 3), and how far T moved.

        Of m frames a face.
        """
        codes = np.array([self.inputs.code(code) for code in batch.codes[::frames]]).astype(np.float32)
        weights = batch.weights.reshape(len(codes), frames, -1)
        parameters = self._parameters(batch.coefficients[::frames])
        parts = weights, codes, parameters, batch.blended, batch.simulated, batch.moved
        return tuple(torch.from_numpy(np.ascontiguousarray(part)) for part in parts)

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
        weights, codes, parameters, blended, simulated, moved = self._tensors(batch, config.frames)
        gradients = self.form.gradients(self.network, weights, codes, parameters).flatten(0, 1)
        delta = self.transfer(gradients, blended)
        error = torch.linalg.vector_norm(delta + blended - simulated, dim=-1).mean(dim=-1)
        if config.in_own_size:
            error = error / (moved + LEAST_MOTION)
        return error.mean()

    def errors(self) -> dict[str, float]:
        """Return errors on held-out people [mm]: of the network, of S and of carried blendshapes; and its share."""
        weights, codes, parameters, blended, simulated, moved = self.judged
        sums = {"network": 0.0, "still": 0.0, "blendshapes": 0.0, "share": 0.0}
        with torch.no_grad():
            for part in torch.arange(len(weights)).split(8):
                gradients = self.form.gradients(self.network, weights[part], codes[part], parameters[part])
                left = simulated[part] - blended[part]
                delta = self.transfer(gradients.flatten(0, 1), blended[part])
                missed, still = (torch.linalg.vector_norm(x, dim=-1).mean(dim=-1) for x in (delta - left, left))
                parts = missed, still, moved[part], missed / (moved[part] + LEAST_MOTION)
                for name, error in zip(sums, parts, strict=True):
                    sums[name] += float(error.sum()) / len(weights)
        return sums


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


def _begin_modes(sample: FrameBatch, mean: Surface, count: int, rng: np.random.Generator) -> Tensors:
    """Return the gradients by which the mean skin moves along principal components of T - S, and their size."""
    left = sample.simulated - sample.blended
    left /= (np.linalg.norm(left, axis=2).mean(axis=1) + LEAST_MOTION)[:, None, None]
    components, sizes = find_components(left.reshape(len(left), -1), count, rng)
    fields = (LEAST_MOTION * sizes[:, None] * components).reshape(count, *mean.vertices.shape)
    modes = least_gradients(mean.vertices, fields, mean.triangles).swapaxes(0, 1).astype(np.float32)
    scale = max(np.sqrt(np.mean(modes**2)), 1e-9)
    return {"modes": torch.from_numpy(modes / scale), "scale": torch.full((1,), scale)}


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


def still_vertices(reference: Surface, moved: Floats32, share: float = 0.05) -> Ints:
    """Find the transfer's anchors: vertices that T - S (N, n, 3) moves least, `share` of each connected part's."""
    motion = np.sqrt((moved**2).sum(axis=2).mean(axis=0))
    count, part = connected_parts(reference.triangles, len(motion))
    still = []
    for number in range(count):
        members = np.flatnonzero(part == number)
        still.append(members[np.argsort(motion[members], kind="stable")[: max(1, round(share * len(members)))]])
    return np.sort(np.concatenate(still))
