"""Pictures of a case: skins beside each other, a head with and without an effect, and lips in contact cut open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ....animation.pictures import VIEW, Panel, draw_strip
from ....animation.plots import subplots, to_png
from ....lhm.base.mesh import Floats, Ints
from ....lhm.head.head import LayeredHead
from ....reference import Face
from ....reference.added import added_laws
from ....surrogate.methods import BLENDSHAPES, FENICSX_NEO_HOOKEAN, NETWORK, PD, SETTLED, solve_law
from ...contest import Made
from ..cases import Case
from ..measures import distances
from .solvers import WITHOUT

BESIDE_CAPTION = "blendshapes; simulated; and as colours [mm] on the simulated face, how far the others are from it"
FRONT = (0.0, 0.05, 1.0)
CLOSE = 560
"""Width [pixels] of each close picture."""
LEAST_TOP = 0.05
"""[mm]; the colours' end where an effect moves hardly anything."""
CUTS = (0.0, 10.0)
"""[mm] left of the middle, where lips are cut open."""
UPPER, LOWER = "#3b6fb5", "#d98324"
EDGE = 4.0
"""[mm] about the lips that a cut shows."""


Frames = Mapping[str, Made]
"""The frames of a case by the method that made them."""


def draw_case(face: Face, case: Case, frames: Frames) -> dict[str, bytes]:
    """Draw PNG by caption: the skins of a case beside each other, and where it is an effect, what the effect does."""
    pictures = {BESIDE_CAPTION: draw_beside(face, case, frames)}
    if WITHOUT in frames:
        pictures |= draw_effect(face, frames)
        if case.contact:
            before, after = frames[WITHOUT].positions, frames[PD].positions
            assert before is not None and after is not None
            pictures["the lips, cut"] = draw_lips(face.head, {"without contact": before, "with contact": after})
    return pictures


def draw_beside(face: Face, case: Case, frames: Frames) -> bytes:
    """Draw the blendshapes, PD's skin, and how far the law's and each method's are from PD's: PNG."""
    skin, pd = face.skin, frames[PD].skin
    laws = (FENICSX_NEO_HOOKEAN, *(solve_law(law).name for law in added_laws()))
    shown = [name for name in (*laws, BLENDSHAPES, SETTLED, NETWORK) if name in frames]
    errors = {name: distances(frames[name].skin, pd) for name in shown}
    simulated = skin.with_vertices(pd)
    panels = [Panel(BLENDSHAPES, skin.with_vertices(face.blend(case.weights))), Panel("simulated (PD)", simulated)]
    if errors:
        top = find_top(max(errors.values(), key=lambda error: float(error.mean())))
        panels += [
            Panel(f"{name} - {PD}, mean {error.mean():.2f} mm", simulated, error, top) for name, error in errors.items()
        ]
    return draw_strip([replace(panel, weights=case.weights) for panel in panels], rest=skin)


def draw_effect(face: Face, frames: Frames) -> dict[str, bytes]:
    """Draw the head with and without an effect, from the front and from three quarters, and the face of it."""
    head, before, after = face.head, frames[WITHOUT].skin, frames[PD].skin
    motion = distances(after, before)
    panels = [
        Panel("neutral", head.skin),
        Panel("neutral under the effect", head.skin.with_vertices(frames[PD].rig.settled.skin)),
        Panel("expression", head.skin.with_vertices(before)),
        Panel("expression under the effect", head.skin.with_vertices(after)),
        Panel("difference of both", head.skin.with_vertices(after), motion, find_top(motion)),
    ]
    near = head.skin_wrap.vertices[head.regions["face"]]
    return {
        "from the front": draw_strip(panels, view=FRONT),
        "from three quarters": draw_strip(panels, view=VIEW),
        "the face": draw_strip([panels[k] for k in (0, 2, 3)], view=VIEW, size=CLOSE, framed=near),
    }


def find_top(values: Floats) -> float:
    """Return where the colours of some distances [mm] end."""
    return max(LEAST_TOP, float(np.percentile(values, 99.5)))


def draw_lips(head: LayeredHead, answers: dict[str, Floats]) -> bytes:
    """Draw the upper and the lower lip cut open at CUTS; where both are, the flesh is darker.

    answers: positions [mm], shape (n, 3), by caption.
    """
    from matplotlib.collections import PolyCollection

    rest, n = head.skin_wrap.vertices, len(head.bone)
    lips = np.flatnonzero(head.regions["lips"])
    middle, between = rest[lips, 1].mean(), 0.5 * (rest[lips, 0].min() + rest[lips, 0].max())
    tets = head.tets[np.isin(head.tets % n, np.flatnonzero(head.regions["mouth"] | head.regions["lips"])).any(axis=1)]
    upper = rest[tets % n, 1].mean(axis=1) > middle
    figure, axes = subplots(len(CUTS), len(answers), figsize=(3.6 * len(answers), 3.4 * len(CUTS)), squeeze=False)
    for row, cut in enumerate(CUTS):
        shown = np.vstack([positions[lips] for positions in answers.values()])
        shown = shown[np.abs(shown[:, 0] - between - cut) < EDGE]
        for axis, (caption, positions) in zip(axes[row], answers.items(), strict=True):
            for mask, colour in ((upper, UPPER), (~upper, LOWER)):
                flesh = cut_tets(positions - [between + cut, 0.0, 0.0], tets[mask])
                axis.add_collection(
                    PolyCollection(flesh, facecolor=colour, alpha=0.55, linewidth=0.0, antialiased=False)
                )
            axis.set(xlim=(shown[:, 2].min() - EDGE, shown[:, 2].max() + EDGE), aspect="equal")
            axis.set(ylim=(shown[:, 1].min() - EDGE, shown[:, 1].max() + EDGE), xlabel="forward [mm]", ylabel="up [mm]")
            axis.set_title(f"{caption}, {'at the middle' if cut == 0.0 else f'{cut:g} mm to the left'}", fontsize=9)
    return to_png(figure)


def cut_tets(vertices: Floats, tets: Ints) -> list[Floats]:
    """Cut tets by the plane x = 0: polygons of (z, y) [mm], each (3, 2) or (4, 2)."""
    polygons = []
    beyond = vertices[tets, 0] > 0.0
    for corners in vertices[tets[beyond.any(axis=1) & ~beyond.all(axis=1)]]:
        left, right = corners[corners[:, 0] <= 0.0], corners[corners[:, 0] > 0.0]
        shares = -left[:, None, 0] / (right[None, :, 0] - left[:, None, 0])
        points = (left[:, None] + shares[:, :, None] * (right[None] - left[:, None])).reshape(-1, 3)[:, 2:0:-1]
        around = points - points.mean(axis=0)
        polygons.append(points[np.argsort(np.arctan2(around[:, 1], around[:, 0]))])
    return polygons
