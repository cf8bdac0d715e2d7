"""Rendered heads, off screen: light skin, errors as colours, layers cut open. PNG as bytes.

Captions and colour bars stand in bands of their own above and below the heads. A PNG names the number of its panels in
the text chunk PANELS, so that a page can lay them out one by one.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..lhm.base.geometry.rays import visible_sky
from ..lhm.base.geometry.topology import close_openings
from ..lhm.base.mesh import Floats, Ints, Surface
from ..lhm.head.detail import FineSkin
from ..lhm.head.head import LayeredHead
from .eyes_and_teeth import find_eyes_and_teeth

SKIN, INSIDE = "#d8a48f", "#4a211f"
LIGHT = 0.2
"""The share of the sky from which up a vertex is drawn as skin; one that sees nothing is drawn as INSIDE."""
SOFT = "#e9c46a"
MUSCLE = "#b5413b"
BONE = "#e8e4d8"
VIEW = (0.45, 0.08, 1.0)
"""From the front, a little from the subject's left; x is the subject's left, y up, z forward."""
PANELS, VALUES = "panels", "YlOrRd"
"""Name of the text chunk, and colour map of distances."""
SIDE = (1.0, 0.05, 0.15)
MARGIN = 1.06
"""Height of a picture over that of what it frames."""


@dataclass(frozen=True)
class Panel:
    """One view: a surface with a caption, coloured by values [mm], shape (n,), from 0 to `top` where given.

    weights (52,) of its expression turn the eyes, where a skin has some.
    """

    caption: str
    surface: Surface
    values: Floats | None = None
    top: float = 1.0
    weights: Floats | None = None


def load_pyvista():
    """The package pyvista, set to draw off screen."""
    # VTK looks for an X server first, and says so on stderr, although it then renders without one.
    os.environ.setdefault(
        "VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow" if _has_egl() else "vtkOSOpenGLRenderWindow"
    )
    import pyvista

    pyvista.OFF_SCREEN = True
    return pyvista


def _has_egl() -> bool:
    from ctypes.util import find_library

    return find_library("EGL") is not None


def to_polydata(pyvista, vertices: Floats, triangles: Ints):
    """A mesh of pyvista's."""
    faces = np.hstack([np.full((len(triangles), 1), 3), triangles])
    return pyvista.PolyData(np.asarray(vertices), faces.ravel())


def aim_camera(plotter, centre: Floats, height: float, view: Sequence[float]):
    """Let a plotter see a height [mm] about a centre [mm] from the direction `view`, without perspective."""
    direction = np.asarray(view) / np.linalg.norm(view)
    plotter.camera.parallel_projection = True
    plotter.camera.focal_point = centre
    plotter.camera.position = centre + 1000.0 * direction
    plotter.camera.up = (0.0, 1.0, 0.0)
    plotter.camera.parallel_scale = 0.5 * height
    plotter.reset_camera_clipping_range()


def add_back(plotter, surface: Surface):
    """Add a surface's reverse to a plotter, dark and with its openings closed, and return the mesh.

    It is what is seen through an open mouth without a lining.
    """
    whole = close_openings(surface)
    mesh = to_polydata(load_pyvista(), whole.vertices, whole.triangles)
    plotter.add_mesh(mesh, color=INSIDE, lighting=False, culling="front", reset_camera=False)
    return mesh


def add_eyes_and_teeth(plotter, skin: Surface, weights: Floats | None = None):
    """Add a skin's eyes and teeth to a plotter, and return the mesh; None where none are known."""
    organs = find_eyes_and_teeth(skin)
    if organs is None:
        return None
    mesh = to_polydata(load_pyvista(), organs.place(skin.vertices, weights), organs.triangles)
    how = {"smooth_shading": True, "specular": 0.5, "specular_power": 30, "reset_camera": False}
    plotter.add_mesh(mesh, scalars=organs.colours, rgb=True, **how)
    return mesh


def skin_colours(colours: NDArray[np.uint8] | None) -> dict[str, Any]:
    """How a skin is drawn: SKIN, or `colours` (n, 3) seen from outside."""
    return {"color": SKIN} if colours is None else {"scalars": colours, "rgb": True, "culling": "back"}


def light_share(surface: Surface) -> Floats:
    """The share (n,) of SKIN in a vertex' colour, from 0 where it sees nothing of the sky to 1."""
    return np.clip(visible_sky(surface) / LIGHT, 0.0, 1.0)


def drawn_surface(skin: Surface, fine: FineSkin | None) -> Surface:
    """The surface that a skin is drawn as: itself, or finer."""
    return skin if fine is None else fine.refine(skin.vertices)


def shade_skin(rest: Surface, fine: FineSkin | None = None) -> NDArray[np.uint8]:
    """Colours (n, 3) of a skin at rest as it is drawn: INSIDE where it sees no sky, else SKIN, or a scan's own."""
    own: Floats | NDArray[np.uint8] = parse_colour(SKIN)
    if fine is None:
        seen = light_share(rest)[:, None]
    else:
        ended = rest.with_vertices(fine.end_neck(rest.vertices))
        seen = np.clip(fine.spread(light_share(ended)), 0.0, 1.0)[:, None]
        own = own if fine.colours is None else fine.colours
    return np.round(seen * own + (1 - seen) * parse_colour(INSIDE)).astype(np.uint8)


def parse_colour(text: str) -> Floats:
    """Red, green and blue, 0 to 255, shape (3,), of a colour as #rrggbb."""
    return np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)], dtype=float)


def to_linear_light(colours: Floats | NDArray[np.uint8]) -> Floats:
    """Colours of a screen, 0 to 255, as shares of light in [0, 1], which a renderer reckons in (gamma 2.2)."""
    return (colours / 255.0) ** 2.2


@dataclass(frozen=True)
class Bar:
    """A colour bar: a colour map of Matplotlib, the values at its ends, and a title with the unit."""

    cmap: str
    low: float
    high: float
    title: str


def frame_view(
    surfaces: Sequence[Floats], view: Sequence[float], framed: Floats | None = None, aspect: float = 1.0
) -> tuple[Floats, float]:
    """Centre (3,) [mm] and height [mm] of a picture, `aspect` times as wide, seen from the direction `view`.

    It shows all points of the surfaces, each (n, 3) [mm]. With `framed` (k, 3) [mm] it shows these points and all above
    them, since a crown is never cut off.
    """
    ahead = np.asarray(view, dtype=np.float64) / np.linalg.norm(view)
    right = np.cross((0.0, 1.0, 0.0), ahead)
    right /= np.linalg.norm(right)
    up = np.cross(ahead, right)
    points = np.vstack(surfaces)
    shown = points if framed is None else framed
    x, low, high = shown @ right, (shown @ up).min(), (points @ up).max()
    centre = 0.5 * (x.min() + x.max()) * right + 0.5 * (low + high) * up + shown.mean(axis=0) @ ahead * ahead
    return centre, MARGIN * float(max(high - low, np.ptp(x) / aspect))


def _sheet(plotter, captions: Sequence[str], bars: Sequence[Bar | None] = (), legend: str = "") -> bytes:
    """Close a plotter of panels side by side; PNG of them with captions above, and bars and a legend below."""
    from PIL import Image, ImageDraw, ImageFont
    from PIL.PngImagePlugin import PngInfo

    drawn = Image.fromarray(np.asarray(plotter.screenshot(None, return_img=True)))
    plotter.close()
    width = drawn.width // len(captions)
    size = max(12, width // 18)
    font = ImageFont.load_default(size)
    lines = [_wrap(caption, font.getlength, 0.94 * width) for caption in captions]
    above = max(len(each) for each in lines) * round(1.3 * size) + size // 2
    below = 3 * size if any(bars) else 0
    listed = legend.splitlines()
    last = (len(listed) + 1) * round(1.3 * size) if listed else 0
    sheet = Image.new("RGB", (drawn.width, above + drawn.height + below + last), "white")
    sheet.paste(drawn, (0, above))
    draw = ImageDraw.Draw(sheet)

    def write(text: str, x: float, y: float, anchor: str = "mt") -> None:
        draw.text((x, y), text, fill="black", font=font, anchor=anchor)

    for column, each in enumerate(lines):
        for k, line in enumerate(each):
            write(line, (column + 0.5) * width, size // 3 + k * round(1.3 * size))
    for column, bar in enumerate(bars):
        if bar is not None:
            left, top = round((column + 0.1) * width), above + drawn.height + size // 2
            sheet.paste(_gradient(bar.cmap, round(0.8 * width), round(0.8 * size)), (left, top))
            under = top + size
            write(f"{bar.low:.3g}", left, under, "lt")
            write(bar.title, left + 0.4 * width, under)
            write(f"{bar.high:.3g}", left + 0.8 * width, under, "rt")
    for k, line in enumerate(listed):
        write(line, size, above + drawn.height + below + k * round(1.3 * size), "lt")
    buffer, notes = io.BytesIO(), PngInfo()
    # A legend of all panels is no part of one.
    notes.add_text(PANELS, str(1 if legend else len(captions)))
    sheet.save(buffer, "PNG", pnginfo=notes)
    return buffer.getvalue()


def _wrap(text: str, length: Callable[[str], float], width: float) -> list[str]:
    """A caption in lines of at most `width` [pixels], where its words allow it."""
    lines: list[str] = []
    for paragraph in text.splitlines() or [""]:
        line = ""
        for word in paragraph.split():
            longer = f"{line} {word}".strip()
            if line and length(longer) > width:
                lines.append(line)
                longer = word
            line = longer
        lines.append(line)
    return lines


def _gradient(cmap: str, width: int, height: int):
    from matplotlib import colormaps
    from PIL import Image

    colours = np.round(255 * colormaps[cmap](np.linspace(0.0, 1.0, width))[:, :3]).astype(np.uint8)
    return Image.fromarray(np.repeat(colours[None], height, axis=0))


def draw_strip(
    panels: Sequence[Panel],
    *,
    view: Sequence[float] = VIEW,
    size: int = 340,
    framed: Floats | None = None,
    rest: Surface | None = None,
    fine: FineSkin | None = None,
) -> bytes:
    """Panels side by side at one scale, with a colour bar under each coloured one.

    The picture frames the points `framed` [mm], shape (k, 3), and the crown, by default all of the surfaces. Hidden
    parts of `rest`, the head at rest, are drawn dark. `fine` draws skins finer.
    """
    pyvista = load_pyvista()
    colours = None if rest is None else shade_skin(rest, fine)
    window = (size * len(panels), int(size * 1.2))
    plotter = pyvista.Plotter(off_screen=True, shape=(1, len(panels)), window_size=window, border=False)
    plotter.set_background("white", all_renderers=True)
    centre, height = frame_view([panel.surface.vertices for panel in panels], view, framed, 1.0 / 1.2)
    for column, panel in enumerate(panels):
        plotter.subplot(0, column)
        drawn = drawn_surface(panel.surface, fine)
        mesh = to_polydata(pyvista, drawn.vertices, drawn.triangles)
        add_eyes_and_teeth(plotter, panel.surface, panel.weights)
        if panel.values is None:
            plotter.add_mesh(mesh, **skin_colours(colours), smooth_shading=True, specular=0.15)
            if colours is not None:
                add_back(plotter, drawn)
        else:
            how = {"cmap": VALUES, "clim": (0.0, panel.top), "show_scalar_bar": False}
            values = panel.values if fine is None else fine.spread(panel.values)
            plotter.add_mesh(mesh, scalars=values, smooth_shading=True, **how)
        aim_camera(plotter, centre, height, view)
    bars = [None if panel.values is None else Bar(VALUES, 0.0, panel.top, "mm") for panel in panels]
    return _sheet(plotter, [panel.caption for panel in panels], bars)


def draw_cut_away(head: LayeredHead, *, positions: Floats | None = None, size: int = 520) -> bytes:
    """The head's left half with its layers open at the mid-plane, beside the skull wrap's labels."""
    pyvista = load_pyvista()
    vertices = head.vertices if positions is None else positions
    plotter = pyvista.Plotter(off_screen=True, shape=(1, 3), window_size=(3 * size, size), border=False)
    across = head.skin_wrap.vertices[:, 0]
    middle = vertices[head.tets].mean(axis=1)[:, 0] < 0.5 * (across.min() + across.max())
    layer = np.repeat([0, 1], [len(head.soft.tets), len(head.muscle.tets)])
    plotter.subplot(0, 0)
    for which, colour in ((0, SOFT), (1, MUSCLE)):
        tets = head.tets[middle & (layer == which)]
        cells = np.hstack([np.full((len(tets), 1), 4), tets]).ravel()
        grid = pyvista.UnstructuredGrid(cells, np.full(len(tets), pyvista.CellType.TETRA), np.asarray(vertices))
        plotter.add_mesh(grid, color=colour, show_edges=True, edge_color="#55443a", line_width=0.5)
    aim_camera(plotter, *frame_view([vertices], SIDE), SIDE)
    n = len(head.bone)
    for column, colours in enumerate((np.zeros(n), head.bone), start=1):
        plotter.subplot(0, column)
        first = 0 if column == 1 else 2 * n
        mesh = to_polydata(pyvista, vertices[first : first + n], head.skin_wrap.triangles)
        palette = [SKIN, BONE, "#7aa6c2"] if column == 2 else [SKIN]
        plotter.add_mesh(
            mesh,
            scalars=colours,
            cmap=palette,
            show_edges=True,
            edge_color="#776655",
            edge_opacity=0.25,
            line_width=0.4,
            show_scalar_bar=False,
            interpolate_before_map=False,
        )
        aim_camera(plotter, *frame_view([vertices], VIEW), VIEW)
    plotter.set_background("white", all_renderers=True)
    words = ("soft tissue and muscle, cut at the mid-plane", "skin wrap")
    return _sheet(plotter, [*words, "skull wrap: cranium white, mandible blue, rest free"])


def draw_views(
    panels: Sequence[tuple[str, Surface, Sequence[float]]],
    *,
    size: int = 520,
    framed: Floats | None = None,
    rest: Surface | None = None,
    fine: FineSkin | None = None,
) -> bytes:
    """Surfaces side by side at one scale, (caption, surface, view): light skin seen from these directions.

    `framed`, `rest` and `fine` as in `draw_strip`.
    """
    pyvista = load_pyvista()
    colours = None if rest is None else shade_skin(rest, fine)
    shape = (1, len(panels))
    plotter = pyvista.Plotter(off_screen=True, shape=shape, window_size=(size * len(panels), size), border=False)
    surfaces = [surface.vertices for _, surface, _ in panels]
    for column, (_, surface, view) in enumerate(panels):
        plotter.subplot(0, column)
        drawn = drawn_surface(surface, fine)
        mesh = to_polydata(pyvista, drawn.vertices, drawn.triangles)
        mesh.point_data.active_normals = drawn.vertex_normals
        add_eyes_and_teeth(plotter, surface)
        actor = plotter.add_mesh(mesh, **skin_colours(colours), specular=0.1, specular_power=8, ambient=0.12)
        if colours is not None:
            add_back(plotter, drawn)
        actor.prop.interpolation = "Phong"
        aim_camera(plotter, *frame_view(surfaces, view, framed), view)
    plotter.set_background("white", all_renderers=True)
    return _sheet(plotter, [caption for caption, _, _ in panels])


def draw_values(
    panels: Sequence[tuple[str, Surface, Floats | None, Sequence[float]]],
    *,
    title: str,
    limits: tuple[float, float],
    points: tuple[Floats, Floats] | None = None,
    size: int = 520,
) -> bytes:
    """Surfaces side by side at one scale, (caption, surface, values (n,) or None, view), each with a colour bar.

    A surface without values is faded, and `points` (k, 3) [mm] with values (k,) are drawn in it, for all panels.
    """
    pyvista = load_pyvista()
    shape = (1, len(panels))
    plotter = pyvista.Plotter(off_screen=True, shape=shape, window_size=(size * len(panels), size), border=False)
    surfaces = [surface.vertices for _, surface, _, _ in panels]
    bar = Bar(VALUES if points is None else "inferno", *limits, title)
    how = {"cmap": bar.cmap, "clim": limits, "show_scalar_bar": False}
    for column, (_, surface, values, view) in enumerate(panels):
        plotter.subplot(0, column)
        mesh = to_polydata(pyvista, surface.vertices, surface.triangles)
        if values is not None:
            plotter.add_mesh(mesh, scalars=values, smooth_shading=True, **how)
        else:
            plotter.add_mesh(mesh, color=SKIN, opacity=0.25, smooth_shading=True)
        if points is not None:
            dots = pyvista.PolyData(np.asarray(points[0]))
            plotter.add_mesh(dots, scalars=points[1], point_size=9, render_points_as_spheres=True, **how)
        aim_camera(plotter, *frame_view(surfaces, view), view)
    plotter.set_background("white", all_renderers=True)
    return _sheet(plotter, [caption for caption, _, _, _ in panels], [bar] * len(panels))


def draw_labelled(
    surface: Surface,
    points: Mapping[str, Floats],
    views: Sequence[tuple[str, Sequence[float]]],
    *,
    framed: Floats,
    size: int = 560,
) -> bytes:
    """A surface from several views (caption, direction), with points [mm] by name, numbered.

    The names are listed below; `framed` as in `draw_strip`.
    """
    pyvista = load_pyvista()
    window = (size * len(views), size)
    plotter = pyvista.Plotter(off_screen=True, shape=(1, len(views)), window_size=window, border=False)
    places = np.array(list(points.values()), dtype=np.float64).reshape(-1, 3)
    for column, (_, view) in enumerate(views):
        plotter.subplot(0, column)
        mesh = to_polydata(pyvista, surface.vertices, surface.triangles)
        plotter.add_mesh(mesh, color=SKIN, smooth_shading=True, specular=0.15)
        plotter.add_point_labels(
            places + 2.0 * np.asarray(view) / np.linalg.norm(view),
            [str(number) for number in range(1, len(points) + 1)],
            font_size=14,
            point_size=9,
            point_color="#1f4e79",
            text_color="black",
            shape_color="white",
            shape_opacity=0.6,
            render_points_as_spheres=True,
            always_visible=True,
        )
        aim_camera(plotter, *frame_view([surface.vertices], view, framed), view)
    plotter.set_background("white", all_renderers=True)
    legend = "\n".join(f"{number}  {name}" for number, name in enumerate(points, start=1))
    return _sheet(plotter, [caption for caption, _ in views], legend=legend)
