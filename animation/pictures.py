"""Rendered heads, off screen: light skin, errors as colours, layers cut open. PNG as bytes.

Captions and colour bars stand in bands of their own above and below the heads. A PNG names the number of its panels in
the text chunk PANELS, so that a page can lay them out one by one.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
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
PANELS, VALUES, WORST = "panels", "YlOrRd", "inferno"
"""Name of the text chunk, and colour maps of distances and of points, whose least values are dark."""
SIDE = (1.0, 0.05, 0.15)
MARGIN = 1.06
"""Height of a picture over that of what it frames."""


@dataclass(frozen=True)
class Panel:
    """One view: a surface with a caption, coloured by values, shape (n,), from `low` to `top` where given.

    A bar tells the colours and `title`, by default the unit mm. weights (52,) of its expression turn the eyes, where a
    skin has some. With `points` (k, 3) [mm] the surface is faded, and the values (k,) are theirs. `named` are points
    (3,) [mm] that are numbered, and listed below by name.
    """

    caption: str
    surface: Surface
    values: Floats | None = None
    top: float = 1.0
    weights: Floats | None = None
    view: Sequence[float] | None = None
    low: float = 0.0
    title: str = "mm"
    points: Floats | None = None
    named: Mapping[str, Floats] = field(default_factory=dict)


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
    how: dict[str, Any] = {"smooth_shading": True, "specular": 0.5, "specular_power": 30, "reset_camera": False}
    plotter.add_mesh(mesh, scalars=organs.colours, rgb=True, **how)
    return mesh


def skin_colours(colours: NDArray[np.uint8] | None) -> dict[str, Any]:
    """How a skin is drawn: SKIN, or `colours` (n, 3) seen from outside."""
    how: dict[str, Any] = {"specular": 0.1, "specular_power": 8, "ambient": 0.12}
    own: dict[str, Any] = {"color": SKIN} if colours is None else {"scalars": colours, "rgb": True, "culling": "back"}
    return how | own


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


def _sheet(plotter, panels: Sequence[Panel], legend: str = "") -> bytes:
    """Close a plotter of panels side by side; PNG of them with captions above, and bars and a legend below."""
    from PIL import Image, ImageDraw, ImageFont
    from PIL.PngImagePlugin import PngInfo

    drawn = Image.fromarray(np.asarray(plotter.screenshot(None, return_img=True)))
    plotter.close()
    width = drawn.width // len(panels)
    size = max(12, width // 18)
    font = ImageFont.load_default(size)
    lines = [_wrap(panel.caption, font.getlength, 0.94 * width) for panel in panels]
    above = max(len(each) for each in lines) * round(1.3 * size) + size // 2
    below = round(4.3 * size) if any(panel.values is not None for panel in panels) else 0
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
    for column, panel in enumerate(panels):
        if panel.values is not None:
            left, top = round((column + 0.1) * width), above + drawn.height + size // 2
            sheet.paste(_gradient(_colour_map(panel), round(0.8 * width), round(0.8 * size)), (left, top))
            under = top + size
            write(f"{panel.low:.3g}", left, under, "lt")
            write(f"{panel.top:.3g}", left + 0.8 * width, under, "rt")
            write(panel.title, left + 0.4 * width, under + round(1.3 * size))  # beside the numbers it may not fit
    for k, line in enumerate(listed):
        write(line, size, above + drawn.height + below + k * round(1.3 * size), "lt")
    buffer, notes = io.BytesIO(), PngInfo()
    # A legend of all panels is no part of one.
    notes.add_text(PANELS, str(1 if legend else len(panels)))
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
    """Panels side by side at one scale, with a colour bar under each coloured one; `view` is that of panels without.

    The picture frames the points `framed` [mm], shape (k, 3), and the crown, by default all of the surfaces. Hidden
    parts of `rest`, the head at rest, are drawn dark. `fine` draws skins finer.
    """
    pyvista = load_pyvista()
    colours = None if rest is None else shade_skin(rest, fine)
    plotter = _make_plotter(len(panels), size, round(1.2 * size))
    surfaces = [panel.surface.vertices for panel in panels]
    for column, panel in enumerate(panels):
        plotter.subplot(0, column)
        drawn = drawn_surface(panel.surface, fine)
        mesh = to_polydata(pyvista, drawn.vertices, drawn.triangles)
        if panel.points is not None:
            plotter.add_mesh(mesh, color=SKIN, opacity=0.25, smooth_shading=True)
            dots = pyvista.PolyData(np.asarray(panel.points))
            how = _colour_by(panel) | {"point_size": 9, "render_points_as_spheres": True}
            plotter.add_mesh(dots, scalars=panel.values, **how)
        elif panel.values is not None:
            values = panel.values if fine is None else fine.spread(panel.values)
            plotter.add_mesh(mesh, scalars=values, smooth_shading=True, **_colour_by(panel))
        else:
            plotter.add_mesh(mesh, **skin_colours(colours), smooth_shading=True)
            if colours is not None:
                add_back(plotter, drawn)
        if panel.points is None:
            add_eyes_and_teeth(plotter, panel.surface, panel.weights)
        seen_from = view if panel.view is None else panel.view
        _add_numbers(plotter, panel.named, seen_from)
        aim_camera(plotter, *frame_view(surfaces, seen_from, framed, 1.0 / 1.2), seen_from)
    legend = "\n".join(f"{number}  {name}" for number, name in enumerate(panels[0].named, start=1))
    return _sheet(plotter, panels, legend)


def _make_plotter(columns: int, width: int, height: int):
    """A plotter of so many white panels, each of this size [pixels]."""
    window = (columns * width, height)
    plotter = load_pyvista().Plotter(off_screen=True, shape=(1, columns), window_size=window, border=False)
    plotter.set_background("white", all_renderers=True)
    return plotter


def _colour_map(panel: Panel) -> str:
    return VALUES if panel.points is None else WORST


def _colour_by(panel: Panel) -> dict[str, Any]:
    return {"cmap": _colour_map(panel), "clim": (panel.low, panel.top), "show_scalar_bar": False}


def _add_numbers(plotter, named: Mapping[str, Floats], view: Sequence[float]) -> None:
    """Add points [mm] with their numbers, a little before the surface."""
    if not named:
        return
    places = np.array(list(named.values()), dtype=np.float64).reshape(-1, 3)
    plotter.add_point_labels(
        places + 2.0 * np.asarray(view) / np.linalg.norm(view),
        [str(number) for number in range(1, len(named) + 1)],
        font_size=14,
        point_size=9,
        point_color="#1f4e79",
        text_color="black",
        shape_color="white",
        shape_opacity=0.6,
        render_points_as_spheres=True,
        always_visible=True,
    )


def draw_cut_away(head: LayeredHead, *, positions: Floats | None = None, size: int = 520) -> bytes:
    """The head's left half with its layers open at the mid-plane, beside the skull wrap's labels."""
    pyvista = load_pyvista()
    vertices = head.vertices if positions is None else positions
    plotter = _make_plotter(3, size, size)
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
    words = ("soft tissue and muscle, cut at the mid-plane", "skin wrap")
    captions = (*words, "skull wrap: cranium white, mandible blue, rest free")
    return _sheet(plotter, [Panel(caption, head.skin_wrap) for caption in captions])
