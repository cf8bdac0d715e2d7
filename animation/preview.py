"""A moving head as GIF or MP4: blendshapes beside what is simulated, rendered off screen."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import repeat
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..lhm.base.errors import InputError, MissingDependencyError
from ..lhm.base.files.atomic import replaced
from ..lhm.base.geometry.topology import close_openings
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..lhm.head.detail import FineSkin
from .eyes_and_teeth import find_eyes_and_teeth
from .pictures import (
    add_back,
    add_eyes_and_teeth,
    aim_camera,
    drawn_surface,
    load_pyvista,
    shade_skin,
    skin_colours,
    to_polydata,
)

Preview = Literal["mp4", "gif", "none"]
Picture = NDArray[np.uint8]

GIF_RATE, GIF_SECONDS = 25.0, 20.0
"""[Hz, s] A GIF has at most so many frames a second, of the beginning of a take; an MP4 has all."""
BACKGROUND = "#f4f1ec"
FACING = (0.3, 0.04, 1.0)
SIZE = 400
"""Columns of pixels of one skin."""


def choose_frames(count: int, rate: float, kind: Preview) -> range:
    """Choose the frames of a take of so many, at `rate` [Hz], a preview shows: a GIF at most 25 a second, for 20 s."""
    if kind != "gif":
        return range(count)
    return range(0, min(count, int(np.ceil(GIF_SECONDS * rate))), max(1, int(np.ceil(rate / GIF_RATE))))


def render_frames(
    neutral: Surface,
    pairs: Iterable[tuple[Floats | Floats32, Floats | Floats32]],
    captions: Sequence[str],
    *,
    framed: Floats | None = None,
    weights: Iterable[Floats] | None = None,
    fine: FineSkin | None = None,
) -> Iterator[Picture]:
    """RGB pictures, (460, 800, 3), of pairs of skins [mm], each (n, 3); eyes turn by `weights` (52,) of each.

    The camera stands still, so that what moves is the face. It sees the points `framed` [mm], shape (k, 3), by default
    all of the skin. What is hidden in `neutral` is drawn dark. `fine` draws skins finer.
    """
    pyvista = load_pyvista()
    rows = 2 * (23 * SIZE // 40)
    plotter = pyvista.Plotter(off_screen=True, window_size=(2 * SIZE, rows))
    plotter.enable_anti_aliasing("msaa", multi_samples=8)
    plotter.set_background(BACKGROUND)
    framed = neutral.vertices[np.unique(neutral.triangles)] if framed is None else framed
    centre, height = (framed.max(axis=0) + framed.min(axis=0)) / 2, 1.14 * float(np.ptp(framed[:, 1]))
    aim_camera(plotter, centre, height, FACING)
    right = np.cross((0.0, 1.0, 0.0), FACING)
    aside = 0.5 * height * SIZE / rows * right / np.linalg.norm(right)
    meshes, colours = [], shade_skin(neutral, fine)
    for offset in (-aside, aside):
        beside = neutral.with_vertices(neutral.vertices + offset)
        drawn = drawn_surface(beside, fine)
        mesh = to_polydata(pyvista, drawn.vertices, drawn.triangles)
        mesh.point_data.active_normals = drawn.vertex_normals
        actor = plotter.add_mesh(mesh, **skin_colours(colours), reset_camera=False)
        actor.prop.interpolation = "Phong"
        meshes.append((mesh, add_back(plotter, drawn), add_eyes_and_teeth(plotter, beside), offset))
    plotter.reset_camera_clipping_range()
    organs = find_eyes_and_teeth(neutral)
    for pair, gaze in zip(pairs, repeat(None) if weights is None else weights, strict=False):
        for (mesh, reverse, inner, offset), vertices in zip(meshes, pair, strict=True):
            surface = neutral.with_vertices(vertices + offset)
            drawn = drawn_surface(surface, fine)
            mesh.points, reverse.points = drawn.vertices, close_openings(drawn).vertices
            mesh.point_data.active_normals = drawn.vertex_normals
            if organs is not None:
                inner.points = organs.place(surface.vertices, gaze)
        plotter.render()
        yield _add_captions(np.asarray(plotter.screenshot(None, return_img=True)), captions)
    plotter.close()


def write_preview(path: Path, kind: Preview, pictures: Iterable[Picture], times: Floats, rate: float) -> None:
    """Write pictures, shown at `times` [s], as a GIF, or as an MP4 at `rate` [Hz]; whole or not at all.

    MissingDependencyError if an MP4 is asked for and imageio-ffmpeg is not installed.
    """
    if kind not in get_args(Preview) or kind == "none":
        raise InputError(f"preview {kind!r}: expected mp4 or gif")
    with replaced(path) as temporary:
        if kind == "gif":
            _write_gif(temporary, iter(pictures), times)
        else:
            _write_mp4(temporary, iter(pictures), rate)


def check_preview(kind: Preview) -> None:
    """Raise MissingDependencyError where a preview of this kind could not be written."""
    if kind == "mp4":
        _ffmpeg()


def _add_captions(picture: Picture, captions: Sequence[str]) -> Picture:
    image = Image.fromarray(picture)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(15)
    for column, caption in enumerate(captions):
        place = ((column + 0.5) * image.width / len(captions), 14)
        draw.text(place, caption, fill="#4a4038", font=font, anchor="mt")
    return np.asarray(image)


def _write_gif(path: Path, pictures: Iterator[Picture], times: Floats) -> None:
    first = Image.fromarray(next(pictures)).quantize(256, dither=Image.Dither.NONE)
    rest = (Image.fromarray(p).quantize(palette=first, dither=Image.Dither.NONE) for p in pictures)
    # GIF counts hundredths of a second: rounding the times, not the steps between them, keeps the take's length.
    steps = np.maximum(np.diff(np.round(100.0 * (times - times[0])).astype(int)), 2)
    durations = [10 * int(step) for step in np.append(steps, steps[-1:] if steps.size else 10)]
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=durations, loop=0)


def _write_mp4(path: Path, pictures: Iterator[Picture], rate: float) -> None:
    first = next(pictures)
    size = (first.shape[1], first.shape[0])
    writer = _ffmpeg().write_frames(str(path), size, fps=rate, quality=8, macro_block_size=2, ffmpeg_log_level="error")
    writer.send(None)
    try:
        writer.send(np.ascontiguousarray(first))
        for picture in pictures:
            writer.send(np.ascontiguousarray(picture))
    except OSError as error:
        raise InputError(f"{path}: ffmpeg could not write it ({' '.join(str(error).split())[:120]})") from None
    finally:
        writer.close()


def _ffmpeg():
    try:
        import imageio_ffmpeg
    except ModuleNotFoundError:
        raise MissingDependencyError(
            "an MP4 preview needs imageio-ffmpeg: pip install 'softdeca[preview]', or take --preview gif"
        ) from None
    return imageio_ffmpeg
