"""Training of α, β and γ of Eq. 21 on whole sequences, over the static answers of a network that stays as it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32
from ...lhm.base.progress import OnProgress, silent
from ...reference.face.dynamics import extrapolate_turns, find_pivot
from ..corpus.face import Heads, KeptFace, Person, name_person
from ..corpus.mixture import basis
from ..corpus.reading import Table
from ..rigs.rig import Rig
from .recurrence import WITHOUT_BIAS, LearnedRecurrence, coefficients, recurrence_layers
from .trainer import Lesson, Tensors, Trainer, TrainerConfig, draw_layers, draw_positions, torch
from .weights import Weights, join_people

KEPT = 64
"""Sequences kept in memory between two batches: 2 MB each on the default head."""
FAST = {"beta": -3.0, "gamma": 2.5}
"""Logits with which coefficients begin: nearly without inertia."""

Bind = Callable[[KeptFace], Rig]


@dataclass(frozen=True)
class RecurrenceTraining(TrainerConfig):
    """Options of the training, each with its reason."""

    steps: int = 300
    learning_rate: float = 5e-3
    batch: int = 2  # sequences a step
    position: int = 16  # length of π at a vertex
    hidden: int = 48  # of f_β and f_γ, which every vertex evaluates at bind
    validate_every: int = 100


def train_recurrence(
    weights: Weights,
    bind: Bind,
    table: Table,
    pivot: Floats,
    config: RecurrenceTraining | None = None,
    *,
    on_progress: OnProgress = silent,
) -> Weights:
    """Return weights with coefficients learned from the sequences of a table, which its heads turn about a pivot (3,).

    bind: gives a face the rig of these weights, whose frames are the static answers. Raises InputError for a mesh that
    is not the weights', and a loss that is not finite.
    """
    weights.check_mesh(table.mean)
    config = RecurrenceTraining() if config is None else config
    lesson = RecurrenceLesson(weights, bind, table, pivot, config)
    trainer = Trainer(lesson, config)
    trainer.train(on_progress=on_progress)
    numbers = table.groups[lesson.training, 0].tolist()
    people = join_people(weights, frozenset(name_person(table.person(number).code) for number in set(numbers)))
    return replace(weights, recurrence=LearnedRecurrence(trainer.arrays(), pivot), people=people)


@dataclass(frozen=True, eq=False)
class _Motion:
    """A sequence: static answers and the simulator's skins (L, n, 3), the first velocity a frame (n, 3), turns."""

    code: Floats32
    parameters: Floats32
    static: Floats32
    simulated: Floats32
    velocity: Floats32
    turns: Floats32


class RecurrenceLesson(Lesson):
    """Tensors of f_β and f_γ, and the mean distance of whole rolled-out sequences to the simulator's."""

    def __init__(self, weights: Weights, bind: Bind, table: Table, pivot: Floats, config: RecurrenceTraining):
        self.table, self.config = table, config
        self._inputs, self._bind = weights.inputs, bind
        self._pivot = torch.from_numpy(pivot.astype(np.float32))
        held = set(weights.note.held)
        people = table.groups[:, 0].tolist()
        self.training = [k for k, person in enumerate(people) if person not in held]
        self.judged = [k for k, person in enumerate(people) if person in held][:8]
        if not self.training:
            raise InputError("training: no sequence is of a person that the network has learned from")
        self._waves = basis(weights.mean.vertices)
        self._motion = lru_cache(maxsize=KEPT)(self._read)
        layers = recurrence_layers(len(weights.code_mean), config.position, config.hidden)
        torch.manual_seed(config.seed)
        self.network: Tensors = draw_layers(layers, WITHOUT_BIAS)
        for name, logit in FAST.items():
            self.network[f"{name}_rest.2.weight"] *= 0.1
            self.network[f"{name}_rest.2.bias"] = torch.full((1,), logit)
        rng, mean = np.random.default_rng(config.seed), weights.mean
        positions = draw_positions(mean.vertices, mean.vertex_normals, config.position, rng)
        self.network["position"] = torch.from_numpy(positions)
        for value in self.network.values():
            value.requires_grad_()

    def loss(self, done: float, rng: np.random.Generator) -> torch.Tensor:
        """Return the mean distance [mm] over all frames of some sequences."""
        rows = rng.choice(self.training, size=min(self.config.batch, len(self.training)), replace=False)
        return torch.stack([self._error(self._motion(int(row))) for row in rows]).mean()

    def errors(self) -> Mapping[str, float]:
        """Return the same on held-out people's sequences, and that of static answers alone."""
        if not self.judged:
            return {}
        motions = [self._motion(row) for row in self.judged]
        with torch.no_grad():
            learned = float(np.mean([float(self._error(motion)) for motion in motions]))
        still = float(np.mean([np.linalg.norm(m.static - m.simulated, axis=-1).mean() for m in motions]))
        return {"network": learned, "static": still}

    def _error(self, motion: _Motion) -> torch.Tensor:
        code, parameters = (torch.from_numpy(part) for part in (motion.code[None], motion.parameters))
        beta, gamma = coefficients(self.network, code, parameters)
        rolled = roll(beta, gamma, motion, self._pivot)
        return torch.linalg.vector_norm(rolled - torch.from_numpy(motion.simulated), dim=-1).mean()

    def _read(self, index: int) -> _Motion:
        table, row = self.table, self.table[index]
        face = table.face(index)
        rig = self._bind(face)
        blended = face.blend(row["weights"])
        turns = row["rotations"].astype(np.float64)
        before = row["before"].astype(np.float32)
        return _Motion(
            code=self._inputs.code(face.code).astype(np.float32),
            parameters=np.clip(self._waves @ face.parameters.coefficients.T, -1.0, 1.0).astype(np.float32),
            static=np.stack([rig.frame(weights) for weights in row["weights"]]),
            simulated=(blended + row["corrected"]).astype(np.float32),
            velocity=before[0] - before[1],
            turns=np.concatenate([extrapolate_turns(turns), turns]).astype(np.float32),
        )


def find_mean_pivot(heads: Heads) -> Floats:
    """Find what the head of a space's mean person turns about, shape (3,); InputError where nobody fits heads."""
    mean = heads.people.mean
    head = heads.fit(Person(np.zeros(0), mean, np.zeros((52, len(mean.vertices), 3))))
    return find_pivot(head)


def roll(beta: torch.Tensor, gamma: torch.Tensor, motion: _Motion, pivot: torch.Tensor) -> torch.Tensor:
    """Roll Eq. 21 out over a sequence from its own static answer and velocity, shape (L, n, 3); see `DynamicRig`."""
    static, turns = torch.from_numpy(motion.static), torch.from_numpy(motion.turns)
    alpha = 0.5 * (1.0 - gamma + beta)
    with torch.no_grad():
        root = torch.sqrt((alpha**2 - beta).to(torch.complex64))
        squared = torch.abs(torch.log(alpha + root + 1e-9) * torch.log(alpha - root + 1e-9))
        driven = (gamma / squared.clamp(min=1e-9))[:, None]
    a, b = (2.0 * alpha)[:, None], beta[:, None]
    last = static[0]
    before = last - torch.from_numpy(motion.velocity)
    frames = []
    for k, still in enumerate(static):
        earlier, later, now = turns[k], turns[k + 1], turns[k + 2]
        x, y = last - pivot, before - pivot
        lag = (2.0 * x @ later.T - y @ earlier.T) @ now - (2.0 * x - y)
        moved = still + a * (last - still) - b * (before - still) + driven * lag
        before, last = last, moved
        frames.append(moved)
    return torch.stack(frames)
