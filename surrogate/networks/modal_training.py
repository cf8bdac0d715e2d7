"""Training of the modal network: its start from principal components, and its loss on faces and frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from os import PathLike

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32, Ints, Surface
from ...lhm.base.progress import OnProgress, silent
from ..corpus.face import KeptFace
from ..corpus.reading import Faces
from ..surface_hash import surface_hash
from .features import EFFECTS, Features, Inputs, seen_ranges
from .modal import (
    LAYERS,
    PARTS,
    QUIET,
    TABLES,
    WITHOUT_BIAS,
    ModalConfig,
    basis,
    bind_modal,
    hidden_features,
    neutral,
    remainder,
)
from .response_tables import compress, expand, mix, solve_tables
from .ridge import find_components
from .trainer import Trainer, TrainerConfig, draw_layers, hold_out_people, start_processes, torch
from .weights import TrainingNote, Weights

Move = tuple[Floats, Floats, np.ndarray]
"""A face's p at the vertices (n, P), its skin and how far that goes (n, 3) [mm]."""
AGAIN = 0.3
"""Of the learning rate, where a training begins with weights that know most already."""
EXPRESSIVE = ("lag", "response_", "remainder_", "modes.2")
"""What a training that begins with weights, and has no `neutrals`, goes on with: what w does. Neutral faces stay as
they were learned: a corpus of a few hundred faces alone leaves 5 to 10 % more of them."""
SOLVED = ("response_table", "response_scale")
"""What a file has in place of the `tables` that are solved for in training; see `response_tables`."""
RESPONSE_FLOOR, FRAME_FLOOR, SETTLED_FLOOR = 0.002, 0.02, 0.05
"""[mm] Added to the size of what is learned, so that a face that hardly moves does not decide."""


@dataclass(frozen=True)
class ModalTraining(TrainerConfig):
    """Options of one training, each with its reason."""

    network: ModalConfig = field(default_factory=ModalConfig)
    faces: int = 6  # per step
    frames: int = 6  # of each
    neutrals: int = 10  # more faces per step of which only the settled neutral is known, where there are any
    vertices: int = 1200  # of each, at random: a fourth teaches as much as all
    one_cycle: bool = True
    weight_decay: float = 0.2  # with some hundred people the summary is learnt by heart without
    clip: float | None = 1.0
    validation: float = 0.04  # share of people held out, for the learning curve alone
    sampled: int = 240  # faces whose principal components the modes start from
    solve_every: int = 100  # steps between two solutions for the tables of responses
    solved: int = 600  # faces, drawn anew, of each solution but the last, which has all


def train_modal(
    faces: Faces,
    config: ModalTraining | None = None,
    *,
    neutrals: Faces | None = None,
    start: Weights | None = None,
    state: str | PathLike[str] | None = None,
    on_progress: OnProgress = silent,
) -> Weights:
    """Fit the network to a corpus' training faces, and to more settled `neutrals` of the same space, where given.

    It begins with principal components of what it learns, or with `start`, weights of another corpus of the same
    space, whose ranges then count as seen. From a start without `neutrals` it learns what w does alone: neutral faces
    stay those of the start. With `state`, a file, the training is kept there now and then, and goes on from there when
    called again. Under torchrun each process takes a batch of its own, and all end with the same weights. Raises
    InputError for fewer than ten people, a device that is not there, a `start` of another mesh or of other sizes than
    the config's, and a state of another training.
    """
    config = ModalTraining() if config is None else config
    with start_processes(config.device) as group:
        lesson = ModalLesson(faces, config, neutrals=neutrals, start=start, device=group.device)
        paced = config if start is None else replace(config, learning_rate=AGAIN * config.learning_rate)
        trainer = Trainer(lesson, paced, group)
        trainer.train(state, on_progress if group.first else silent)
        return lesson.weights(trainer)


class ModalLesson:
    """A corpus' faces, the loss of some of them, and the errors on those of held-out people."""

    slow: tuple[str, ...] = ("modes", "position", "response_position", "effects")
    """Tables over the vertices, which start near where they end."""

    def __init__(
        self,
        faces: Faces,
        config: ModalTraining,
        *,
        neutrals: Faces | None = None,
        start: Weights | None = None,
        device: torch.device | str = "cpu",
    ):
        self.faces, self.config, self.neutrals, self.start, self.device = faces, config, neutrals, start, device
        self.learns_neutral = start is None or neutrals is not None
        if neutrals is not None and surface_hash(neutrals.mean) != surface_hash(faces.mean):
            raise InputError("training: the neutral faces are of another space or level than the corpus")
        people = np.unique(faces.groups[:, 0])
        if len(people) < 10:
            raise InputError(
                f"training: {len(people)} people of {faces.folder} have derivatives; at least 10 are needed, "
                "`softdeca corpus generate --preset small --people 12 --out FOLDER` makes them"
            )
        rng = np.random.default_rng([config.seed, 0])
        self.held = hold_out_people(people, config.validation, rng)
        is_held = np.isin(faces.groups[:, 0], self.held)
        has_frames = np.array([len(rows) >= config.frames for rows in faces.frames_of])
        self.training, self.validation = np.flatnonzero(~is_held & has_frames), np.flatnonzero(is_held & has_frames)
        if not len(self.training) or not len(self.validation):
            most = max(map(len, faces.frames_of), default=0)
            raise InputError(f"training: a step draws {config.frames} frames of a face, and faces have at most {most}")
        self.inputs = Inputs.from_faces(faces) if start is None else Inputs.from_weights(start)
        self.features = self.inputs.features
        self.seen = seen_ranges(faces, self.training, self.features)
        torch.manual_seed(config.seed)
        network = self._start(rng) if start is None else self._go_on(start)
        self.network = {name: value.detach().to(device) for name, value in network.items()}
        for name, value in self.network.items():
            learns = self.learns_neutral or name.startswith(EXPRESSIVE)
            value.requires_grad_(learns and not name.startswith(("size_", "tables")))
        after = "" if start is None else f"begun after {start.note.steps} steps"
        self.about: Sequence[str] = [f"{len(faces)} faces", f"{len(neutrals or ())} neutrals", after]

    def loss(self, step: int, rng: np.random.Generator) -> torch.Tensor:
        """Return mean distances of neutral faces, responses, and frames after exact derivatives, in each face's scale.

        The tables of responses are solved for now and then; see `response_tables`.
        """
        config = self.config
        if step % config.solve_every == 0:
            self.network["tables"].copy_(torch.from_numpy(self.solve_tables(self._some_faces(step))))
        batch = rng.choice(self.training, min(config.faces, len(self.training)), replace=False)
        n = len(self.faces.mean.vertices)
        return self.loss_of(batch, rng, np.sort(rng.choice(n, min(config.vertices, n), replace=False)))

    def loss_of(self, batch, rng: np.random.Generator, vertices) -> torch.Tensor:
        """Return the loss of some faces at some vertices."""
        network = self.network
        faces = [self.faces.face(int(index)) for index in batch]
        loss = self._settled_loss(faces, rng, vertices) if self.learns_neutral else 0.0
        p = [self.features.at_vertices(face.coefficients) for face in faces]
        local, summary, unmoved = self.inputs_of(faces, p, vertices)
        code = summary[..., : self.code_size]
        hidden = hidden_features(network, local, code, vertices)
        if self.learns_neutral:
            effects = self.effects_of(p, [face.skin.vertices for face in faces], vertices)
            own = neutral(network, 1, hidden, summary, unmoved, effects, vertices)
            relaxed = self._tensor([face.relaxed[vertices] for face in faces])
            loss = loss + _share(own - relaxed, [_settled_scale(face.displacement) for face in faces])
        exact = self._tensor([face.responses[:, vertices] for face in faces])
        shapes = self._tensor([face.shapes[:, vertices] for face in faces])
        shares, lag = mix(network, local, code, vertices)
        own = torch.einsum("bvk,kjvc->bjvc", shares, network["tables"][:, :, vertices]) - lag[:, None] * shapes
        loss = loss + _share(own - exact, [response_scale(face) for face in faces])
        weights, moved, scales = [], [], []
        for index, face in zip(batch, faces, strict=True):
            chosen = rng.choice(len(self.faces.frames_of[index]), self.config.frames, replace=False)
            frames = self.faces.frames(int(index), chosen)
            after_rest = frames.corrected.astype(np.float32) - face.offset.astype(np.float32)
            weights.append(frames.weights)
            moved.append(after_rest[:, vertices])
            scales.append(FRAME_FLOOR + float(np.linalg.norm(after_rest, axis=2).mean()))
        w, nonlinear = self._tensor(weights), self._tensor(moved).flatten(2)
        with torch.autocast(torch.device(self.device).type, enabled=False):  # the little that large numbers leave
            nonlinear = nonlinear - w @ exact.flatten(2)
        own = remainder(network, summary)(w) @ basis(network, 2, hidden, vertices)
        return loss + 1.5 * _share((own - nonlinear).unflatten(-1, (-1, 3)), scales)

    def solve_tables(self, faces: Ints) -> Floats32:
        """Solve for the tables of responses over some faces of `training`, shape (k, 52, n, 3)."""
        network = {name: value.detach().cpu().numpy() for name, value in self.network.items()}
        count, n = self.config.network.response_tables + 1, len(self.faces.mean.vertices)

        def rows():
            for index in faces:
                face = self.faces.face(int(index))
                local = self.features.local(self.features.at_vertices(face.coefficients))
                shares, lag = mix(network, local, self.inputs.code(face.code).astype(np.float32))
                yield shares, face.responses + lag * np.asarray(face.shapes, dtype=np.float32), response_scale(face)

        return solve_tables(rows(), n, count)

    def _some_faces(self, step: int) -> Ints:
        if len(self.training) <= self.config.solved:
            return self.training
        return np.random.default_rng([self.config.seed, 2, step]).choice(
            self.training, self.config.solved, replace=False
        )

    def _settled_loss(self, faces: list[KeptFace], rng: np.random.Generator, vertices):
        """Of settled neutral faces, every other one mirrored, where the mean skin is symmetric.

        What is learned of one cheek is so of the other. Shapes, and the tets in lids and lips, are not symmetric enough
        for responses.
        """
        if self.neutrals is not None:
            more = rng.choice(len(self.neutrals), self.config.neutrals)
            faces = faces + [self.neutrals.face(int(k)) for k in more]
        has_mirror = self.features.mirror is not None
        moves = [_settling(face, self.features, mirrored=has_mirror and rng.random() < 0.5) for face in faces]
        p, skins, settled = zip(*moves, strict=True)
        local, summary, unmoved = self.inputs_of(faces, p, vertices)
        hidden = hidden_features(self.network, local, summary[..., : self.code_size], vertices)
        effects = self.effects_of(p, skins, vertices)
        own = neutral(self.network, 0, hidden, summary, unmoved, effects, vertices)
        scales = [_settled_scale(move) for move in settled]
        return _share(own - self._tensor([move[vertices] for move in settled]), scales)

    @property
    def code_size(self) -> int:
        """Numbers of an identity code, with which a summary begins."""
        return len(self.inputs.code_mean)

    def inputs_of(self, faces: Sequence[KeptFace], p: Sequence[Floats], vertices) -> tuple[torch.Tensor, ...]:
        """Return `local` at some vertices (b, v, f), the summary (b, 1, s), and that of nothing moved."""
        local = [self.features.local(values)[vertices] for values in p]
        still = [self.features.unmoved(values) for values in p]
        summaries = (
            [self.inputs.summary(face.code, values)[None] for face, values in zip(faces, at_vertices, strict=True)]
            for at_vertices in (p, still)
        )
        return self._tensor(local), *map(self._tensor, summaries)

    def effects_of(self, p: Sequence[Floats], skins: Sequence[Floats], vertices) -> torch.Tensor:
        """Return effects at some vertices, shape (b, v, EFFECTS)."""
        both = zip(p, skins, strict=True)
        return self._tensor([self.features.effects(values, skin)[vertices] for values, skin in both])

    def _tensor(self, rows) -> torch.Tensor:
        return torch.from_numpy(np.stack(rows).astype(np.float32)).to(self.device)

    def errors(self) -> dict[str, float]:
        """Return mean vertex errors [mm] over the static frames of held-out people.

        Of the network alone, with exact derivatives (`hybrid`), of these derivatives alone, and of T = S.
        """
        network = {name: value.detach().cpu().numpy() for name, value in self.network.items()}
        tables = self.solve_tables(self._some_faces(0))
        sums, count = dict.fromkeys(("network", "hybrid", "linearised", "blendshapes"), 0.0), 0
        for index in self.validation:
            face, frames = self.faces.face(int(index)), self.faces.frames(int(index))
            at_vertices = self.features.at_vertices(face.coefficients)
            code = self.inputs.code(face.code)
            modes = bind_modal(network, tables, self.features, code, face.skin.vertices, at_vertices, face.shapes)
            nonlinear, own = frames.remainder(face), modes.remainder(frames.weights)
            corrected = frames.corrected.astype(np.float32)
            linear = corrected - modes.offset - np.tensordot(frames.weights, modes.responses, axes=1)
            all_errors = linear - own, nonlinear - own, nonlinear, corrected
            for name, error in zip(sums, all_errors, strict=True):
                sums[name] += float(np.linalg.norm(error, axis=2).mean(axis=1).sum())
            count += len(frames.weights)
        return {name: value / max(count, 1) for name, value in sums.items()}

    def weights(self, trainer: Trainer) -> Weights:
        """Return the network as it is now, with what it was made from."""
        faces, start, seen = self.faces, self.start, self.seen
        if start is not None:
            ranges = {name: (*seen[name], *start.note.seen[name]) for name in seen}
            seen = {name: (min(values), max(values)) for name, values in ranges.items()}
        note = TrainingNote(
            people=len(np.unique(faces.groups[self.training, 0])),
            faces=len(self.training),
            frames=int(sum(len(faces.frames_of[k]) for k in self.training)),
            steps=trainer.step,
            config=asdict(self.config),
            curve=tuple(trainer.curve),
            seen=seen,
            held=tuple(self.held.tolist()),
            neutrals=len(self.neutrals or ()),
            before=None if start is None else asdict(start.note),
        )
        looseness = None if start is None else start.looseness
        network = {name: value for name, value in trainer.arrays().items() if name != "tables"}
        return Weights(
            "modal", faces.space, faces.mean, self.inputs.code_mean, self.inputs.code_scale,
            network | compress(self.solve_tables(self.training)), note, looseness,
        )  # fmt: skip

    def _go_on(self, start: Weights) -> dict[str, torch.Tensor]:
        """Return the network of earlier weights; InputError where they do not fit."""
        if start.kind != "modal":
            raise InputError(f"training: the weights to begin with are of a {start.kind} network, not of a modal one")
        start.check_mesh(self.faces.mean)
        sizes = self.config.network.sizes(self.features, self.code_size)
        expected: dict[str, tuple[int, ...]] = {
            f"{name}.weight": (sizes[a], sizes[b]) for name, (a, b) in LAYERS.items()
        }
        expected |= {name: tuple(sizes[each] for each in names) for name, names in TABLES.items()}
        if any(start.network[name].shape != shape for name, shape in expected.items()):
            raise InputError("training: the weights to begin with have other sizes than the network's config")
        network = {name: value for name, value in start.network.items() if name not in SOLVED}
        network["tables"] = expand(start.network)
        return {name: torch.from_numpy(np.array(value)) for name, value in network.items()}

    def _start(self, rng: np.random.Generator) -> dict[str, torch.Tensor]:
        """Return a network with modes and linear amplitudes from principal components of what it learns."""
        faces, features, config = self.faces, self.features, self.config
        n = len(faces.mean.vertices)
        chosen = rng.permutation(self.training)[: config.sampled]
        sampled = [faces.face(int(index)) for index in chosen]
        settling = list(sampled)
        if self.neutrals is not None:
            more = rng.permutation(len(self.neutrals))[: 4 * config.sampled]
            settling += [self.neutrals.face(int(k)) for k in more]
        moves = [[_settling(face, features) for face in settling], [_relaxing(face, features) for face in sampled]]
        mirrored = [_settling(face, features, mirrored=True) for face in settling if features.mirror is not None]
        effects = np.stack([_fit_effects(some, features) for some in (moves[0] + mirrored, moves[1])])
        left = []
        for table, some in zip(effects, moves, strict=True):
            first = [np.einsum("ve,evc->vc", features.effects(p, skin), table) for p, skin, _ in some]
            left.append(np.stack([(move - own).ravel() for (*_, move), own in zip(some, first, strict=True)]))
        remainders = []
        for face, index in zip(sampled, chosen, strict=True):
            frames = faces.frames(int(index), rng.permutation(len(faces.frames_of[index]))[:4])
            remainders.append(frames.remainder(face).reshape(-1, 3 * n))
        changes = [self._changes(settling, moves[0]), self._changes(sampled, moves[1])]
        learned = *left, np.vstack(remainders)
        parts = [find_components(data, size, rng) for data, size in zip(learned, config.network.modes, strict=True)]
        arrays: dict[str, np.ndarray] = {"effects": effects}
        for k, (name, (modes, size)) in enumerate(zip(PARTS, parts, strict=True)):
            arrays |= {f"modes.{k}": modes.reshape(len(modes), n, 3) * np.sqrt(3 * n), f"size_{name}": size}
        sizes = config.network.sizes(features, self.code_size)
        network = draw_layers({name: (sizes[a], sizes[b]) for name, (a, b) in LAYERS.items()}, WITHOUT_BIAS)
        for name in QUIET:
            network[f"{name}.weight"] *= 0.1
            network[f"{name}.bias"] *= 0.0
        network["remainder_linear.weight"] *= 0.0
        for name in ("position", "response_position"):
            arrays[name] = draw_positions(faces.mean, config.network.position, rng)
        arrays["tables"] = np.zeros((sizes["tables"], sizes["weights"], n, 3))
        for name, data, rows, (modes, _) in zip(PARTS[:2], left, changes, parts[:2], strict=True):
            arrays[f"{name}_linear.weight"] = _fit_linear(rows, data @ modes.T).T
        return network | {name: torch.from_numpy(value.astype(np.float32)) for name, value in arrays.items()}

    def _changes(self, faces: Sequence[KeptFace], moves: Sequence[Move]) -> Floats32:
        """Return how far each face's summary is from that of nothing moved, a row each."""
        rows = []
        for face, (at_vertices, *_) in zip(faces, moves, strict=True):
            unmoved = self.features.unmoved(at_vertices)
            rows.append(self.inputs.summary(face.code, at_vertices) - self.inputs.summary(face.code, unmoved))
        return np.stack(rows)


def _share(error, scales: Sequence[float]):
    """Mean distance of errors (faces, ..., 3) [mm], each face's over its scale [mm].

    Rounded at a thousandth of a millimetre, where it would have no derivative.
    """
    distance = (error.square().sum(dim=-1) + 1e-6).sqrt().flatten(1).mean(dim=1)
    return (distance / torch.tensor(scales, dtype=distance.dtype, device=distance.device)).mean()


def response_scale(face: KeptFace) -> float:
    """How large a face's responses are [mm], by which errors of them count: stiff and soft tissue alike."""
    return RESPONSE_FLOOR + float(np.linalg.norm(face.responses.astype(np.float32), axis=2).mean())


def _settled_scale(settled: np.ndarray) -> float:
    """How far a neutral face settles [mm], by which errors of it count: scaled bones move it farthest."""
    return SETTLED_FLOOR + 0.5 * float(np.linalg.norm(settled.astype(np.float32), axis=1).mean())


def _settling(face: KeptFace, features: Features, *, mirrored: bool = False) -> Move:
    """What a face settles under, its skin, and how far it goes; or of its mirror image."""
    at_vertices = features.without_palsy(features.at_vertices(face.coefficients))
    skin, move = face.skin.vertices, face.displacement
    if mirrored:
        return features.mirror_parameters(at_vertices), features.mirror_move(skin), features.mirror_move(move)
    return at_vertices, skin, move


def _relaxing(face: KeptFace, features: Features) -> Move:
    return features.at_vertices(face.coefficients), face.skin.vertices, face.relaxed


def _fit_effects(moves: Sequence[Move], features: Features) -> Floats32:
    """What each effect does at each vertex, by ridge regression over faces, shape (EFFECTS, n, 3)."""
    n = len(features.mean.vertices)
    gram, pulled = np.zeros((n, EFFECTS, EFFECTS)), np.zeros((n, EFFECTS, 3))
    for at_vertices, skin, move in moves:
        effects = features.effects(at_vertices, skin).astype(np.float64)
        gram += effects[:, :, None] * effects[:, None]
        pulled += effects[:, :, None] * move[:, None].astype(np.float64)
    size = np.maximum(np.einsum("vee->ve", gram).mean(axis=0) / max(len(moves), 1), 1e-12)
    return np.linalg.solve(gram + 3.0 * np.diag(size), pulled).transpose(1, 0, 2).astype(np.float32)


def _fit_linear(features: Floats32, values: Floats32, penalty: float = 0.2) -> Floats:
    rows = features.astype(np.float64)
    gram = rows.T @ rows + penalty * len(rows) * np.eye(rows.shape[1])
    return np.linalg.solve(gram, rows.T @ values)


def draw_positions(mean: Surface, size: int, rng: np.random.Generator) -> Floats32:
    """Draw random Fourier features of vertices and normals, unit variance, shape (n, size): neighbours start alike."""
    centre = mean.vertices - mean.vertices.mean(axis=0)
    inputs = np.hstack([2.0 * centre / np.sqrt(centre.var(axis=0).sum()), 0.5 * mean.vertex_normals])
    features = np.cos(inputs @ rng.normal(size=(6, size)) + rng.uniform(0.0, 2.0 * np.pi, size))
    return ((features - features.mean(axis=0)) / features.std(axis=0)).astype(np.float32)
