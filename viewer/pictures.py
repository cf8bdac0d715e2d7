"""Rendered heads, off screen: light skin, errors as colours, layers cut open. PNG as bytes."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..lhm.geometry.closing import closed
from ..lhm.head import LayeredHead
from ..lhm.mesh import Floats, Ints, Surface
from .shading import INSIDE, SKIN, shades
from .within import within

SOFT = "#e9c46a"
MUSCLE = "#b5413b"
BONE = "#e8e4d8"
VIEW = (0.45, 0.08, 1.0)
"""From the front, a little from the subject's left; x is the subject's left, y up, z forward."""


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


def poly(pyvista, vertices: Floats, triangles: Ints):
    """A mesh of pyvista's."""
    faces = np.hstack([np.full((len(triangles), 1), 3), triangles])
    return pyvista.PolyData(np.asarray(vertices), faces.ravel())


def look(plotter, centre: Floats, height: float, view: Sequence[float]):
    """Let a plotter see a height [mm] about a centre [mm] from the direction `view`, without perspective."""
    direction = np.asarray(view) / np.linalg.norm(view)
    plotter.camera.parallel_projection = True
    plotter.camera.focal_point = centre
    plotter.camera.position = centre + 1000.0 * direction
    plotter.camera.up = (0.0, 1.0, 0.0)
    plotter.camera.parallel_scale = 0.5 * height
    plotter.reset_camera_clipping_range()


def behind(plotter, surface: Surface):
    """Add a surface's reverse to a plotter, dark and with its openings closed, and return the mesh.

    It is what is seen through an open mouth without a lining.
    """
    whole = closed(surface)
    mesh = poly(load_pyvista(), whole.vertices, whole.triangles)
    plotter.add_mesh(mesh, color=INSIDE, lighting=False, culling="front", reset_camera=False)
    return mesh


def eyes_and_teeth(plotter, skin: Surface, weights: Floats | None = None):
    """Add a skin's eyes and teeth to a plotter, and return the mesh; None where none are known."""
    found = within(skin)
    if found is None:
        return None
    mesh = poly(load_pyvista(), found.at(skin.vertices, weights), found.triangles)
    how = {"smooth_shading": True, "specular": 0.5, "specular_power": 30, "reset_camera": False}
    plotter.add_mesh(mesh, scalars=found.colours, rgb=True, **how)
    return mesh


def skin_colours(colours: NDArray[np.uint8] | None) -> dict[str, Any]:
    """How a skin is drawn: SKIN, or `colours` (n, 3) seen from outside."""
    return {"color": SKIN} if colours is None else {"scalars": colours, "rgb": True, "culling": "back"}


def _png(plotter) -> bytes:
    buffer = io.BytesIO()
    plotter.screenshot(buffer)
    plotter.close()
    return buffer.getvalue()


def strip(
    panels: Sequence[Panel],
    *,
    view: Sequence[float] = VIEW,
    size: int = 340,
    framed: Floats | None = None,
    rest: Surface | None = None,
) -> bytes:
    """Panels side by side at one scale, with a colour bar under each coloured one.

    Captions of coloured panels say what the bar's end stands for. The picture is as high as the points `framed` [mm],
    shape (k, 3), by default all of the first surface's. What is hidden in `rest`, the head at rest, is drawn dark.
    """
    pyvista = load_pyvista()
    colours = None if rest is None else shades(rest)
    plotter = pyvista.Plotter(
        off_screen=True, shape=(1, len(panels)), window_size=(size * len(panels), int(size * 1.3)), border=False
    )
    points = panels[0].surface.vertices if framed is None else framed
    tall = np.ptp(points[:, 1])
    centre, height = (points.max(0) + points.min(0)) / 2 + [0.0, 0.08 * tall, 0.0], 1.28 * tall  # captions above
    for column, panel in enumerate(panels):
        plotter.subplot(0, column)
        mesh = poly(pyvista, panel.surface.vertices, panel.surface.triangles)
        eyes_and_teeth(plotter, panel.surface, panel.weights)
        if panel.values is None:
            plotter.add_mesh(mesh, **skin_colours(colours), smooth_shading=True, specular=0.15)
            if colours is not None:
                behind(plotter, panel.surface)
        else:
            bar = {
                "title": f"mm, {column + 1}",
                "n_labels": 0,
                "title_font_size": 1,
            }
            bar |= {"width": 0.7, "height": 0.05, "position_x": 0.15, "position_y": 0.02, "color": "black"}
            plotter.add_mesh(
                mesh,
                scalars=panel.values,
                cmap="viridis",
                clim=(0.0, panel.top),
                smooth_shading=True,
                scalar_bar_args=bar,
            )
        caption = panel.caption if panel.values is None else f"{panel.caption}\n0 to {panel.top:.2g} mm"
        plotter.add_text(caption, position="upper_edge", font_size=9, color="black")
        plotter.set_background("white")
        look(plotter, centre, height, view)
    return _png(plotter)


def cut_away(head: LayeredHead, *, positions: Floats | None = None, size: int = 520) -> bytes:
    """The head's left half with its layers open at the mid-plane, beside the skull wrap's labels."""
    pyvista = load_pyvista()
    vertices = head.vertices if positions is None else positions
    plotter = pyvista.Plotter(off_screen=True, shape=(1, 3), window_size=(3 * size, size), border=False)
    skin = head.skin_wrap.vertices
    centre, height = (skin.max(0) + skin.min(0)) / 2, 1.4 * np.ptp(skin[:, 1])
    middle = vertices[head.tets].mean(axis=1)[:, 0] < centre[0]
    layer = np.repeat([0, 1], [len(head.soft.tets), len(head.muscle.tets)])
    plotter.subplot(0, 0)
    for which, colour in ((0, SOFT), (1, MUSCLE)):
        tets = head.tets[middle & (layer == which)]
        cells = np.hstack([np.full((len(tets), 1), 4), tets]).ravel()
        grid = pyvista.UnstructuredGrid(cells, np.full(len(tets), pyvista.CellType.TETRA), np.asarray(vertices))
        plotter.add_mesh(grid, color=colour, show_edges=True, edge_color="#55443a", line_width=0.5)
    plotter.add_text("soft tissue and muscle,\ncut at the mid-plane", position="upper_edge", font_size=9, color="black")
    look(plotter, centre, height, (1.0, 0.05, 0.15))
    n = len(head.bone)
    for column, (name, colours) in enumerate(
        (("skin wrap", np.zeros(n)), ("skull wrap: cranium white,\nmandible blue, rest free", head.bone)), start=1
    ):
        plotter.subplot(0, column)
        first = 0 if column == 1 else 2 * n
        mesh = poly(pyvista, vertices[first : first + n], head.skin_wrap.triangles)
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
        plotter.add_text(name, position="upper_edge", font_size=9, color="black")
        look(plotter, centre, height, VIEW)
    plotter.set_background("white", all_renderers=True)
    return _png(plotter)


def views(
    panels: Sequence[tuple[str, Surface, Sequence[float]]],
    *,
    size: int = 520,
    framed: Floats | None = None,
    rest: Surface | None = None,
) -> bytes:
    """Surfaces side by side at one scale, (caption, surface, view): light skin seen from these directions.

    `framed` and `rest` as in `strip`.
    """
    pyvista = load_pyvista()
    colours = None if rest is None else shades(rest)
    shape = (1, len(panels))
    plotter = pyvista.Plotter(off_screen=True, shape=shape, window_size=(size * len(panels), size), border=False)
    x = panels[0][1].vertices if framed is None else framed
    centre, height = (x.max(0) + x.min(0)) / 2, 1.15 * np.ptp(x[:, 1])
    for column, (caption, surface, view) in enumerate(panels):
        plotter.subplot(0, column)
        mesh = poly(pyvista, surface.vertices, surface.triangles)
        mesh.point_data.active_normals = surface.vertex_normals
        eyes_and_teeth(plotter, surface)
        actor = plotter.add_mesh(mesh, **skin_colours(colours), specular=0.1, specular_power=8, ambient=0.12)
        if colours is not None:
            behind(plotter, surface)
        actor.prop.interpolation = "Phong"
        plotter.add_text(caption, position="upper_edge", font_size=9, color="black")
        look(plotter, centre, height, view)
    plotter.set_background("white", all_renderers=True)
    return _png(plotter)


def coloured(
    panels: Sequence[tuple[str, Surface, Floats | None, Sequence[float]]],
    *,
    title: str,
    limits: tuple[float, float],
    points: tuple[Floats, Floats] | None = None,
    size: int = 520,
) -> bytes:
    """Surfaces side by side at one scale, (caption, surface, values (n,) or None, view), with one colour bar.

    A surface without values is faded, and `points` (k, 3) [mm] with values (k,) are drawn in it, for all panels.
    """
    pyvista = load_pyvista()
    shape = (1, len(panels))
    plotter = pyvista.Plotter(off_screen=True, shape=shape, window_size=(size * len(panels), size), border=False)
    x = panels[0][1].vertices
    centre, height = (x.max(0) + x.min(0)) / 2, 1.3 * np.ptp(x[:, 1])
    bar = {"title": title, "n_labels": 5, "fmt": "%.3g", "title_font_size": 16, "label_font_size": 14, "color": "black"}
    bar |= {"width": 0.8, "height": 0.08, "position_x": 0.1, "position_y": 0.02}
    for column, (caption, surface, values, view) in enumerate(panels):
        plotter.subplot(0, column)
        mesh = poly(pyvista, surface.vertices, surface.triangles)
        how = {"cmap": "viridis", "clim": limits, "show_scalar_bar": column == len(panels) // 2, "scalar_bar_args": bar}
        if values is not None:
            plotter.add_mesh(mesh, scalars=values, smooth_shading=True, **how)
        else:
            plotter.add_mesh(mesh, color=SKIN, opacity=0.25, smooth_shading=True)
        if points is not None:
            how["cmap"] = "inferno"
            dots = pyvista.PolyData(np.asarray(points[0]))
            plotter.add_mesh(dots, scalars=points[1], point_size=9, render_points_as_spheres=True, **how)
        plotter.add_text(caption, position="upper_edge", font_size=9, color="black")
        look(plotter, centre, height, view)
    plotter.set_background("white", all_renderers=True)
    return _png(plotter)


def labelled(
    surface: Surface,
    points: Mapping[str, Floats],
    views: Sequence[tuple[str, Sequence[float]]],
    *,
    framed: Floats,
    size: int = 560,
) -> bytes:
    """A surface from several views (caption, direction), with points [mm] by name, numbered; `framed` as in `strip`."""
    pyvista = load_pyvista()
    window = (size * len(views), size)
    plotter = pyvista.Plotter(off_screen=True, shape=(1, len(views)), window_size=window, border=False)
    centre, height = (framed.max(0) + framed.min(0)) / 2, 1.12 * np.ptp(framed[:, 1])
    places = np.array(list(points.values()), dtype=np.float64).reshape(-1, 3)
    for column, (caption, view) in enumerate(views):
        plotter.subplot(0, column)
        mesh = poly(pyvista, surface.vertices, surface.triangles)
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
        plotter.add_text(caption, position="upper_edge", font_size=9, color="black")
        if column == 0:
            text = "\n".join(f"{number}  {name}" for number, name in enumerate(points, start=1))
            plotter.add_text(text, position="lower_left", font_size=7, color="black")
        look(plotter, centre, height, view)
    plotter.set_background("white", all_renderers=True)
    return _png(plotter)
