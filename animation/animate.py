"""A take animated on a head: every frame within an accuracy, in a folder that resumes, or by a rig alone.

Static frames of free bones come from a certified face, each by the cheapest method. Inertia, contact and other bones
take the simulator, frame after frame. A rig alone costs what blendshapes do, and tells no error.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..lhm.base.errors import InputError
from ..lhm.base.files.resumable import RowStore, lock_folder
from ..lhm.base.mesh import Floats32
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take, rotations
from ..lhm.head.head import LayeredHead
from ..reference import Face, Reason, SettledFace, settle
from ..reference.face.bones import Bones
from ..reference.face.dynamics import extrapolate_turns, find_pivot
from ..surrogate import BoundRig, Surrogate, certify
from ..surrogate.certified import ACCURACY
from .frames import CertifiedFrames, SimulatedFrames, TakeFrames
from .play import Output, PlayedTake
from .preview import check_preview
from .store import TakeStore, digest


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


def animate(config: AnimateConfig, face: Face, take: Take, surrogate: Surrogate, progress: OnProgress) -> AnimateResult:
    """Make the frames that are missing, and write config.out's files: take.vtkhdf or take.glb, preview, log.jsonl.

    take: evenly spaced frames, `rate` apart. The neutral face settles under p first. With dynamics, the take's head
    rotation shakes it where there is one. The surrogate helps where it knows the head and parameters. A frame that is
    not within the accuracy keeps what was reached, one that cannot be simulated its blendshapes; both are listed.
    InputError if another run works in the folder, if it holds another take, and for a take without head rotation that
    is to be `turned`.
    """
    _check(config, take)
    head, begin = face.head, time.perf_counter()
    with lock_folder(config.out, "animate"):
        store = TakeStore(config.out, _manifest(config, face, take, surrogate))
        reason = Reason.CONVERGED.name
        frames: TakeFrames
        if config.simulates:
            neutral, reason = _settle(config, face, store, progress)
            frames = SimulatedFrames(
                neutral, face.shapes, take, config.accuracy, dynamic=config.dynamic, contact=bool(config.contact)
            )
        else:
            progress("settling: neutral face", 0.0)
            frames = CertifiedFrames(certify(face, surrogate), take, config.accuracy)
            progress("settling: neutral face", 1.0)
        bound = time.perf_counter() - begin
        _make(frames, head, take, store, progress)
        log = store.log()
        # The wrap ends below the neck: of a bust it is the head.
        framed = head.skin_wrap.vertices
        pivot = find_pivot(head)
        played = PlayedTake(head.skin, face.shapes, pivot, framed, take, lambda numbers: map(store.moved, numbers))
        files, notes = _write(played, config, f"within {config.accuracy:g} mm", progress)
    return _result(log, (*files, config.out / "log.jsonl"), notes, bound, reason)


def animate_rig(
    wanted: Output, face: Face, bind: Callable[[Face], tuple[str, BoundRig]], take: Take, progress: OnProgress
) -> tuple[AnimateResult, BoundRig]:
    """Write wanted.out's files by a rig alone, whose frames tell no error: take.vtkhdf or take.glb, preview, log.jsonl.

    bind: gives the method's label and the rig, as `methods.bind_cheaply`. With dynamics the take's head rotation shakes
    the face where there is one. Returns the rig, too. InputError if another run works in the folder, and for a take
    without head rotation that is to be `turned`.
    """
    _check(wanted, take)
    begin = time.perf_counter()
    method, rig = bind(face)
    bind_seconds = time.perf_counter() - begin
    if wanted.turned and rig.swing is None:
        raise InputError(
            "turned: the weights do not tell what a head turns about; bind(exact=True) takes it of the head"
        )
    neutral = rig.skin
    log: dict[int, dict[str, Any]] = {}

    def moved(numbers: Sequence[int]) -> Iterator[NDArray]:
        chosen = set(numbers)
        for number, (frame, seconds) in enumerate(_frames(rig, take, wanted.dynamic)):
            told = {"method": method, "error": None, "certain": False, "reason": "", "seconds": seconds}
            log.setdefault(number, {"frame": number, "time": float(take.times[number]), **told})
            if number in chosen:
                yield frame - neutral.vertices

    middle = neutral.vertices.mean(axis=0) if rig.swing is None else rig.swing.pivot
    used = neutral.vertices[np.unique(neutral.triangles)]
    played = PlayedTake(neutral, face.shapes, middle, used, take, moved)
    with lock_folder(wanted.out, "animate"):
        if (wanted.out / "take.json").exists():
            raise InputError(f"{wanted.out}: holds a take within an accuracy; use another folder or remove it")
        files, notes = _write(played, wanted, method, progress)
        RowStore(wanted.out, file="log.jsonl").keep(log.values())
    return _result(list(log.values()), (*files, wanted.out / "log.jsonl"), notes, bind_seconds), rig


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


def _manifest(config: AnimateConfig, face: Face, take: Take, surrogate: Surrogate) -> dict[str, Any]:
    """Return what decides the frames: a folder whose manifest differs holds another take."""
    head, parameters = face.head, face.on_wraps
    values = [np.asarray(getattr(parameters, f.name)) for f in fields(parameters)]
    network = None if config.simulates else surrogate.weights.network
    return {
        "head": digest(head.skin.vertices, head.skin.triangles, head.vertices, head.tets, head.bone),
        "expressions": digest(face.shapes),
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


def _settle(config: AnimateConfig, face: Face, store: TakeStore, progress: OnProgress) -> tuple[SettledFace, str]:
    """Return the neutral face settled under p, from the folder where it is there, and why settling stopped."""
    kept = store.neutral()
    if kept is None:
        progress("settling: neutral face", 0.0)
        found = settle(face.head, face.on_wraps, **config.choices)
        kept = {
            "positions": found.positions,
            "displacement": found.displacement,
            "reason": np.array(found.reason.name),
        }
        store.keep_neutral(kept)
        progress("settling: neutral face", 1.0)
    neutral = SettledFace(face.head, face.on_wraps, kept["positions"], kept["displacement"], choices=config.choices)
    return neutral, str(kept["reason"])


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
