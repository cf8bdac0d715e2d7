"""Pictures of one layered head: its layers cut open, sections, fit to the skin, and where its worst tets are. PNG."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..lhm import expressions, identities
from ..lhm.base.errors import InputError
from ..lhm.base.geometry.bvh import TriangleTree
from ..lhm.base.geometry.tets import smallest_dihedrals
from ..lhm.base.mesh import Floats, Surface
from ..lhm.head.head import LayeredHead
from ..lhm.template.depths.pairs import MeasuredDepths
from ..reference import Parameters, facial_scene, solve
from .pictures import MUSCLE, SIDE, SOFT, VIEW, Panel, draw_cut_away, draw_strip, load_pyvista, to_polydata
from .plots import subplots, to_png

FRONT = (0.0, 0.05, 1.0)
VIEWS = (("skin", FRONT), ("from the subject's left", SIDE), ("half from the left", VIEW))
BEHIND = (-0.45, 0.08, -1.0)
SIZE = 520
WORST = 300
LARGEST_GAP = 2.0  # [mm] the colour bar's end; what is farther has its colour


def expression_deltas(head: LayeredHead, name: str, space_name: str | None = None) -> Floats:
    """Return each expression's displacements of a skin [mm], shape (52, n, 3): by its own rig, or an identity space's.

    InputError, naming the head by `name`, if it has no rig, or is not of the space's topology.
    """
    if space_name is None and head.rig is not None:
        return head.rig.deltas.astype(np.float64)
    space = identities.from_text(space_name or "anny")
    if not np.array_equal(head.skin.triangles, space.triangles):
        more = "" if head.rig is not None else "; fit it anew, and it keeps expressions of its own"
        raise InputError(f"{name}: its skin has not the triangles of {space.name!r}{more}")
    return space.shapes_on(head.skin)


def pose_head(head: LayeredHead, deltas: Floats, weights: Floats) -> tuple[Floats, Surface]:
    """All wraps' vertices [mm], shape (3 n, 3), and the skin, in an expression of ARKit weights (52,).

    The default parameters' projective dynamics.
    """
    used = np.flatnonzero(expressions.check_weights(weights))
    shape = head.skin.vertices + np.tensordot(weights[used], deltas[used], axes=1)
    solution = solve(facial_scene(head, Parameters(), shape), solver="projective")
    return solution.positions, head.skin.with_vertices(head.skin_after(shape, solution.positions[: len(head.bone)]))


def draw_head(
    head: LayeredHead, *, pose: tuple[Floats, Surface] | None = None, detail: bool = False
) -> Mapping[str, bytes]:
    """PNG by name: "skin", "layers" and "sections" (in `pose`, if given, else at rest), "fit" and "quality" at rest.

    With `detail` the first shows the head's fine skin.
    """
    fine = head.fine_skin if detail else None
    positions, skin = (head.vertices, head.skin) if pose is None else pose
    return {
        "skin": draw_strip(
            [Panel(caption, skin, view=view) for caption, view in VIEWS],
            size=SIZE,
            framed=head.skin_wrap.vertices,
            rest=head.skin,
            fine=fine,
        ),
        "layers": draw_cut_away(head, positions=positions),
        "sections": draw_sections(head, positions, skin),
        "fit": draw_fit(head),
        "quality": draw_quality(head),
    }


def draw_sections(head: LayeredHead, positions: Floats, skin: Surface) -> bytes:
    """The tissue [mm] in the mid-plane, and in the horizontal plane between the lips; the skin as a line."""
    from matplotlib.collections import LineCollection, PolyCollection

    pyvista = load_pyvista()
    rest = head.skin_wrap.vertices
    mouth = head.regions.get("lips", np.ones(len(rest), bool))
    wrap = positions[: len(rest)]
    middle = 0.5 * (wrap[:, 0].min() + wrap[:, 0].max())
    height = float(np.median(wrap[mouth, 1]))
    figure, axes = subplots(1, 2, figsize=(13, 7.2), width_ratios=(1, 1))
    planes = (
        (0, middle, (2, 1), "mid-plane", "z, forward [mm]", "y, up [mm]"),
        (
            1,
            height,
            (0, 2),
            f"horizontal plane through the mouth, y = {height:.0f} mm",
            "x, subject's left [mm]",
            "z [mm]",
        ),
    )
    for axis, (normal, place, shown, title, x_label, y_label) in zip(axes, planes, strict=True):
        for tets, colour, label in ((head.soft.tets, SOFT, "soft tissue"), (head.muscle.tets, MUSCLE, "muscle")):
            grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: tets}, positions)
            cut = grid.slice(np.eye(3)[normal], origin=place * np.eye(3)[normal])
            pieces = [cut.points[face][:, shown] for face in cut.irregular_faces]
            how: dict[str, Any] = {"facecolor": colour, "edgecolor": "#55443a", "linewidth": 0.25, "label": label}
            axis.add_collection(PolyCollection(pieces, **how))
        cut = to_polydata(pyvista, skin.vertices, skin.triangles).slice(
            np.eye(3)[normal], origin=place * np.eye(3)[normal]
        )
        lines = cut.points[cut.lines.reshape(-1, 3)[:, 1:]][:, :, shown]
        axis.add_collection(LineCollection(lines, color="#1f4e79", linewidth=0.9, label="skin"))
        axis.autoscale_view()
        axis.set_aspect("equal")
        axis.set_title(title, fontsize=11)
        axis.set(xlabel=x_label, ylabel=y_label)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncol=3)
    return to_png(figure)


def draw_fit(head: LayeredHead) -> bytes:
    """The skin with its distance to the skin wrap, and the skin wrap with its distance to the skin, as colours [mm]."""
    skin, wrap = head.skin, head.skin_wrap
    there = TriangleTree(skin.vertices, skin.triangles).closest(wrap.vertices)[2]
    back = TriangleTree(wrap.vertices, wrap.triangles).closest(skin.vertices)[2]
    panels = (
        ("skin: distance to its wrap", skin, back, FRONT),
        ("the same from the subject's left", skin, back, SIDE),
        ("skin wrap: distance to the skin", wrap, there, VIEW),
    )
    return draw_strip(
        [Panel(caption, surface, gap, LARGEST_GAP, view=view) for caption, surface, gap, view in panels],
        size=SIZE,
    )


def draw_quality(head: LayeredHead) -> bytes:
    """Draw the tets of the smallest dihedral angles, on the faded skin wrap, by angle [degrees]."""
    angles = smallest_dihedrals(head.vertices, head.tets)
    worst = np.argsort(angles)[:WORST]
    directions = (
        (f"the worst {len(worst)} of {len(angles)} tets", FRONT),
        ("from the subject's left", SIDE),
        ("from the subject's right", (-1.0, 0.05, 0.15)),
    )
    how = {
        "low": float(angles[worst[0]]),
        "title": "dihedral angle [degrees]",
        "points": head.vertices[head.tets[worst]].mean(axis=1),
    }
    top = float(angles[worst[-1]])
    return draw_strip(
        [Panel(caption, head.skin_wrap, angles[worst], top, view=view, **how) for caption, view in directions],
        size=SIZE,
    )


def draw_depth_comparison(skin_wrap: Surface, predicted: Floats, measured: MeasuredDepths) -> bytes:
    """PNG of one head's measured depths, grey where no ray met bone, beside the predicted ones (n,) [mm]."""
    met = np.where(measured.met, measured.depths, np.nan)
    top = float(np.nanquantile(met, 0.95))
    return draw_strip(
        [
            Panel("measured depth", skin_wrap, met, top),
            Panel("predicted depth", skin_wrap, predicted, top),
            Panel("measured, from behind", skin_wrap, met, top, view=BEHIND),
            Panel("predicted, from behind", skin_wrap, predicted, top, view=BEHIND),
        ],
    )
