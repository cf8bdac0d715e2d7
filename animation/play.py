"""A take played on a head, whoever computed it: its files, glTF or VTKHDF, and a preview beside blendshapes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..lhm.base.errors import InputError
from ..lhm.base.files.moving_surface import write_gltf, write_vtkhdf
from ..lhm.base.mesh import Floats, Surface
from ..lhm.base.progress import OnProgress
from ..lhm.expressions import Take, rotations
from ..reference.face.dynamics import turn_about
from ..surrogate.methods import BLENDSHAPES
from .preview import GIF_SECONDS, Preview, choose_frames, render_frames, write_preview

Format = Literal["vtkhdf", "gltf"]
FILES: dict[Format, str] = {"vtkhdf": "take.vtkhdf", "gltf": "take.glb"}


@dataclass(frozen=True)
class Output:
    """What is written of a take to the folder `out`.

    `turned` shows the head turned as the take has it, about its neck, and not in its own frame.
    """

    out: Path
    format: Format = "vtkhdf"
    preview: Preview = "none"
    dynamic: bool = False
    turned: bool = False

    def __post_init__(self):
        for name, known in (("format", get_args(Format)), ("preview", get_args(Preview))):
            if getattr(self, name) not in known:
                raise InputError(f"{name} {getattr(self, name)!r}: expected one of {', '.join(known)}")


@dataclass(frozen=True, eq=False)
class PlayedTake:
    """Skins of a take's frames.

    neutral: the skin without p [mm]; deltas (52, n, 3) [mm]: what the weights add to it; pivot (3,) [mm]: what the head
    turns about; framed (k, 3) [mm]: the points that a preview has in view. moved: frames by their numbers, rising, less
    neutral [mm], each (n, 3).
    """

    neutral: Surface
    deltas: Floats
    pivot: Floats
    framed: Floats
    take: Take
    moved: Callable[[Sequence[int]], Iterator[NDArray]]

    def export(self, wanted: Output, progress: OnProgress) -> tuple[Path, str]:
        """Write OUT/take.vtkhdf or take.glb; return its path, and how far glTF's morph targets are off, or ""."""
        path, count = wanted.out / FILES[wanted.format], len(self.take.times)
        progress(f"export: {path.name}", 0.0)
        moved = _told(self._shown(wanted, range(count)), count, f"export: {path.name}", progress)
        note = ""
        if wanted.format == "vtkhdf":
            frames = (self.neutral.vertices + one for one in moved)
            write_vtkhdf(path, self.neutral.triangles, self.take.times, frames)
        else:
            morphs = write_gltf(path, self.neutral, self.take.times, np.array(list(moved)))
            note = describe_targets(path, len(morphs.targets), morphs.error)
        progress(f"export: {path.name}", 1.0)
        return path, note

    def show(self, wanted: Output, caption: str, progress: OnProgress) -> tuple[Path, str]:
        """Write OUT/preview.gif or .mp4: blendshapes, and beside them the frames under their caption.

        Return its path, and what a GIF leaves out, or "".
        """
        path = wanted.out / f"preview.{wanted.preview}"
        shown = choose_frames(len(self.take.times), self.take.rate, wanted.preview)
        pairs = (
            (self._placed(wanted, k, self._blended(k)), self.neutral.vertices + moved)
            for k, moved in zip(shown, self._shown(wanted, shown), strict=True)
        )
        told = _told(pairs, len(shown), f"preview: {path.name}", progress)
        captions, weights = (BLENDSHAPES, caption), self.take.weights[shown]
        pictures = render_frames(self.neutral, told, captions, framed=self.framed, weights=weights)
        write_preview(path, wanted.preview, pictures, self.take.times[shown], self.take.rate)
        progress(f"preview: {path.name}", 1.0)
        left_out = len(self.take.times) - shown.stop
        note = f"{path.name} ends after {GIF_SECONDS:g} s; --preview mp4 shows the {left_out} frames left"
        return path, note if left_out else ""

    def _shown(self, wanted: Output, numbers: Sequence[int]) -> Iterator[NDArray]:
        """Frames as they are shown, less the neutral skin [mm], each (n, 3)."""
        for number, moved in zip(numbers, self.moved(numbers), strict=True):
            if wanted.turned:
                placed = self._placed(wanted, number, self.neutral.vertices + moved)
                moved = placed - self.neutral.vertices
            yield moved

    def _placed(self, wanted: Output, number: int, skin: Floats) -> Floats:
        """A skin [mm], shape (n, 3), of the head's own frame as it is shown."""
        if not wanted.turned or self.take.head is None:
            return skin
        return turn_about(self.pivot, skin, rotations(self.take.head[[number]])[0])

    def _blended(self, number: int) -> Floats:
        return blend_linearly(self.neutral, self.deltas, self.take.weights[number])


def describe_targets(path: Path, count: int, error: float) -> str:
    """Say how far a glTF's morph targets are off, at the worst vertex of the worst frame [mm]."""
    return f"{path.name}: {count} morph targets, greatest error {error:.2g} mm"


def blend_linearly(neutral: Surface, deltas: Floats, weights: Floats) -> Floats:
    """Linear blendshapes [mm], shape (n, 3), of weights (52,)."""
    used = np.flatnonzero(weights)
    return neutral.vertices + np.tensordot(weights[used], deltas[used], axes=1)


def _told(items: Iterator, count: int, what: str, progress: OnProgress) -> Iterator:
    """The items, each with word of how far the file is."""
    for number, item in enumerate(items):
        progress(what, number / count)
        yield item
