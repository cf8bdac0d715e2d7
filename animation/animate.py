"""A take animated on a head: every frame within an accuracy, or by a rig alone.

Static frames of free bones come from a certified face, each by the cheapest method. Inertia and other bones
take the simulator, frame after frame. A rig alone costs what blendshapes do, and tells no error.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take
from ..reference import Face, Reason
from ..reference.face.bones import Bones
from ..reference.face.dynamics import find_pivot
from ..surrogate import BoundRig, BoundSurrogate, Surrogate, certify
from ..surrogate.certified import ACCURACY
from .export import WRITERS, named_take
from .frames import SimulatedFrames, TakeFrame, certified_frames, rig_frames
from .play import Output, Played, Stage, play
from .preview import check_preview


@dataclass(frozen=True)
class AnimateConfig(Output):
    """Choices of an animated take.

    accuracy [mm]: the largest mean error of a frame. bones: how the mandible moves, "rigid" being free but rigid;
    contact: whether lids, lips and what lines them are kept from crossing.
    """

    accuracy: float = ACCURACY
    bones: Bones = "rigid"
    contact: bool = True

    @property
    def simulates(self) -> bool:
        """Whether every frame needs the simulator, one after another."""
        return self.dynamic or self.bones != "rigid"


@dataclass(frozen=True)
class AnimateResult:
    """Outcome of an animated take: frames by method, the files, and the time it took.

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
    """Make a take's frames, and write config.out's files: take.vtkhdf, .glb or .usd, preview, log.jsonl.

    take: evenly spaced frames, `rate` apart. The neutral face settles under p first. With dynamics, the take's head
    rotation shakes it where there is one. The surrogate helps where it knows the head and parameters. A frame that is
    not within the accuracy keeps what was reached, one that cannot be simulated its blendshapes; both are listed.
    InputError for a take without head rotation that is to be `turned`.
    """
    _check(config, take)
    head, begin, reason = face.head, time.perf_counter(), Reason.CONVERGED
    face = face.in_contact() if config.contact else face
    progress("settling: neutral face", 0.0)
    frames: Iterable[TakeFrame]
    if config.simulates:
        simulated = replace(face, choices={**face.choices, "bones": config.bones}, settling={})
        reason = simulated.settled().reason
        frames = SimulatedFrames(simulated, take, config.accuracy, dynamic=config.dynamic)
    else:
        frames = certified_frames(certify(face, surrogate), take, config.accuracy)
    progress("settling: neutral face", 1.0)
    bind_seconds = time.perf_counter() - begin
    # The wrap ends below the neck: of a bust it is the head.
    fine = head.fine_skin if config.detail else None
    stage = Stage(head.skin, face.shapes, find_pivot(head), head.skin_wrap.vertices, take, fine)
    played = play(frames, stage, config, f"within {config.accuracy:g} mm", progress)
    return _result(played, bind_seconds, reason.name)


def animate_rig(
    wanted: Output, face: Face, bind: Callable[[Face], tuple[str, BoundRig]], take: Take, progress: OnProgress
) -> tuple[AnimateResult, BoundRig]:
    """Write wanted.out's files by a rig alone, whose frames tell no error: take, preview, log.jsonl.

    bind: gives the method's label and the rig, as `methods.bind_cheaply`. With dynamics the take's head rotation shakes
    the face where there is one. Frames that are sums of the rig's own 52 targets are written as these. Returns the rig,
    too. InputError for a take without head rotation that is to be `turned`.
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
    pivot = neutral.vertices.mean(axis=0) if rig.swing is None else rig.swing.pivot
    framed = neutral.vertices[np.unique(neutral.triangles)]
    stage = Stage(neutral, face.shapes, pivot, framed, take, face.head.fine_skin if wanted.detail else None)
    sums = wanted.format in WRITERS and not (wanted.dynamic or wanted.turned)
    named = named_take(method, rig, take) if sums and isinstance(rig, BoundSurrogate) else None
    played = play(rig_frames(method, rig, take, wanted.dynamic), stage, wanted, method, progress, rig=named)
    return _result(played, bind_seconds), rig


def _check(wanted: Output, take: Take) -> None:
    check_preview(wanted.preview)
    if wanted.turned and take.head is None:
        raise InputError("turned: the take has no head rotation")


def _result(played: Played, bind_seconds: float, neutral: str = Reason.CONVERGED.name) -> AnimateResult:
    """Sum up a log."""
    log = played.log
    errors = [row["error"] for row in log if row["error"] is not None]
    return AnimateResult(
        frames=len(log),
        methods=dict(Counter(row["method"] for row in log)),
        error=max(errors) if errors else None,
        uncertain=sum(row["error"] is not None and not row["certain"] for row in log),
        failed=tuple((row["frame"], row["reason"]) for row in log if row["reason"]),
        bind_seconds=bind_seconds,
        frame_ms=1e3 * float(np.median([row["seconds"] for row in log])),
        files=played.files,
        notes=played.notes,
        neutral=neutral,
    )
