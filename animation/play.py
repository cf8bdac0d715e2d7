"""A take played on a head, whoever computes it: its files, glTF or VTKHDF, a preview beside blendshapes, and a log."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..lhm.base.errors import InputError
from ..lhm.base.files.atomic import write_whole
from ..lhm.base.files.morphs import MorphRig, morph_take, reduce_to_morphs
from ..lhm.base.files.moving_surface import write_vtkhdf
from ..lhm.base.files.usd import check_usd
from ..lhm.base.mesh import Floats, Surface
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take, rotations
from ..lhm.head.detail import FineSkin
from ..reference.face.dynamics import turn_about
from ..surrogate.methods import BLENDSHAPES
from .export import WRITERS, RigFormat, refine_rig
from .frames import TakeFrame, blend_linearly
from .pictures import drawn_surface
from .preview import GIF_SECONDS, Preview, choose_frames, render_frames, write_preview

Format = Literal["vtkhdf", RigFormat]
MORPHED = 0.05
"""[mm] Error of a take's frames as sums of morph targets that a motion is reduced to."""


@dataclass(frozen=True)
class Output:
    """Files of a take in the folder `out`.

    `turned` shows the head turned as the take has it, about its neck, and not in its own frame. `detail` shows and
    writes the head's fine skin.
    """

    out: Path
    format: Format = "vtkhdf"
    preview: Preview = "none"
    dynamic: bool = False
    turned: bool = False
    detail: bool = False

    def __post_init__(self):
        for name, known in (("format", get_args(Format)), ("preview", get_args(Preview))):
            if getattr(self, name) not in known:
                raise InputError(f"{name} {getattr(self, name)!r}: expected one of {', '.join(known)}")
        if self.format == "usd":
            check_usd()


@dataclass(frozen=True, eq=False)
class Stage:
    """The scene of a take.

    neutral: the skin without p [mm]; deltas (52, n, 3) [mm]: what the weights add to it; pivot (3,) [mm]: what the head
    turns about; framed (k, 3) [mm]: the points that a preview has in view; fine: what draws the skin finer.
    """

    neutral: Surface
    deltas: Floats
    pivot: Floats
    framed: Floats
    take: Take
    fine: FineSkin | None = None

    def turn(self, skin: Floats, number: int) -> Floats:
        """A skin (n, 3) [mm] of the head's own frame, turned as the take has the head in a frame."""
        if self.take.head is None:
            return skin
        return turn_about(self.pivot, skin, rotations(self.take.head[[number]])[0])

    def blend(self, number: int) -> Floats:
        """The blendshapes [mm] of a frame, shape (n, 3)."""
        return blend_linearly(self.neutral, self.deltas, self.take.weights[number])


@dataclass(frozen=True)
class Played:
    """The files of a take, notes on what they leave out or approximate, and the log's lines."""

    files: tuple[Path, ...]
    notes: tuple[str, ...]
    log: list[dict[str, Any]]


def play(
    frames: Iterable[TakeFrame],
    stage: Stage,
    wanted: Output,
    caption: str,
    progress: OnProgress,
    *,
    rig: MorphRig | None = None,
) -> Played:
    """Make the frames, and write OUT/take.vtkhdf, .glb or .usd, OUT/preview.gif or .mp4, and OUT/log.jsonl.

    The preview has blendshapes, and beside them the frames under their caption. `rig` plays the take where the frames
    are sums of named targets; others are reduced to targets without names.
    """
    take, count = stage.take, len(stage.take.times)
    shown = choose_frames(count, take.rate, wanted.preview) if wanted.preview != "none" else range(0)
    log: list[dict[str, Any]] = []
    kept: dict[int, NDArray[np.float32]] = {}

    def make_motion() -> Iterator[NDArray]:
        """Make the frames, less the neutral skin [mm]; keep those of the preview."""
        begin = time.perf_counter()
        for number, frame in enumerate(frames):
            seconds = round(time.perf_counter() - begin, 6)
            log.append({"frame": number, "time": float(take.times[number]), **frame.record, "seconds": seconds})
            one = (frame.skin - stage.neutral.vertices).astype(np.float32)
            if wanted.turned:
                one = stage.turn(stage.neutral.vertices + one, number) - stage.neutral.vertices
            if number in shown:
                kept[number] = one
            progress(f"frame {number + 1} of {count}", (number + 1) / count)
            yield one
            begin = time.perf_counter()

    files, notes = [wanted.out / f"take.{wanted.format}"], []
    if wanted.format == "vtkhdf":
        skins = (stage.neutral.with_vertices(stage.neutral.vertices + one) for one in make_motion())
        triangles = stage.neutral.triangles if stage.fine is None else stage.fine.triangles
        write_vtkhdf(files[0], triangles, take.times, (drawn_surface(skin, stage.fine).vertices for skin in skins))
    else:
        motion = np.array(list(make_motion()))
        if rig is None:
            morphs = reduce_to_morphs(motion, tolerance=MORPHED)
            rig = morph_take("skin", stage.neutral, take.times, morphs, morphs.weights)
            notes.append(describe_targets(files[0], len(morphs.targets), morphs.error))
        else:
            notes.append(f"{files[0].name}: ARKit's {len(rig.names)} morph targets")
        rig = rig if stage.fine is None else refine_rig(rig, stage.fine)
        WRITERS[wanted.format](files[0], rig)
    if shown:
        files.append(wanted.out / f"preview.{wanted.preview}")
        _write_preview(files[1], kept, stage, wanted, caption, progress)
        if shown.stop < count:
            left_out = f"--preview mp4 shows the {count - shown.stop} frames left"
            notes.append(f"{files[1].name} ends after {GIF_SECONDS:g} s; {left_out}")
    files.append(wanted.out / "log.jsonl")
    write_whole(files[-1], b"".join(json.dumps(row, allow_nan=False).encode() + b"\n" for row in log))
    return Played(tuple(files), tuple(notes), log)


def _write_preview(
    path: Path, kept: Mapping[int, NDArray], stage: Stage, wanted: Output, caption: str, progress: OnProgress
) -> None:
    """Write blendshapes beside frames, given by their number less the neutral skin [mm]."""

    def pairs() -> Iterator[tuple[Floats, Floats]]:
        for done, (number, displacement) in enumerate(kept.items()):
            progress(f"preview: {path.name}", done / len(kept))
            blended = stage.blend(number)
            plain = stage.turn(blended, number) if wanted.turned else blended
            yield plain, stage.neutral.vertices + displacement

    take, numbers = stage.take, list(kept)
    weights = take.weights[numbers]
    shown: dict[str, Any] = {"framed": stage.framed, "weights": weights, "fine": stage.fine}
    pictures = render_frames(stage.neutral, pairs(), (BLENDSHAPES, caption), **shown)
    write_preview(path, wanted.preview, pictures, take.times[numbers], take.rate)
    progress(f"preview: {path.name}", 1.0)


def describe_targets(path: Path, count: int, error: float) -> str:
    """Say how far a glTF's morph targets are off, at the worst vertex of the worst frame [mm]."""
    return f"{path.name}: {count} morph targets, greatest error {error:.2g} mm"
