"""Training of the tables of offset and responses.

Networks and tables descend at a sample of vertices, whose faces are in memory. Then the tables of all vertices are
solved for, by ridge regression at each. A network sees a vertex by p there, the code and its place, and needs few
vertices: of those that it never saw it leaves as much. So a step costs a twentieth of one that reads its faces anew.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats32, Ints, Surface
from ...lhm.base.progress import OnProgress
from ..rigs.rig import WEIGHTS
from .features import BONES, EFFECTS
from .layers import EVERY
from .modal_faces import FaceArrays, LessonFaces
from .tables import (
    IN_FILE,
    MIXERS,
    QUIET,
    WITHOUT_BIAS,
    Product,
    Tables,
    TableSizes,
    compress,
    mix_effects,
    mix_responses,
    scale_bones,
    table_layers,
)
from .trainer import (
    Lesson,
    Trainer,
    TrainerConfig,
    draw_layers,
    draw_positions,
    open_device,
    quieten,
    to_tensors,
    torch,
)
from .weights import Weights

Options = TypeVar("Options", bound=TrainerConfig)
LEARNED = ("response", "effect", "lag")
"""Beginnings of the names of arrays that this training learns."""
READ = 16
"""Faces that are read at a time: more are faster, and take 60 MB each where all vertices are."""
AT_FIRST = 4
"""Of so many faces one tells by how much squares of errors count."""


@dataclass(frozen=True)
class TableTraining:
    """Options of the training of tables, each with its reason.

    A ridge is a penalty in shares of the mean square of what a table is multiplied by.
    """

    learning_rate: float = 8e-3  # the highest, of AdamW
    matrix_rate: float = 0.01  # the highest, of Muon: AdamW alone takes three times the steps
    weight_decay: float = 0.05  # of networks
    faces: int = 24  # per step
    vertices: int = 64  # of each
    sampled: int = 512  # vertices at which networks learn: 340 kB a face; with 256 a tenth more is left at others
    response_ridge: float = 1e-3
    effect_ridge: float = 3e-5  # an effect is zero in most faces
    mixed_ridge: float = 0.1  # of mixed effects, which few faces tell apart
    carry_ridge: float = 1e-5  # of how bones carry the mean face
    coded_ridge: float = 5.0  # of how that follows the code, over the number of faces: few tell its columns apart
    response_floor: float = 0.002  # [mm] added to a face's responses, by which errors of them count
    offset_floor: float = 0.1  # [mm] added to how far it moves beyond its bones, by which errors of its offset count
    rounding: float = 1e-6  # [mm²] added to a squared distance, which at zero has no derivative

    def schedule(self, rest: TrainerConfig) -> TrainerConfig:
        """Return the options of the steps at the tables, by those of the steps that follow: half of the time goes."""
        return TrainerConfig(
            seed=rest.seed,
            steps=OF_TABLES * rest.steps,
            learning_rate=self.learning_rate,
            one_cycle=True,
            weight_decay=self.weight_decay,
            matrix_rate=self.matrix_rate,
            clip=1.0,
            validate_every=OF_TABLES * rest.validate_every,
            hours=None if rest.hours is None else FOR_TABLES * rest.hours,
            device=rest.device,
        )


OF_TABLES = 4
"""Steps at the tables for each of those that follow, which read their faces and cost ten times as much."""
FOR_TABLES = 0.5
"""Share of a training's processor hours."""


def draw_mixers(sizes: TableSizes, mean: Surface, code_size: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Draw the layers that mix tables, and the places of vertices."""
    layers = draw_layers(table_layers(sizes, code_size), WITHOUT_BIAS)
    quieten(layers, QUIET)
    places = {f"{k}_position": draw_positions(mean.vertices, mean.vertex_normals, sizes.position, rng) for k in MIXERS}
    return {name: value.numpy() for name, value in layers.items()} | places


def learn_tables(
    data: LessonFaces,
    start: Weights | None,
    shapes: Mapping[str, tuple[int, ...]],
    draw: Callable[[], dict[str, np.ndarray]],
    options: TableTraining,
    rest: TrainerConfig,
    state: str | PathLike[str] | None,
    on_progress: OnProgress,
) -> tuple[dict[str, np.ndarray], list[dict[str, float]]]:
    """Return the arrays with which the steps that follow begin, tables among them, and the curve; see `train_tables`.

    Drawn and trained, or those of earlier weights: these keep their tables where there are frames and no more faces.
    Raises InputError for a `start` without arrays of these shapes.
    """
    network = draw() if start is None else _continue(start, data, shapes)
    if start is not None and data.extra_faces is None and data.corpus.has_frames:
        return network, []
    components = {name: shapes[f"{name}_table"][0] for name in MIXERS}
    learned, curve = train_tables(data, network, components, options, rest, state, on_progress)
    return network | learned, curve


def _continue(start: Weights, data: LessonFaces, expected: Mapping[str, tuple[int, ...]]) -> dict[str, np.ndarray]:
    start.check_mesh(data.corpus.mean)
    if any(name not in start.network or start.network[name].shape != shape for name, shape in expected.items()):
        raise InputError(
            f"training: weights of a {start.kind} network of other sizes than this one's; begin with others"
        )
    return {name: start.network[name] for name in expected}


def train_tables(
    data: LessonFaces,
    network: Mapping[str, np.ndarray],
    components: Mapping[str, int],
    options: TableTraining,
    rest: TrainerConfig,
    state: str | PathLike[str] | None,
    on_progress: OnProgress,
) -> tuple[dict[str, np.ndarray], list[dict[str, float]]]:
    """Teach the layers of `network` that mix tables, then solve for the tables of all vertices.

    Return both as a file has them, and the curve. components: how many of each table are kept. rest: options of the
    steps that follow. With `state`, a file of those steps, these are kept beside it.
    """
    lesson = TableLesson(data, network, options, rest.seed, open_device(rest.device), on_progress)
    trainer = Trainer(lesson, options.schedule(rest))
    trainer.train(None if state is None else Path(state).with_suffix(".tables.pt"), on_progress)
    begin = time.perf_counter()
    tables = compress(lesson.solve_all(on_progress).factorise(**components))
    trainer.curve[-1]["seconds"] += time.perf_counter() - begin
    mixers = {name: value for name, value in trainer.arrays().items() if name in network}
    return mixers | tables, trainer.curve


class TableLesson(Lesson):
    """The networks that mix tables, and the tables of a sample of vertices, in training there."""

    slow, slow_rate = ("tables.",), 0.03
    """They begin where no network mixes them, and are solved for at the end."""
    matrices = frozenset(f"{name}_{layer}.weight" for name in MIXERS for layer in ("in", "code", "middle", "share"))

    def __init__(
        self,
        data: LessonFaces,
        network: Mapping[str, np.ndarray],
        options: TableTraining,
        seed: int,
        device: Any,
        on_progress: OnProgress,
    ):
        self.data, self.options, self.device, self.dtype = data, options, device, torch.float32
        self.sample = sample_vertices(data, options.sampled, np.random.default_rng([seed, 3]))
        parts = []
        for arrays in data.read_teaching(READ, self.sample):
            parts.append(arrays)
            on_progress("training: faces read", min(READ * len(parts) / data.count, 1.0))
        learned = {k: value for k, value in network.items() if k.startswith(LEARNED) and not k.endswith(IN_FILE)}
        self.network = to_tensors(learned, device)
        always = self.solve(parts, self.sample, mixed=False)
        self.arrays = FaceArrays(*map(np.concatenate, zip(*parts, strict=True)))
        self.held = data.read_held(self.sample)
        for name, table in (("responses", always.responses), ("effects", always.effects)):
            mixed = len(learned[f"{name[:-1]}_share.weight"])
            still = torch.zeros(mixed, *table.shape[1:])
            self.network[f"tables.{name}"] = torch.cat([still, torch.from_numpy(table)]).to(device)
        for name, value in self.network.items():
            value.requires_grad_(not name.endswith("_position"))
        self.about = [f"tables of {data.count} faces"]

    def loss(self, done: float, rng: np.random.Generator) -> torch.Tensor:
        """Return mean distances of offsets and responses, in each face's scale."""
        rows = rng.integers(len(self.arrays.codes), size=self.options.faces)
        places = np.sort(rng.permutation(len(self.sample))[: self.options.vertices])
        return self.measure(self.arrays.take(rows, places), places, scaled=True).sum()

    def measure(self, arrays: FaceArrays, places: Any, *, scaled: bool) -> torch.Tensor:
        """Return the mean distance of offsets beyond bones, and of responses, of faces at places of the sample.

        In each face's scale, or in mm where not `scaled`.
        """
        faces, vertices = self._to_tensors(arrays), self.sample[places]
        shares, lag, strengths = self._mix(faces, vertices)
        responses, effects = (self.network[f"tables.{name}"][:, :, places] for name in ("responses", "effects"))
        mixed = _apply_shares(shares, responses) - lag[..., None] * faces.shapes
        errors = _apply_strengths(strengths, effects) - faces.beyond, mixed - faces.responses
        squares = [error.square().sum(dim=-1) + self.options.rounding for error in errors]
        distances = torch.stack([square.sqrt().flatten(1).mean(dim=1) for square in squares], dim=1)
        relative = distances / self._scales(faces)
        return (relative if scaled else distances).mean(dim=0)

    def errors(self) -> dict[str, float]:
        """Return mean errors of offset beyond bones, and of responses [mm], at the sample on held-out people."""
        with torch.no_grad():
            offset, responses = self.measure(self.held, EVERY, scaled=False).tolist()
        return {"offset": offset, "responses": responses}

    def solve_all(self, on_progress: OnProgress) -> Solved:
        """Solve for the tables of all vertices: by squares of errors of some faces, then by errors of all.

        On people held out the second leaves 3 to 5 % less.
        """

        def parts(every: int):
            for number, arrays in enumerate(self.data.read_teaching(READ, every=every)):
                done = READ * number * every / self.data.count
                on_progress(f"training: tables of all vertices by {'all' if every == 1 else 'some'} faces", done)
                yield arrays

        return self.solve(parts(1), EVERY, before=self.solve(parts(AT_FIRST), EVERY))

    def solve(
        self, parts: Iterable[FaceArrays], vertices: Any, *, mixed: bool = True, before: Solved | None = None
    ) -> Solved:
        """Solve for the tables of some vertices over faces; with `mixed` off, for those that always count, alone.

        With tables `before`, squares count over what these miss.
        """
        responses, effects, carry = (Regression(self.device) for _ in Tables._fields)
        known = None if before is None else [torch.from_numpy(table).to(self.device) for table in before[:2]]
        with torch.no_grad():
            for part in parts:
                faces = self._to_tensors(part)
                shares, lag, strengths = self._mix(faces, vertices)
                moved = faces.responses + lag[..., None] * faces.shapes
                if not mixed:
                    shares, strengths = shares[..., -1:], strengths[..., -EFFECTS:]
                of_offset, of_responses = self._scales(faces)[:, None].unbind(dim=-1)
                if known is not None:
                    left = _apply_shares(shares, known[0]) - moved, _apply_strengths(strengths, known[1]) - faces.beyond
                    of_responses = balance(of_responses, torch.linalg.vector_norm(left[0], dim=-1).mean(dim=-1))
                    of_offset = balance(of_offset, torch.linalg.vector_norm(left[1], dim=-1))
                responses.add(shares, moved.flatten(2), of_responses)
                effects.add(strengths, faces.beyond, of_offset)
                scaled = scale_bones(faces.codes, faces.bones)[:, None]
                carry.add(scaled, faces.carried.flatten(1)[:, None], torch.ones_like(scaled[..., 0]))
        options = self.options
        coded = BONES * self.data.code_size, options.coded_ridge / carry.count
        carried = carry.solve(options.carry_ridge, coded)
        of_effects = effects.gram.unflatten(1, (-1, EFFECTS)).unflatten(3, (-1, EFFECTS))
        return Solved(
            _order(responses.solve(options.response_ridge), WEIGHTS),
            _order(effects.solve(options.mixed_ridge, (EFFECTS, options.effect_ridge)), EFFECTS),
            carried.reshape(-1, BONES, carried.shape[-1] // 3, 3),
            responses.gram.cpu().numpy(),
            of_effects.diagonal(dim1=2, dim2=4).sum(dim=-1).cpu().numpy(),
        )

    def _mix(self, faces: FaceArrays, vertices: Any):
        """Shares of responses, the lag, and strengths of effects of faces at some vertices."""
        code = faces.codes[:, None]
        shares, lag = mix_responses(self.network, faces.local, code, vertices)
        of_tables, strengths = mix_effects(self.network, faces.local, code, faces.effects, vertices)
        return shares, lag, (of_tables[..., :, None] * strengths[..., None, :]).flatten(2)

    def _scales(self, faces: FaceArrays) -> torch.Tensor:
        """Return the lengths [mm] over which errors of offset and responses count, shape (b, 2)."""
        floors = [self.options.offset_floor, self.options.response_floor]
        return faces.sizes + torch.tensor(floors, device=self.device)

    def _to_tensors(self, arrays: FaceArrays) -> FaceArrays:
        return FaceArrays(*(torch.from_numpy(array).to(self.device, self.dtype) for array in arrays))


class Solved(NamedTuple):
    """Tables as they are solved for: responses (k, 52, v, 3), effects (k, EFFECTS, v, 3), and how bones carry [mm].

    Sums of products of shares over faces, each in its scale, (v, k, k), tell how much a part of a table counts.
    """

    responses: Floats32
    effects: Floats32
    carry: Floats32
    response_shares: Floats32
    effect_shares: Floats32

    def factorise(self, response: int, effect: int) -> Tables:
        """Keep so many components of responses, and of effects, over all vertices: those that count most."""
        return Tables(
            keep_components(self.responses, self.response_shares, response),
            keep_components(self.effects, self.effect_shares, effect),
            self.carry,
        )


def keep_components(table: Floats32, shares: Floats32, count: int) -> Product:
    """Keep so many components of a table (k, columns, v, 3), those by which faces with such `shares` move most.

    With sums of products of shares L L^T, singular values of L^T M are sizes of what faces show.
    """
    k, columns, n, _ = table.shape
    most = min(k, 3 * columns, MOST_COMPONENTS)
    sizes, mix, values = np.zeros((n, most)), np.zeros((n, most, k), np.float32), np.zeros((n, most, columns, 3))
    for v in range(n):
        counts, turned = np.linalg.eigh(shares[v].astype(np.float64))
        roots = np.sqrt(np.maximum(counts, LEAST_SHARE * max(counts[-1], 1e-12)))
        shown = roots[:, None] * (turned.T @ table[:, :, v].reshape(k, -1))
        left, size, right = np.linalg.svd(shown, full_matrices=False)
        sizes[v] = size[:most]
        mix[v] = ((turned / roots) @ left[:, :most]).T
        values[v] = (size[:most, None] * right[:most]).reshape(most, columns, 3)
    kept = np.zeros(n * most, dtype=bool)
    kept[np.argsort(-sizes, axis=None, kind="stable")[:count]] = True
    kept = kept.reshape(n, most)
    first = np.concatenate([[0], np.cumsum(kept.sum(axis=1))])
    return Product(first, mix[kept], values[kept].astype(np.float32))


MOST_COMPONENTS = 64
"""Components of a table that one vertex may keep."""
LEAST_SHARE = 1e-6
"""Least eigenvalue that sums of products of shares count with, in shares of the largest."""


def _apply_shares(shares: torch.Tensor, table: torch.Tensor) -> torch.Tensor:
    """Mix tables (k, 52, v, 3) of responses by shares (b, v, k): (b, v, 52, 3)."""
    return torch.einsum("bvk,kjvc->bvjc", shares, table)


def _apply_strengths(strengths: torch.Tensor, table: torch.Tensor) -> torch.Tensor:
    """Mix tables (k, EFFECTS, v, 3) of effects by strengths (b, v, k EFFECTS): (b, v, 3)."""
    return torch.einsum("bve,evc->bvc", strengths, table.flatten(0, 1))


def balance(scale: torch.Tensor, missed: torch.Tensor) -> torch.Tensor:
    """Return the lengths (b, v) over which squares of errors count as these do in a scale (b, 1), where some (b, v)."""
    return torch.sqrt(scale * torch.maximum(missed, LEAST_MISSED * scale))


LEAST_MISSED = 0.02
"""Share of a face's scale that an error has at the least, where it says how much its square counts."""


class Regression:
    """Normal equations at each vertex, over faces: factors (b, v, k) that multiply a table (v, k, m) give (b, v, m)."""

    def __init__(self, device: Any):
        self.gram = self.pulled = torch.zeros((), device=device)
        self.count = 0

    def add(self, factors: torch.Tensor, values: torch.Tensor, scales: torch.Tensor) -> None:
        """Add faces, whose errors count in scales (b, 1), or (b, v) of each vertex."""
        left, right = ((array / scales[..., None]).transpose(0, 1).contiguous() for array in (factors, values))
        if self.count == 0:
            self.gram, self.pulled = left.mT @ left, left.mT @ right
        else:  # in place: gigabytes
            self.gram.baddbmm_(left.mT, left)
            self.pulled.baddbmm_(left.mT, right)
        self.count += len(scales)

    def solve(self, ridge: float, last: tuple[int, float] = (0, 0.0)) -> Floats32:
        """Return the table under a ridge, and so many last factors under another, in shares of their squares."""
        size = self.gram.diagonal(dim1=1, dim2=2).double().mean(dim=0).clamp_min(1e-12)
        count, other = last
        ridges = torch.full_like(size, ridge)
        ridges[len(size) - count :] = other
        answers = []
        for gram, pulled in zip(self.gram.split(VERTICES), self.pulled.split(VERTICES), strict=True):
            answers.append(torch.linalg.solve(gram.double() + torch.diag(ridges * size), pulled.double()).float())
        return torch.cat(answers).cpu().numpy()


VERTICES = 256
"""Vertices solved for at a time, in double precision."""


def _order(table: Floats32, columns: int) -> Floats32:
    """Return a table (n, k columns, 3), or (n, k, columns 3), as (k, columns, n, 3)."""
    return np.ascontiguousarray(table.reshape(len(table), -1, columns, 3).transpose(1, 2, 0, 3))


def sample_vertices(data: LessonFaces, count: int, rng: np.random.Generator) -> Ints:
    """Draw about so many vertices, with each its mirror image; in their order."""
    drawn, mirror = rng.permutation(data.vertex_count), data.features.mirror
    if mirror is None:
        return np.sort(drawn[:count])
    half = drawn[drawn <= mirror[drawn]][: max(1, count // 2)]
    return np.unique(np.concatenate([half, mirror[half]]))
