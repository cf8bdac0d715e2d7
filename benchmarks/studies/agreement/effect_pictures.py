"""Pictures of an effect: head and face with and without it, beside the network, and lips in contact cut open."""

from __future__ import annotations

import numpy as np

from ....animation.pictures import VIEW, Panel, draw_strip
from ....animation.plots import subplots, to_png
from ....lhm.base.mesh import Floats, Ints
from ....lhm.head.head import LayeredHead
from ....reference import terms
from ....surrogate.methods import BLENDSHAPES, NETWORK
from ..measures import distances
from .effect import EffectResult

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


def draw_effect(head: LayeredHead, result: EffectResult, shape: Floats, network: Floats | None) -> dict[str, bytes]:
    """Draw PNG by caption: the head from the front and from three quarters, the face of it, and the face by a network.

    The last, where there is a network's skin: blendshapes, simulated, network, and how far both are from the simulated.
    """

    def panel(caption: str, skin: Floats, values: Floats | None = None, top: float = 1.0) -> Panel:
        return Panel(caption, head.skin.with_vertices(skin), values, top)

    def find_top(values: Floats) -> float:
        return max(LEAST_TOP, float(np.percentile(values, 99.5)))

    face, simulated = head.skin_wrap.vertices[head.regions["face"]], result.with_it
    moved = distances(simulated, result.without)
    panels = [
        panel("neutral", head.skin.vertices),
        panel("neutral under the effect", result.neutral),
        panel("expression", result.without),
        panel("expression under the effect", simulated),
        panel("difference of both", simulated, moved, find_top(moved)),
    ]
    images = {
        "from the front": draw_strip(panels, view=FRONT),
        "from three quarters": draw_strip(panels, view=VIEW),
        "the face": draw_strip([panels[k] for k in (0, 2, 3)], view=VIEW, size=CLOSE, framed=face),
    }
    if network is not None:
        off = [distances(skin, simulated) for skin in (shape, network)]
        top = find_top(off[0])
        beside = [
            panel(BLENDSHAPES, shape),
            panel("simulated (PD)", simulated),
            panel(NETWORK, network),
            panel(f"{BLENDSHAPES} - PD, mean {off[0].mean():.2f} mm", simulated, off[0], top),
            panel(f"{NETWORK} - PD, mean {off[1].mean():.2f} mm", simulated, off[1], top),
        ]
        images["beside the surrogate"] = draw_strip(beside, view=VIEW, framed=face)
    if result.scene.of(terms.Contact):
        images["the lips, cut"] = draw_lips(
            head, {"without contact": result.plain.positions, "with contact": result.solution.positions}
        )
    return images


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
