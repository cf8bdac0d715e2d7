"""A take animated on a head: every frame within an accuracy, in a folder that resumes, or by a rig alone.

Static frames of free bones come from a certified face, each by the cheapest method. Inertia, contact and other bones
take the simulator, frame after frame. A rig alone costs what blendshapes do, and tells no error.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..lhm import fit_head, identities, load_template
from ..lhm.base.errors import InputError
from ..lhm.base.files.resumable import RowStore, lock_folder
from ..lhm.base.mesh import Floats, Floats32
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take, rotations
from ..lhm.head import LayeredHead
from ..reference import Parameters, Reason, SettledFace, settle
from ..reference.face.bones import Bones
from ..reference.face.dynamics import extrapolate_turns, find_pivot
from ..surrogate import BoundRig, CertifiedFace, Surrogate, derivatives_rig
from ..surrogate.certified import ACCURACY
from ..surrogate.local import on_wraps
from ..surrogate.methods import DERIVATIVES, NETWORK, NETWORK_AND_DERIVATIVES
from ..surrogate.runtime import Beyond
from .frames import CertifiedFrames, SimulatedFrames, TakeFrames
from .play import Output, PlayedTake
from .preview import check_preview
from .store import TakeStore, digest


@dataclass(frozen=True, eq=False)
class BoundHead:
    """A bound rig, by which method and in how many seconds, and the head's shapes (52, n, 3) [mm]."""

    rig: BoundRig
    method: str
    seconds: float
    deltas: Floats


@dataclass(frozen=True)
class AnimateConfig(Output):
    """What is made of a take, and how.

    accuracy [mm]: the largest mean error of a frame. bones: how the mandible moves, "rigid" being free but rigid;
    contact: regions whose triangles are kept apart (see `facial_scene`).
    """

    accuracy: float = ACCURACY
    bones: Bones = "rigid"
    contact: tuple[str, ...] = ()

    @property
    def simulates(self) -> bool:
        """Whether every frame needs the simulator, one after another."""
        return self.dynamic or self.bones != "rigid" or bool(self.contact)

    @property
    def choices(self) -> dict[str, Any]:
        """Options of `facial_scene`."""
        return {"bones": self.bones} | ({"contact": list(self.contact)} if self.contact else {})


@dataclass(frozen=True)
class AnimateResult:
    """How a take was animated: frames by method, the files, and what it took.

    failed: frames beyond the accuracy or without an answer, and why. error: the largest that was told [mm], None where
    none was. uncertain: how many frames told an error that is not certain. bind_seconds: before the first frame;
    frame_ms: median of a frame. notes: what a file leaves out or approximates. neutral: why settling under p stopped;
    without CONVERGED it failed.
    """

    frames: int
    methods: dict[str, int]
    error: float | None
    uncertain: int
    failed: tuple[tuple[int, str], ...]
    bind_seconds: float
    frame_ms: float
    files: tuple[Path, ...]
    notes: tuple[str, ...]
    neutral: str = Reason.CONVERGED.name


def bind_person(
    surrogate: Surrogate, code: Floats, parameters: Parameters, *, exact: bool, level: int, beyond: Beyond
) -> BoundHead:
    """A rig of one of the network's own people, of the default space."""
    space = identities.Anny()
    skin, begin = space.skin(code), time.perf_counter()
    head = fit_head(load_template(space, level=level), skin) if exact else None
    rig = surrogate.bind(skin, code, parameters, exact=exact, head=head, beyond=beyond)
    method = NETWORK_AND_DERIVATIVES if exact else NETWORK
    return BoundHead(rig, method, time.perf_counter() - begin, space.expression_deltas(code))


def bind_head(
    surrogate: Surrogate, head: LayeredHead, deltas: Floats, parameters: Parameters, *, exact: bool, beyond: Beyond
) -> BoundHead:
    """A rig of any head with shapes (52, n, 3) [mm].

    By the network where the head is one of its people; with the simulator's derivatives besides where it has their
    triangles; by these alone where it has others.
    """
    begin, nearest = time.perf_counter(), surrogate.find_nearest(head.skin)
    if nearest is None:
        rig: BoundRig = derivatives_rig(head, deltas, parameters)
        return BoundHead(rig, DERIVATIVES, time.perf_counter() - begin, deltas)
    exact = exact or not nearest.is_same
    rig = surrogate.bind(head.skin, nearest.code, parameters, expressions=deltas, exact=exact, head=head, beyond=beyond)
    method = NETWORK_AND_DERIVATIVES if exact else NETWORK
    return BoundHead(rig, method, time.perf_counter() - begin, deltas)


def animate(
    config: AnimateConfig,
    head: LayeredHead,
    deltas: Floats,
    take: Take,
    parameters: Parameters,
    surrogate: Surrogate | None,
    progress: OnProgress,
) -> AnimateResult:
    """Make the frames that are missing, and write config.out's files: take.vtkhdf or take.glb, preview, log.jsonl.

    deltas: what each expression adds to the head's skin [mm], shape (52, n, 3); take: evenly spaced frames, `rate`
    apart. parameters: local values are one per face of the skin; the neutral face settles under them first. With
    dynamics, the take's head rotation shakes it where there is one. The surrogate helps where it knows the head and
    parameters. A frame that is not within the accuracy keeps what was reached, one that cannot be simulated its
    blendshapes; both are listed. InputError if another run works in the folder, if it holds another take, and for a
    take without head rotation that is to be `turned`.
    """
    _check(config, take)
    on_head, begin = on_wraps(parameters, head), time.perf_counter()
    with lock_folder(config.out, "animate"):
        store = TakeStore(config.out, _manifest(config, head, deltas, take, on_head, surrogate))
        reason = Reason.CONVERGED.name
        frames: TakeFrames
        if config.simulates:
            neutral, reason = _settle(config, head, on_head, store, progress)
            frames = SimulatedFrames(
                neutral, deltas, take, config.accuracy, dynamic=config.dynamic, contact=bool(config.contact)
            )
        else:
            progress("settling: neutral face", 0.0)
            face = CertifiedFace.from_head(head, deltas, parameters, surrogate=surrogate)
            frames = CertifiedFrames(face, take, config.accuracy)
            progress("settling: neutral face", 1.0)
        bound = time.perf_counter() - begin
        _make(frames, head, take, store, progress)
        log = store.log()
        # The wrap ends below the neck: of a bust it is the head.
        framed = head.skin_wrap.vertices
        pivot = find_pivot(head)
        played = PlayedTake(head.skin, deltas, pivot, framed, take, lambda numbers: map(store.moved, numbers))
        files, notes = _write(played, config, f"within {config.accuracy:g} mm", progress)
    return _result(log, (*files, config.out / "log.jsonl"), notes, bound, reason)


def animate_rig(wanted: Output, served: BoundHead, take: Take, progress: OnProgress) -> AnimateResult:
    """Write wanted.out's files by a rig alone, whose frames tell no error: take.vtkhdf or take.glb, preview, log.jsonl.

    With dynamics the take's head rotation shakes the face where there is one. InputError if another run works in the
    folder, and for a take without head rotation that is to be `turned`.
    """
    rig = served.rig
    _check(wanted, take)
    if wanted.turned and rig.swing is None:
        raise InputError(
            "turned: the weights do not tell what a head turns about; bind(exact=True) takes it of the head"
        )
    neutral = rig.skin
    log: dict[int, dict[str, Any]] = {}

    def moved(numbers: Sequence[int]) -> Iterator[NDArray]:
        chosen = set(numbers)
        for number, (frame, seconds) in enumerate(_frames(rig, take, wanted.dynamic)):
            told = {"method": served.method, "error": None, "certain": False, "reason": "", "seconds": seconds}
            log.setdefault(number, {"frame": number, "time": float(take.times[number]), **told})
            if number in chosen:
                yield frame - neutral.vertices

    middle = neutral.vertices.mean(axis=0) if rig.swing is None else rig.swing.pivot
    used = neutral.vertices[np.unique(neutral.triangles)]
    played = PlayedTake(neutral, served.deltas, middle, used, take, moved)
    with lock_folder(wanted.out, "animate"):
        if (wanted.out / "take.json").exists():
            raise InputError(f"{wanted.out}: holds a take within an accuracy; use another folder or remove it")
        files, notes = _write(played, wanted, served.method, progress)
        RowStore(wanted.out, file="log.jsonl").keep(log.values())
    return _result(list(log.values()), (*files, wanted.out / "log.jsonl"), notes, served.seconds)


def _check(wanted: Output, take: Take) -> None:
    check_preview(wanted.preview)
    if wanted.turned and take.head is None:
        raise InputError("turned: the take has no head rotation")


def _write(
    played: PlayedTake, wanted: Output, caption: str, progress: OnProgress
) -> tuple[list[Path], tuple[str, ...]]:
    """Write the moving skin, and the preview if there is to be one; return their paths and notes."""
    written = [played.export(wanted, progress)]
    if wanted.preview != "none":
        written.append(played.show(wanted, caption, progress))
    return [path for path, _ in written], tuple(note for _, note in written if note)


def _result(
    log: Sequence[dict[str, Any]],
    files: tuple[Path, ...],
    notes: tuple[str, ...],
    bound: float,
    neutral: str = Reason.CONVERGED.name,
) -> AnimateResult:
    """Sum up a log."""
    errors = [row["error"] for row in log if row["error"] is not None]
    return AnimateResult(
        frames=len(log),
        methods=dict(Counter(row["method"] for row in log)),
        error=max(errors) if errors else None,
        uncertain=sum(row["error"] is not None and not row["certain"] for row in log),
        failed=tuple((row["frame"], row["reason"]) for row in log if row["reason"]),
        bind_seconds=bound,
        frame_ms=1e3 * float(np.median([row["seconds"] for row in log])),
        files=files,
        notes=notes,
        neutral=neutral,
    )


def _manifest(
    config: AnimateConfig,
    head: LayeredHead,
    deltas: Floats,
    take: Take,
    parameters: Parameters,
    surrogate: Surrogate | None,
) -> dict[str, Any]:
    """Return what decides the frames: a folder whose manifest differs holds another take."""
    values = [np.asarray(getattr(parameters, f.name)) for f in fields(parameters)]
    network = None if surrogate is None or config.simulates else surrogate.weights.network
    return {
        "head": digest(head.skin.vertices, head.skin.triangles, head.vertices, head.tets, head.bone),
        "expressions": digest(deltas),
        "weights": digest(take.weights),
        "first time": float(take.times[0]),
        "frames": len(take.times),
        "rate": float(take.rate),
        "parameters": digest(*values),
        "neutral": "settled under p",
        "dynamic": "flesh lags" if config.dynamic else False,
        "head rotation": digest(take.head) if config.dynamic and take.head is not None else None,
        "accuracy": config.accuracy,
        "network": None if network is None else digest(*(network[name] for name in sorted(network))),
        "choices": json.loads(json.dumps(config.choices)),
    }


def _settle(
    config: AnimateConfig, head: LayeredHead, parameters: Parameters, store: TakeStore, progress: OnProgress
) -> tuple[SettledFace, str]:
    """Return the neutral face settled under p, from the folder where it is there, and why settling stopped."""
    kept = store.neutral()
    if kept is None:
        progress("settling: neutral face", 0.0)
        found = settle(head, parameters, **config.choices)
        kept = {
            "positions": found.positions,
            "displacement": found.displacement,
            "reason": np.array(found.reason.name),
        }
        store.keep_neutral(kept)
        progress("settling: neutral face", 1.0)
    face = SettledFace(head, parameters, kept["positions"], kept["displacement"], choices=config.choices)
    return face, str(kept["reason"])


def _make(frames: TakeFrames, head: LayeredHead, take: Take, store: TakeStore, progress: OnProgress) -> None:
    """Make the frames that the store lacks."""
    done, state = store.done(*frames.state_names)
    if state is not None:
        frames.resume(state)
    count = len(take.times)
    for number in range(done, count):
        begin = time.perf_counter()
        frame = frames.frame(number)
        record = {"frame": number, "time": float(take.times[number]), **frame.record}
        record["seconds"] = round(time.perf_counter() - begin, 4)
        store.add(number, (frame.skin - head.skin.vertices).astype(np.float32), record, frame.state)
        progress(f"frame {number + 1} of {count}", (number + 1) / count)


def _frames(rig: BoundRig, take: Take, dynamic: bool) -> Iterator[tuple[Floats32, float]]:
    """The take's skins in their order, and the seconds of each."""
    bases = None if take.head is None else rotations(take.head)
    moving = rig.dynamic(1.0 / take.rate) if dynamic else None
    if moving is not None and bases is not None:
        moving.begin(take.weights[0], base=extrapolate_turns(bases))
    for number, weights in enumerate(take.weights):
        begin = time.perf_counter()
        if moving is None:
            skin = rig.frame(weights)
        else:
            skin = moving.frame(weights, base=None if bases is None else bases[number])
        yield skin, time.perf_counter() - begin
