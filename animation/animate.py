"""A take animated on a head, every frame within an accuracy or by a rig alone: its files, a preview and a log.

Static frames of free bones come from a certified face, each by the cheapest method. Inertia and other bones
take the simulator, frame after frame. A rig alone costs what blendshapes do, and tells no error.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.base.files.atomic import write_whole
from ..lhm.base.files.morphs import MorphRig, morph_take, reduce_to_morphs
from ..lhm.base.files.moving_surface import write_vtkhdf
from ..lhm.base.files.usd import check_usd
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..lhm.base.progress import OnProgress, describe_left
from ..lhm.expressions import Take, rotations
from ..lhm.head.detail import FineSkin
from ..reference import Face, Reason, Sequence
from ..reference.face.bones import Bones
from ..reference.face.dynamics import turn_skin
from ..surrogate import BoundSurrogate, Surrogate, certify
from ..surrogate.certified import ACCURACY
from ..surrogate.methods import BLENDSHAPES, bind_cheaply
from .export import WRITERS, RigFormat, named_take, refine_rig
from .frames import Frame, certified_frames, foresee, rig_frames, simulated_frames
from .pictures import drawn_surface
from .preview import GIF_SECONDS, Preview, check_preview, choose_frames, render_frames, write_preview

Format = Literal["vtkhdf", RigFormat]
MORPHED = 0.05
"""[mm] Error of a take's frames as sums of morph targets that a motion is reduced to."""


@dataclass(frozen=True)
class Animation:
    """Choices of an animated take, whose files go to the folder `out`.

    accuracy [mm]: the largest mean error of a frame; None takes a rig alone. bones: how the mandible moves, "rigid"
    being free but rigid; contact: whether lids, lips and what lines them are kept from crossing. dynamic: with inertia;
    the take's head rotation shakes the face where there is one. turned: shows the head turned as the take has it, about
    its neck, and not in its own frame. detail: shows and writes the head's fine skin.
    """

    out: Path
    format: Format = "vtkhdf"
    preview: Preview = "none"
    accuracy: float | None = ACCURACY
    bones: Bones = "rigid"
    contact: bool = True
    dynamic: bool = False
    turned: bool = False
    detail: bool = False

    def __post_init__(self):
        for name, known in (("format", get_args(Format)), ("preview", get_args(Preview))):
            if getattr(self, name) not in known:
                raise InputError(f"{name} {getattr(self, name)!r}: expected one of {', '.join(known)}")
        if self.format == "usd":
            check_usd()
        check_preview(self.preview)


@dataclass(frozen=True)
class AnimateResult:
    """Outcome of an animated take: frames by method, the files, and the time it took.

    failed: frames beyond the accuracy or without an answer, and why. error: the largest that was told [mm], None where
    none was. uncertain: how many frames told an error that is not certain; crossing: in how many skin crosses skin
    that does not in the neutral face, in files' notes and the log, too. bind_seconds: before the first frame;
    frame_ms: median of a frame. notes: what a file leaves out or approximates. neutral: why settling under p stopped;
    without CONVERGED it failed.
    """

    frames: int
    methods: dict[str, int]
    error: float | None
    uncertain: int
    crossing: int
    failed: tuple[tuple[int, str], ...]
    bind_seconds: float
    frame_ms: float
    files: tuple[Path, ...]
    notes: tuple[str, ...]
    neutral: str


def animate(wanted: Animation, face: Face, take: Take, surrogate: Surrogate, progress: OnProgress) -> AnimateResult:
    """Make a take's frames, and write OUT/take.vtkhdf, .glb or .usd, OUT/preview.gif or .mp4, and OUT/log.jsonl.

    take: evenly spaced frames, `rate` apart. The neutral face settles under p first. The surrogate helps where it knows
    the head and parameters. A frame that is not within the accuracy keeps what was reached, one that cannot be
    simulated its blendshapes; both are listed. The preview has blendshapes, and beside them the frames. Frames that are
    sums of a rig's own 52 targets are written as these. InputError for a take without head rotation that is to be
    `turned`.
    """
    if wanted.turned and take.head is None:
        raise InputError("turned: the take has no head rotation")
    begin, reason, named = time.perf_counter(), Reason.CONVERGED, None
    frames: Iterable[Frame]
    progress("settling: neutral face", 0.0)
    if wanted.accuracy is None:
        caption, rig = bind_cheaply(face, surrogate)
        frames = rig_frames(caption, rig, take, wanted.dynamic)
        if wanted.format in WRITERS and isinstance(rig, BoundSurrogate) and not (wanted.dynamic or wanted.turned):
            named = named_take(caption, rig, take)
    else:
        caption = f"within {wanted.accuracy:g} mm"
        face = face.in_contact() if wanted.contact else face
        if wanted.dynamic or wanted.bones != "rigid":
            face = replace(face, choices={**face.choices, "bones": wanted.bones}, settling={})
            reason = face.settled().reason
            sequence = Sequence(face, time_step=1.0 / take.rate, dynamic=wanted.dynamic)
            frames = simulated_frames(sequence, take, wanted.accuracy)
        else:
            certified = certify(face, surrogate)
            progress(foresee(certified, take, wanted.accuracy), 0.0)
            frames = certified_frames(certified, take, wanted.accuracy)
    progress("settling: neutral face", 1.0)
    bind_seconds = time.perf_counter() - begin

    count = len(take.times)
    shown = range(0) if wanted.preview == "none" else choose_frames(count, take.rate, wanted.preview)
    log: list[dict[str, Any]] = []
    kept: dict[int, Floats32] = {}
    turns = rotations(take.head) if wanted.turned and take.head is not None else None

    def in_room(skin: Floats | Floats32, number: int) -> Floats | Floats32:
        return skin if turns is None else turn_skin(face.head, skin, turns[number])

    def make_skins() -> Iterator[Floats | Floats32]:
        """Make and log the frames; keep those of the preview."""
        first = begin = time.perf_counter()
        for number, (skin, record) in enumerate(frames):
            seconds = round(time.perf_counter() - begin, 6)
            row = {"frame": number, "time": float(take.times[number]), **record, "seconds": seconds}
            log.append(row | {"skin_crossings": face.count_crossings(skin)})
            skin = in_room(skin, number)
            if number in shown:
                kept[number] = skin.astype(np.float32)
            done = (number + 1) / count
            progress(f"frames: {number + 1} of {count}{describe_left(time.perf_counter() - first, done)}", done)
            yield skin
            begin = time.perf_counter()

    fine = face.head.fine_skin if wanted.detail else None
    files = [wanted.out / f"take.{wanted.format}"]
    notes = _write_skins(files[0], make_skins(), face.skin, fine, take, named, log)
    if shown:
        files.append(wanted.out / f"preview.{wanted.preview}")
        plain = {number: in_room(face.blend(take.weights[number]), number) for number in kept}
        _write_preview(files[1], wanted.preview, face, fine, take, {BLENDSHAPES: plain, caption: kept}, progress)
        if shown.stop < count:
            left_out = f"--preview mp4 shows the {count - shown.stop} frames left"
            notes.append(f"{files[1].name} ends after {GIF_SECONDS:g} s; {left_out}")
    files.append(wanted.out / "log.jsonl")
    write_whole(files[-1], b"".join(json.dumps(row, allow_nan=False).encode() + b"\n" for row in log))
    errors = [row["error"] for row in log if row["error"] is not None]
    return AnimateResult(
        frames=len(log),
        methods=dict(Counter(row["method"] for row in log)),
        error=max(errors, default=None),
        uncertain=sum(row["error"] is not None and not row["certain"] for row in log),
        crossing=sum(row["skin_crossings"] > 0 for row in log),
        failed=tuple((row["frame"], row["reason"]) for row in log if row["reason"]),
        bind_seconds=bind_seconds,
        frame_ms=1e3 * float(np.median([row["seconds"] for row in log])),
        files=tuple(files),
        notes=tuple(notes),
        neutral=reason.name,
    )


def _write_skins(
    path: Path,
    skins: Iterable[Floats | Floats32],
    neutral: Surface,
    fine: FineSkin | None,
    take: Take,
    rig: MorphRig | None,
    log: list[dict[str, Any]],
) -> list[str]:
    """Write skins (n, 3) [mm], and return notes; `rig` plays the take where they are sums of named targets.

    log: of the frames made so far; files that have notes tell in which skin crosses skin.
    """
    if path.suffix == ".vtkhdf":
        triangles = neutral.triangles if fine is None else fine.triangles
        drawn = (drawn_surface(neutral.with_vertices(skin), fine).vertices for skin in skins)
        write_vtkhdf(path, triangles, take.times, drawn)
        return []
    motion = np.array([(skin - neutral.vertices).astype(np.float32) for skin in skins])
    if rig is None:
        morphs = reduce_to_morphs(motion, tolerance=MORPHED)
        rig = morph_take("skin", neutral, take.times, morphs, morphs.weights)
        note = f"{path.name}: {len(morphs.targets)} morph targets, greatest error {morphs.error:.2g} mm"
    else:
        note = f"{path.name}: ARKit's {len(rig.names)} morph targets"
    if crossing := [row["frame"] for row in log if row["skin_crossings"]]:
        rig = replace(rig, notes={**rig.notes, "frames_where_skin_crosses_skin": crossing})
    WRITERS[path.suffix[1:]](path, rig if fine is None else refine_rig(rig, fine))
    return [note]


def _write_preview(
    path: Path,
    kind: Preview,
    face: Face,
    fine: FineSkin | None,
    take: Take,
    columns: Mapping[str, Mapping[int, Floats | Floats32]],
    progress: OnProgress,
) -> None:
    """Write skins [mm], by the number of their frame, in two columns under their captions."""
    one, other = columns.values()
    numbers = list(one)

    def pairs() -> Iterator[tuple[Floats | Floats32, Floats | Floats32]]:
        for done, number in enumerate(numbers):
            progress(f"preview: {path.name}", done / len(numbers))
            yield one[number], other[number]

    # The wrap ends below the neck: of a bust it is the head.
    framed, weights = face.head.skin_wrap.vertices, take.weights[numbers]
    pictures = render_frames(face.skin, pairs(), list(columns), framed=framed, weights=weights, fine=fine)
    write_preview(path, kind, pictures, take.times[numbers], take.rate)
    progress(f"preview: {path.name}", 1.0)
