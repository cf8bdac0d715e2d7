"""Training of the modal surrogate: a config, a visible loop, weights that carry what they were made with."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from ...lhm.base.errors import InputError
from ...lhm.base.mesh import Floats, Floats32
from ...lhm.base.progress import OnProgress, silent
from ..corpus.face import Face
from ..corpus.mixture import STATIC
from ..corpus.reading import Faces
from ..learning import keep_state, kept_state, torch
from ..processes import ALONE, Processes, processes
from ..surface_hash import surface_hash
from .features import EFFECTS, Features, Inputs
from .network import NEUTRAL, WEIGHTS, ModalConfig, ModalNetwork, start_positions
from .principal import principal
from .weights import ModalWeights, TrainingNote

Precision = Literal["float32", "bfloat16"]
Move = tuple[Floats, Floats, np.ndarray]
"""A face's p at the vertices (n, P), its skin and how far that goes (n, 3) [mm]."""
WIDENED = 0.05
AGAIN = 0.3
"""Of the learning rate, where a training begins with weights that know most already."""
SLOW = ("modes", "position", "effects")
"""Tables over the vertices, which start near where they end."""
EXPRESSIVE = ("lag", "response_", "remainder_", "modes.2", "modes.3")
"""What a training that begins with weights goes on with: what w does. Neutral faces stay as they were learned."""


@dataclass(frozen=True)
class ModalTraining:
    """Options of one training, each with its reason."""

    network: ModalConfig = field(default_factory=ModalConfig)
    seed: int = 0
    steps: int = 3600
    faces: int = 6  # per step
    frames: int = 6  # of each
    neutrals: int = 10  # more faces per step of which only the settled neutral is known, where there are any
    vertices: int = 1200  # of each, at random: a fourth teaches as much as all
    learning_rate: float = 4e-3  # of AdamW, the highest of one cycle
    weight_decay: float = 0.2  # with some hundred people the summary is learnt by heart without
    validation: float = 0.04  # share of people held out, for the learning curve alone
    validate_every: int = 400
    sampled: int = 240  # faces whose principal components the modes start from
    device: str = "cpu"
    precision: Precision = "float32"  # "bfloat16": of products of matrices, which GPUs do faster


@dataclass(frozen=True)
class CurvePoint:
    """Errors at a step: the mean loss on its own faces since the last point, and mean vertex errors on held-out people.

    Of the network alone, with exact derivatives (`hybrid`), of these derivatives alone, and of T = S, all in mm.
    """

    step: int
    seconds: float
    loss: float
    network: float
    hybrid: float
    linearised: float
    blendshapes: float


def train_modal(
    faces: Faces,
    config: ModalTraining | None = None,
    *,
    neutrals: Faces | None = None,
    start: ModalWeights | None = None,
    state: str | PathLike[str] | None = None,
    on_progress: OnProgress = silent,
) -> ModalWeights:
    """Fit the network to a corpus' training faces, and to more settled `neutrals` of the same space, where given.

    It begins with principal components of what it learns, or with `start`, weights of another corpus of the same space:
    then it learns what w does alone, neutral faces stay those of the start, and its ranges count as seen. With
    `state`, a file, the training is kept there now and then, and goes on from there when called again. Under torchrun
    each process takes a batch of its own, and all end with the same weights. Raises InputError for fewer than ten
    people, a device that is not there, a `start` with neutrals, of another mesh or of other sizes than the config's,
    and a state of another training.
    """
    config = ModalTraining() if config is None else config
    with processes(config.device) as group:
        return _trained(_Loop(faces, config, neutrals, group, start), state, on_progress if group.first else silent)


def _trained(loop: _Loop, state: str | PathLike[str] | None, on_progress: OnProgress) -> ModalWeights:
    config, group = loop.config, loop.group
    if state is not None and Path(state).is_file():
        loop.restore(Path(state))
    group.wait()
    while loop.step < config.steps:
        loop.run(min(config.validate_every, config.steps - loop.step))
        if state is not None and group.first:
            loop.keep(Path(state))
        point = loop.curve[-1]
        on_progress(
            f"training: held-out people {point.network:.4f} mm, with exact derivatives {point.hybrid:.4f}, "
            f"linearised {point.linearised:.4f}, T = S {point.blendshapes:.3f}",
            loop.step / config.steps,
        )
    return loop.weights()


class _Loop:
    """All that a training holds; its steps depend on seed and number alone."""

    def __init__(
        self,
        faces: Faces,
        config: ModalTraining,
        neutrals: Faces | None = None,
        group: Processes = ALONE,
        start: ModalWeights | None = None,
    ):
        self.faces, self.config, self.neutrals, self.group, self.start = faces, config, neutrals, group, start
        if neutrals is not None and start is not None:
            raise InputError("training: from weights it learns no neutral faces; leave out one of start and neutrals")
        if neutrals is not None and surface_hash(neutrals.mean) != surface_hash(faces.mean):
            raise InputError("training: the neutral faces are of another space or level than the corpus")
        if faces.personal:
            raise InputError("training: the corpus' people have shapes of their own, which the network does not see")
        people = np.unique(faces.groups[:, 0])
        if len(people) < 10:
            raise InputError(f"training: {len(people)} people have derivatives; at least 10 are needed")
        if config.precision not in get_args(Precision):
            raise InputError(f"training precision {config.precision!r}: there are {', '.join(get_args(Precision))}")
        self.device = group.device
        rng = np.random.default_rng([config.seed, 0])
        held = rng.permutation(people)[: max(1, round(config.validation * len(people)))]
        enough = np.array([len(rows) >= config.frames for rows in faces.frames_of])
        is_held = np.isin(faces.groups[:, 0], held)
        self.held = tuple(sorted(held.tolist()))
        self.training, self.validation = np.flatnonzero(~is_held & enough), np.flatnonzero(is_held & enough)
        self.inputs = Inputs.of(faces) if start is None else Inputs.as_of(start)
        self.features = self.inputs.features
        self.seen = _seen(faces, self.training, self.features)
        torch.manual_seed(config.seed)
        if start is None:
            network = _started(faces, self.training, neutrals, self.inputs, config, rng)
        else:
            network = _again(start, faces, self.inputs, config)
            self.seen = {name: _hull(seen, start.note.seen[name]) for name, seen in self.seen.items()}
        self.network = network.to(self.device)
        for name, value in self.network.named_parameters():
            value.requires_grad_(start is None or name.startswith(EXPRESSIVE))
        named = [(name, value) for name, value in self.network.named_parameters() if value.requires_grad]
        slow = [value for name, value in named if name.startswith(SLOW)]
        rest = [value for name, value in named if not name.startswith(SLOW)]
        rate = config.learning_rate * (1.0 if start is None else AGAIN)
        self.optimiser = torch.optim.AdamW(
            [{"params": rest, "weight_decay": config.weight_decay}, {"params": slow, "weight_decay": 0.0}], lr=rate
        )
        self.schedule = torch.optim.lr_scheduler.OneCycleLR(
            self.optimiser, [rate, 0.3 * rate], total_steps=config.steps + 1, pct_start=0.05
        )
        self.step, self.seconds = 0, 0.0
        self.curve: list[CurvePoint] = []

    def run(self, steps: int):
        """Some steps, then the errors on held-out people: a point of the learning curve."""
        begin, total = time.perf_counter(), 0.0
        for _ in range(steps):
            total += self._step()
        self.seconds += time.perf_counter() - begin
        self.curve.append(CurvePoint(self.step, self.seconds, total / steps, **self._validated()))

    def _step(self) -> float:
        config = self.config
        # The first of several processes draws what one alone would.
        own = [self.group.number] if self.group.number else []
        rng = np.random.default_rng([config.seed, 1, self.step, *own])
        batch = rng.choice(self.training, min(config.faces, len(self.training)), replace=False)
        n = len(self.faces.mean.vertices)
        vertices = np.sort(rng.choice(n, min(config.vertices, n), replace=False))
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.precision == "bfloat16"):
            loss = self._loss(batch, rng, vertices)
        self.optimiser.zero_grad()
        loss.backward()
        self.group.average(self.network.parameters())
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimiser.step()
        self.schedule.step()
        self.step += 1
        return float(loss.detach())

    def _loss(self, batch, rng, vertices):
        """Mean distances [mm] of neutral faces, responses, and frames after exact derivatives."""
        network = self.network
        faces = [self.faces.face(int(index)) for index in batch]
        loss = 0.0 if self.start is not None else self._settled_loss(faces + self._some_neutrals(rng), rng, vertices)
        p = [self.features.at_vertices(face.coefficients) for face in faces]
        local, summary, unmoved = self._features(faces, p, vertices)
        hidden = network.hidden(local, summary, vertices)
        response_basis, remainder_basis = network.bases(hidden, vertices, (2, 3))
        if self.start is None:
            effects = self._effects(p, [face.skin for face in faces], vertices)
            own = network.neutral(1, hidden, summary, unmoved, effects, vertices)
            loss = loss + _distance(own - self._tensor([face.relaxed[vertices].ravel() for face in faces]))
        responses = self._tensor([face.responses[:, vertices].reshape(WEIGHTS, -1) for face in faces])
        shapes = self._tensor([face.shapes[:, vertices] for face in faces])
        lagging = (network.lags(hidden, local)[:, None, :, None] * shapes).flatten(2)
        loss = loss + 2.0 * _distance(network.response_amplitudes(summary) @ response_basis - lagging - responses)
        weights, remainders = [], []
        for index, face in zip(batch, faces, strict=True):
            chosen = rng.choice(len(self.faces.frames_of[index]), self.config.frames, replace=False)
            frames = self.faces.frames(int(index), chosen)
            weights.append(frames.weights)
            corrected = frames.corrected[:, vertices].reshape(len(chosen), -1).astype(np.float32)
            remainders.append(corrected - face.offset[vertices].ravel().astype(np.float32))
        weights = self._tensor(weights)
        with torch.autocast(self.device.type, enabled=False):  # the little that large numbers leave
            remainder = self._tensor(remainders) - weights @ responses
        return loss + 3.0 * _distance(network.remainder_amplitudes(summary, weights) @ remainder_basis - remainder)

    def _settled_loss(self, faces, rng, vertices):
        """Of settled neutral faces, every other one mirrored, where the mean skin is symmetric.

        What is learned of one cheek is so of the other. Shapes, and the tets in lids and lips, are not symmetric enough
        for responses.
        """
        network, features = self.network, self.features
        p, skins, settled = [], [], []
        for face in faces:
            is_mirrored = features.mirror is not None and rng.random() < 0.5
            at_vertices, skin, move = _settling(face, features, mirrored=is_mirrored)
            p.append(at_vertices)
            skins.append(skin)
            settled.append(move[vertices].ravel())
        local, summary, unmoved = self._features(faces, p, vertices)
        hidden = network.hidden(local, summary, vertices)
        own = network.neutral(0, hidden, summary, unmoved, self._effects(p, skins, vertices), vertices)
        return _distance(own - self._tensor(settled))

    def _some_neutrals(self, rng) -> list[Face]:
        if self.neutrals is None:
            return []
        return [self.neutrals.face(int(k)) for k in rng.choice(len(self.neutrals), self.config.neutrals)]

    def _features(self, faces, p, vertices):
        """Of faces: `local` at some vertices, the summary, and that of nothing moved."""
        local = [self.features.local(one)[vertices] for one in p]
        summaries = (
            [self.inputs.summary(face.code, one) for face, one in zip(faces, at_vertices, strict=True)]
            for at_vertices in (p, [self.features.unmoved(one) for one in p])
        )
        return self._tensor(local), *map(self._tensor, summaries)

    def _effects(self, p, skins, vertices):
        both = zip(p, skins, strict=True)
        return self._tensor([self.features.effects(one, skin)[vertices] for one, skin in both])

    def _tensor(self, rows):
        return torch.from_numpy(np.stack(rows).astype(np.float32)).to(self.device)

    def _validated(self) -> dict[str, float]:
        return errors_of(self.weights(), self.faces, self.validation)

    def weights(self) -> ModalWeights:
        """The network as it is now, with what it was made from."""
        faces, config = self.faces, self.config
        arrays = {name: value.detach().cpu().numpy() for name, value in self.network.state_dict().items()}
        note = TrainingNote(
            people=len(np.unique(faces.groups[self.training, 0])),
            faces=len(self.training),
            frames=int(sum(len(faces.frames_of[k]) for k in self.training)),
            steps=self.step,
            config=asdict(config),
            curve=tuple(asdict(point) for point in self.curve),
            seen=self.seen,
            held=self.held,
            neutrals=len(self.neutrals or ()),
            before=None if self.start is None else asdict(self.start.note),
        )
        looseness = None if self.start is None else self.start.looseness
        return ModalWeights(
            faces.space, faces.mean, self.inputs.code_mean, self.inputs.code_scale, arrays, note, looseness
        )

    @property
    def _of(self) -> list[str]:
        """What a kept state has to be of."""
        begun = "" if self.start is None else f"begun after {self.start.note.steps} steps"
        return [repr(self.config), f"{len(self.faces)} faces", f"{len(self.neutrals or ())} neutrals", begun]

    def keep(self, path: Path):
        """Write all that `restore` needs, whole or not at all."""
        content = {
            "of": self._of,
            "step": self.step,
            "seconds": self.seconds,
            "network": self.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "schedule": self.schedule.state_dict(),
            "curve": [asdict(point) for point in self.curve],
        }
        keep_state(path, content)

    def restore(self, path: Path):
        """Go on where `keep` was called last; InputError for a file of another training."""
        kept = kept_state(path, self._of)
        self.network.load_state_dict(kept["network"])
        self.optimiser.load_state_dict(kept["optimiser"])
        self.schedule.load_state_dict(kept["schedule"])
        self.step, self.seconds = kept["step"], kept["seconds"]
        self.curve = [CurvePoint(**point) for point in kept["curve"]]


def _distance(error):
    """Mean distance [mm] of errors (..., 3 v), rounded at a thousandth, where it would have no derivative."""
    return (error.unflatten(-1, (-1, 3)).square().sum(dim=-1) + 1e-6).sqrt().mean()


def errors_of(weights: ModalWeights, faces: Faces, chosen) -> dict[str, float]:
    """Mean vertex errors [mm] over all static frames of some faces; see `CurvePoint`."""
    from .rig import Modal

    modal = Modal(weights)
    sums = dict.fromkeys(("network", "hybrid", "linearised", "blendshapes"), 0.0)
    count = 0
    for index in chosen:
        face, frames = faces.face(int(index)), faces.frames(int(index))
        if not len(frames.weights):
            continue
        bound = modal.bound(face.code, face.skin, modal.features.at_vertices(face.coefficients), face.shapes)
        remainder = frames.remainder(face)
        own = bound.remainder(frames.weights)
        linear = (
            frames.corrected.astype(np.float32) - bound.offset - np.tensordot(frames.weights, bound.responses, axes=1)
        )
        for name, error in (
            ("network", linear - own),
            ("hybrid", remainder - own),
            ("linearised", remainder),
            ("blendshapes", frames.corrected.astype(np.float32)),
        ):
            sums[name] += float(np.linalg.norm(error, axis=2).mean(axis=1).sum())
        count += len(frames.weights)
    return {name: value / max(count, 1) for name, value in sums.items()}


def _seen(faces: Faces, training, features: Features) -> dict[str, tuple[float, float]]:
    """The range of each parameter over the faces, a little widened, since ends of a range are hardly ever drawn."""
    values = [features.at_vertices(faces.coefficients(int(index))) for index in training]
    low = np.min([value.min(axis=0) for value in values], axis=0)
    high = np.max([value.max(axis=0) for value in values], axis=0)
    widened = np.where(high > low, WIDENED, 0.0)
    low, high = np.maximum(low - widened, -1.0), np.minimum(high + widened, 1.0)
    return {name: (float(low[k]), float(high[k])) for k, name in enumerate(STATIC)}


def _hull(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    return min(one[0], other[0]), max(one[1], other[1])


def _again(start: ModalWeights, faces: Faces, inputs: Inputs, config: ModalTraining) -> ModalNetwork:
    """The network of earlier weights; InputError where they do not fit."""
    start.check_mesh(faces.mean)
    n3 = 3 * len(faces.mean.vertices)
    network = ModalNetwork(
        config.network,
        code_size=len(inputs.code_mean),
        local_size=inputs.features.local_size,
        summary_size=inputs.features.summary_size,
        effects=np.zeros((len(NEUTRAL), EFFECTS, n3 // 3, 3)),
        modes=[np.zeros((count, n3)) for count in config.network.modes],
        sizes=[np.zeros(count) for count in config.network.modes],
        means=np.zeros((WEIGHTS, config.network.response_modes)),
    )
    try:
        network.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in start.network.items()})
    except RuntimeError:
        raise InputError("training: the weights to begin with have other sizes than the network's config") from None
    return network


def _started(
    faces: Faces, training, neutrals: Faces | None, inputs: Inputs, config: ModalTraining, rng: np.random.Generator
) -> ModalNetwork:
    """The network with modes and linear amplitudes from principal components of what it learns."""
    n3 = 3 * len(faces.mean.vertices)
    known = [faces.face(int(index)) for index in rng.permutation(training)[: config.sampled]]
    settling: list[Face] = [*known]
    if neutrals is not None:
        settling += [neutrals.face(int(k)) for k in rng.permutation(len(neutrals))[: 4 * config.sampled]]
    features = inputs.features
    moves = [[_settling(face, features) for face in settling], [_relaxing(face, features) for face in known]]
    seen = moves[0] + [_settling(face, features, mirrored=True) for face in settling if features.mirror is not None]
    effects = np.stack([_table(some, features) for some in (seen, moves[1])])
    left = [
        np.stack([move.ravel() - _first_order(table, features, *given) for *given, move in some])
        for table, some in zip(effects, moves, strict=True)
    ]
    responses, remainders, total = [], [], np.zeros((WEIGHTS, n3))
    for face, index in zip(known, rng.permutation(training)[: config.sampled], strict=True):
        give = features.give(features.at_vertices(face.coefficients))[:, None]
        flat = (face.responses + give * face.shapes).reshape(WEIGHTS, n3).astype(np.float32)
        total += flat / len(known)
        kept = rng.permutation(WEIGHTS)[:12]
        responses.append(flat[kept] / np.sqrt(np.maximum(np.linalg.norm(flat[kept], axis=1), 1e-2))[:, None])
        face = faces.face(int(index))
        frames = faces.frames(int(index), rng.permutation(len(faces.frames_of[index]))[:4])
        remainders.append(frames.remainder(face).reshape(-1, n3))
    changes = [_moved_summaries(settling, moves[0], inputs), _moved_summaries(known, moves[1], inputs)]
    learned = *left, np.vstack(responses), np.vstack(remainders)
    parts = [principal(data, size, rng) for data, size in zip(learned, config.network.modes, strict=True)]
    modes, sizes = [part[0] for part in parts], [part[1] for part in parts]
    network = ModalNetwork(
        config.network,
        code_size=len(inputs.code_mean),
        local_size=inputs.features.local_size,
        summary_size=inputs.features.summary_size,
        effects=effects,
        modes=modes,
        sizes=sizes,
        means=total @ modes[2].T,
    )
    with torch.no_grad():
        network.position.copy_(torch.from_numpy(start_positions(faces.mean, config.network.position, rng)))
        for layer, data, rows, mode in (
            (network.settled_linear, left[0], changes[0], modes[0]),
            (network.relaxed_linear, left[1], changes[1], modes[1]),
        ):
            layer.weight.copy_(torch.from_numpy(_ridge(rows, data @ mode.T).T.astype(np.float32)))
    return network


def _settling(face: Face, features: Features, *, mirrored: bool = False) -> Move:
    """What a face settles under, its skin, and how far it goes; or of its mirror image."""
    at_vertices, skin, move = features.without_palsy(features.at_vertices(face.coefficients)), face.skin, face.settled
    if mirrored:
        return features.mirrored(at_vertices), features.mirrored_move(skin), features.mirrored_move(move)
    return at_vertices, skin, move


def _relaxing(face: Face, features: Features) -> Move:
    return features.at_vertices(face.coefficients), face.skin, face.relaxed


def _moved_summaries(faces: Sequence[Face], moves: Sequence[Move], inputs: Inputs) -> Floats32:
    """How far each face's summary is from that of nothing moved, a row each."""
    rows = []
    for face, (at_vertices, *_) in zip(faces, moves, strict=True):
        unmoved = inputs.features.unmoved(at_vertices)
        rows.append(inputs.summary(face.code, at_vertices) - inputs.summary(face.code, unmoved))
    return np.stack(rows)


def _first_order(table: Floats32, features: Features, at_vertices: Floats, skin: Floats) -> Floats32:
    """What a table of effects (EFFECTS, n, 3) makes of a face [mm], shape (3 n,)."""
    return np.einsum("ve,evc->vc", features.effects(at_vertices, skin), table).ravel()


def _table(moves: Sequence[Move], features: Features) -> Floats32:
    """What each effect does at each vertex, by ridge regression over faces, shape (EFFECTS, n, 3)."""
    n = len(features.mean.vertices)
    gram, pulled = np.zeros((n, EFFECTS, EFFECTS)), np.zeros((n, EFFECTS, 3))
    for at_vertices, skin, move in moves:
        effects = features.effects(at_vertices, skin).astype(np.float64)
        gram += effects[:, :, None] * effects[:, None]
        pulled += effects[:, :, None] * move[:, None].astype(np.float64)
    size = np.maximum(np.einsum("vee->ve", gram).mean(axis=0) / max(len(moves), 1), 1e-12)
    return np.linalg.solve(gram + 3.0 * np.diag(size), pulled).transpose(1, 0, 2).astype(np.float32)


def _ridge(features: Floats32, values: Floats32, penalty: float = 0.2) -> Floats:
    rows = features.astype(np.float64)
    gram = rows.T @ rows + penalty * len(rows) * np.eye(rows.shape[1])
    return np.linalg.solve(gram, rows.T @ values)
