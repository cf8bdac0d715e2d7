"""The one trainer: options, a visible loop, and a state that resumes."""

from __future__ import annotations

import io
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...lhm.base.errors import InputError, MissingDependencyError
from ...lhm.base.files.atomic import write_whole
from ...lhm.base.mesh import Floats, Floats32
from ...lhm.base.progress import OnProgress, describe_left, silent

try:
    import torch
    from torch import nn
except ImportError as error:
    raise MissingDependencyError(f"training needs torch ({error}): pip install 'softdeca[train]'") from None

__all__ = [
    "Lesson",
    "Trainer",
    "TrainerConfig",
    "draw_layers",
    "draw_positions",
    "hold_out_people",
    "join_curves",
    "nn",
    "open_device",
    "quieten",
    "to_tensors",
    "torch",
]

Tensors = dict[str, torch.Tensor]


@dataclass(frozen=True)
class TrainerConfig:
    """Options that all trainings share, each with its reason."""

    seed: int = 0
    steps: int = 3600
    learning_rate: float = 4e-3  # the highest, of AdamW
    one_cycle: bool = False  # super-convergence (Smith and Topin 2019); otherwise a warm-up and a cosine
    warm_up: int = 1  # steps, before a cosine
    final_rate: float = 0.0  # where a cosine ends
    falls: Literal["cosine", "line"] = "cosine"  # how the rate gets there
    weight_decay: float = 0.0
    matrix_rate: float = 0.0  # the highest, of Muon, where a lesson has matrices for it
    clip: float | None = None  # norm of the gradient beyond which it is shortened
    validate_every: int = 400  # steps between two points of the curve
    best_by: str = ""  # a number of the curve: the network of its least value is the answer; otherwise the last
    patience: int = 0  # points of the curve without a better one after which it ends; 0: after all steps
    hours: float | None = None  # of a processor for all of a lesson, in place of `steps`: solves and validation count
    device: str = "cpu"


class Lesson(ABC):
    """A training's subject: a network's tensors, and the loss of a step."""

    network: Tensors
    slow: tuple[str, ...] = ()
    """Beginnings of names of tensors that learn at `slow_rate` of the rate, without decay."""
    slow_rate: float = 0.3
    matrices: frozenset[str] = frozenset()
    """Names of matrices that learn by Muon (Jordan et al. 2024); all else learns by AdamW."""
    about: Sequence[str] = ()
    """Description that a kept state has to match."""
    begun: float
    """Processor time [s] when it began to be made: what it solves before its first step counts, too."""

    def __new__(cls, *given: Any, **named: Any) -> Lesson:
        """Begin to count its time."""
        lesson = super().__new__(cls)
        lesson.begun = time.process_time()
        return lesson

    @abstractmethod
    def loss(self, done: float, rng: np.random.Generator) -> torch.Tensor:
        """Return the loss of a step's batch; `done`: the share of all steps that lies behind."""

    def errors(self) -> Mapping[str, float]:
        """Return mean vertex errors [mm] on held-out people; by default nobody is held out."""
        return {}


class Muon(torch.optim.Muon):
    """torch's Muon with the root mean squares of AdamW's steps, in float32.

    torch multiplies in bfloat16, which takes a processor that lacks it 25 times as long.
    """

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        for group in self.param_groups:
            for matrix in group["params"]:
                momentum = self.state[matrix].setdefault("momentum_buffer", torch.zeros_like(matrix))
                momentum.lerp_(matrix.grad, 1.0 - group["momentum"])
                update = _orthogonalise(matrix.grad.lerp(momentum, group["momentum"]), group)
                matrix.mul_(1.0 - group["lr"] * group["weight_decay"])
                matrix.add_(update, alpha=-0.2 * max(matrix.shape) ** 0.5 * group["lr"])


def _orthogonalise(matrix: torch.Tensor, group: Mapping[str, Any]) -> torch.Tensor:
    """Return a matrix with its singular values brought near one, by iterations of Newton and Schulz."""
    a, b, c = group["ns_coefficients"]
    is_tall = matrix.shape[0] > matrix.shape[1]
    x = matrix.T if is_tall else matrix
    x = x / x.norm().clamp(min=group["eps"])
    for _ in range(group["ns_steps"]):
        gram = x @ x.T
        x = a * x + (b * gram + c * gram @ gram) @ x
    return x.T if is_tall else x


class Trainer:
    """A training between two steps, which depend on seed and number alone; `curve` has a point per validation."""

    def __init__(self, lesson: Lesson, config: TrainerConfig):
        self.lesson, self.config, self._about = lesson, config, [repr(config), *lesson.about]
        self.optimisers = self._open_optimisers()
        self.steps = config.steps if config.hours is None else self._count_steps(config.hours)
        self.schedules = [self._schedule(optimiser) for optimiser in self.optimisers]
        self.step, self.seconds, self._first = 0, 0.0, time.process_time()
        self.curve: list[dict[str, float]] = []
        self.best: Tensors = self._copy() if config.best_by else {}
        self.least = float("inf")

    def train(self, state: str | PathLike[str] | None = None, on_progress: OnProgress = silent) -> None:
        """Make all steps; with `state`, a file, go on from what is kept there, and keep there now and then."""
        config = self.config
        if state is not None and Path(state).is_file():
            self.restore(state)
            self._first -= self.seconds  # of the runs before
            self.lesson.begun -= self.seconds
        begin, first = time.perf_counter(), self.step

        def tell() -> None:
            left = describe_left(time.perf_counter() - begin, (self.step - first) / (self.steps - first))
            on_progress(f"training: step {self.step} of {self.steps}{left}", self.step / self.steps)

        while self.step < self.steps and not self._has_stalled():
            steps = min(config.validate_every - self.step % config.validate_every, self.steps - self.step)
            self.run(steps if config.hours is None else min(steps, max(1, self.steps // CHECKS)), tell)
            if config.hours is not None:
                self._fit_into(config.hours)
            if state is not None:
                self.keep(state)
            errors = {name: value for name, value in self.curve[-1].items() if name not in ("step", "seconds", "loss")}
            on_progress(
                "training: held-out people, mm: " + ", ".join(f"{name} {value:.4f}" for name, value in errors.items()),
                self.step / self.steps,
            )

    def _has_stalled(self) -> bool:
        """Whether the latest points of the curve, as many as `patience`, have no better one."""
        values = [point[self.config.best_by] for point in self.curve] if self.config.patience else []
        return bool(values) and len(values) - 1 - int(np.argmin(values)) >= self.config.patience

    def _fit_into(self, hours: float) -> None:
        """Change the number of steps so that all of the lesson takes these processor hours, by what it took so far."""
        now = time.process_time()
        left, each = 3600.0 * hours - (now - self.lesson.begun), (now - self._first) / self.step
        most = self.steps if self.config.one_cycle else np.inf  # whose rates are fixed for so many
        self.steps = int(min(self.step + max(left / each, 0.0), most))

    def run(self, steps: int, on_step: Callable[[], None] = lambda: None) -> None:
        """Make some steps, then add a point to the curve; InputError for a loss that is not finite."""
        begin, total = time.perf_counter(), 0.0
        first = self.step
        for _ in range(steps):
            rng = np.random.default_rng([self.config.seed, 1, self.step])
            total += self._learn(self.step / self.steps, rng)
            for schedule in self.schedules:
                schedule.step()
            self.step += 1
            if not np.isfinite(total):
                raise InputError(f"training: the loss is not finite at step {self.step}; take a lower learning rate")
            on_step()
        self.seconds += time.perf_counter() - begin
        errors = {name: float(value) for name, value in self.lesson.errors().items()}
        if self.config.best_by and errors[self.config.best_by] < self.least:
            self.least, self.best = errors[self.config.best_by], self._copy()
        self.curve.append({"step": self.step, "seconds": self.seconds, "loss": total / (self.step - first), **errors})

    def _learn(self, done: float, rng: np.random.Generator) -> float:
        """Make one step, and return its loss."""
        loss = self.lesson.loss(done, rng)
        for optimiser in self.optimisers:
            optimiser.zero_grad()
        loss.backward()
        if self.config.clip is not None:
            learned = [value for value in self.lesson.network.values() if value.requires_grad]
            torch.nn.utils.clip_grad_norm_(learned, self.config.clip)
        for optimiser in self.optimisers:
            optimiser.step()
        return float(loss.detach())

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the trained network: the best of the curve, or as it is now."""
        tensors = self.best if self.config.best_by else self._copy()
        return {name: value.cpu().numpy() for name, value in tensors.items()}

    def keep(self, path: str | PathLike[str]) -> None:
        """Write all that `restore` needs, whole or not at all."""
        buffer = io.BytesIO()
        parts = {name: getattr(self, name) for name in _VALUES}
        torch.save(
            {
                "of": self._about,
                "network": self._copy(),
                "optimisers": [optimiser.state_dict() for optimiser in self.optimisers],
                "schedules": [schedule.state_dict() for schedule in self.schedules],
                **parts,
            },
            buffer,
        )
        write_whole(Path(path), buffer.getvalue())

    def restore(self, path: str | PathLike[str]) -> None:
        """Go on where `keep` was called last; InputError for a damaged file, and for one of another training."""
        try:
            state: dict[str, Any] = torch.load(path, weights_only=True)
            is_same = state["of"] == self._about
        except Exception as error:
            raise InputError(f"{path}: damaged, or no state of a training ({type(error).__name__})") from None
        if not is_same:
            raise InputError(f"{path}: of another training (config or corpus); remove it, or name another file")
        self._put_back(state["network"])
        for optimiser, kept in zip(self.optimisers, state["optimisers"], strict=True):
            optimiser.load_state_dict(kept)
        for schedule, kept in zip(self.schedules, state["schedules"], strict=True):
            schedule.load_state_dict(kept)
        for name in _VALUES:
            setattr(self, name, state[name])

    def _copy(self) -> Tensors:
        return {name: value.detach().clone() for name, value in self.lesson.network.items()}

    def _put_back(self, network: Tensors) -> None:
        with torch.no_grad():
            for name, value in network.items():
                self.lesson.network[name].copy_(value)

    def _open_optimisers(self) -> list[torch.optim.Optimizer]:
        lesson, rate, decay = self.lesson, self.config.learning_rate, self.config.weight_decay
        learned = {name: value for name, value in lesson.network.items() if value.requires_grad}
        matrices = [learned.pop(name) for name in sorted(lesson.matrices)]
        slow = [value for name, value in learned.items() if name.startswith(lesson.slow)]
        rest = [value for name, value in learned.items() if not name.startswith(lesson.slow)]
        groups = [{"params": rest, "lr": rate, "weight_decay": decay}]
        groups += [{"params": slow, "lr": lesson.slow_rate * rate, "weight_decay": 0.0}] if slow else []
        optimisers: list[torch.optim.Optimizer] = [torch.optim.AdamW(groups, fused=True)]
        if matrices:
            optimisers.append(Muon(matrices, lr=self.config.matrix_rate, weight_decay=decay))
        return optimisers

    def _count_steps(self, hours: float) -> int:
        """Count the steps that fit into what is left of these processor hours, by how long some take, then undone."""
        before, seconds = self._copy(), []
        for _ in range(TRIED):
            begin = time.process_time()
            self._learn(0.0, np.random.default_rng(0))
            seconds.append(time.process_time() - begin)
        self._put_back(before)
        self.optimisers = self._open_optimisers()
        return max(1, int((3600.0 * hours - (time.process_time() - self.lesson.begun)) / np.median(seconds)))

    def _schedule(self, optimiser: torch.optim.Optimizer) -> torch.optim.lr_scheduler.LRScheduler:
        if not self.config.one_cycle:
            return torch.optim.lr_scheduler.LambdaLR(optimiser, self._share_of_rate)
        highest, momentum = [group["lr"] for group in optimiser.param_groups], isinstance(optimiser, torch.optim.AdamW)
        return torch.optim.lr_scheduler.OneCycleLR(
            optimiser, highest, total_steps=self.steps + 1, pct_start=0.05, cycle_momentum=momentum
        )

    def _share_of_rate(self, step: int) -> float:
        last = self.config.final_rate / self.config.learning_rate
        done = step / self.steps
        left = 1.0 - done if self.config.falls == "line" else 0.5 * (1.0 + np.cos(np.pi * done))
        return float((last + (1.0 - last) * left) * min(1.0, (step + 1) / self.config.warm_up))


_VALUES = ("steps", "step", "seconds", "curve", "best", "least")
"""Attributes of a trainer that its state has as they are."""
QUIETER = 0.1
"""Size of weights over the usual one, in layers that begin near zero."""
TRIED = 5
"""Steps by which it is found how long one takes."""
CHECKS = 10
"""So often, at least, a training looks at the hours that are left."""


def join_curves(first: list[dict[str, float]], then: list[dict[str, float]]) -> list[dict[str, float]]:
    """Return a curve that goes on where another, which may have no point, has ended."""
    if not first:
        return then
    last = first[-1]
    return first + [point | {name: last[name] + point[name] for name in ("step", "seconds")} for point in then]


def hold_out_people(people: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Choose a share of people, at least one, for the errors of a curve; numbers in their order."""
    return np.sort(rng.permutation(people)[: max(1, round(share * len(people)))])


def draw_layers(layers: Mapping[str, tuple[int, int]], without_bias: Iterable[str] = ()) -> Tensors:
    """Draw layers of (outputs, inputs) as `torch.nn.Linear` begins, in their order."""
    network: Tensors = {}
    for name, (outputs, inputs) in layers.items():
        layer = nn.Linear(inputs, outputs, bias=name not in without_bias)
        network |= {f"{name}.{part}": value.detach() for part, value in layer.named_parameters()}
    return network


def quieten(network: Tensors, layers: Iterable[str]) -> None:
    """Let layers begin near zero: QUIETER of their usual weights, and no bias."""
    for name in layers:
        network[f"{name}.weight"] *= QUIETER
        network[f"{name}.bias"] *= 0.0


def draw_positions(places: Floats, normals: Floats, size: int, rng: np.random.Generator) -> Floats32:
    """Draw random Fourier features of places [mm] and their normals, both (n, 3), unit variance, shape (n, size).

    They are a start for a trained table π: neighbours start alike, and the two sides of a lip, close in space, differ
    by their normals.
    """
    centres = (places - places.mean(axis=0)) / np.sqrt(places.var(axis=0).sum())
    length = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    inputs = np.hstack([2.0 * centres, 0.5 * normals / length])
    frequencies = rng.normal(size=(inputs.shape[1], size))
    features = np.cos(inputs @ frequencies + rng.uniform(0.0, 2.0 * np.pi, size))
    return ((features - features.mean(axis=0)) / features.std(axis=0)).astype(np.float32)


def to_tensors(arrays: Mapping[str, np.ndarray], device: torch.device) -> Tensors:
    """Copy arrays to a device."""
    return {name: torch.tensor(value, device=device) for name, value in arrays.items()}


def open_device(name: str) -> torch.device:
    """Return a device by name, as "cpu" or "cuda"; InputError for one that is not there."""
    try:
        device = torch.device(name)
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0][:80]
        raise InputError(f"training: no device {name!r} ({reason})") from None
    return device
