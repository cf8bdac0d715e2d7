"""Pictures of effects: neutral, the expression without and with it, and the difference as colours. PNG."""

from __future__ import annotations

import numpy as np

from ....animation.pictures import VIEW, Panel, draw_strip
from ....lhm.base.mesh import Floats
from ....lhm.head import LayeredHead
from ..measures import distances
from .effect_cases import EffectResult

FRONT = (0.0, 0.05, 1.0)
CLOSE = 560
"""Width [pixels] of each close picture."""
LEAST_TOP = 0.05
"""[mm]; the colours' end where an effect moves hardly anything."""


def effect_pictures(head: LayeredHead, result: EffectResult, shape: Floats, network: Floats | None) -> dict[str, bytes]:
    """PNG by caption: the head from the front and from three quarters, the face of it, and the face by a network.

    The last, where there is a network's skin: blendshapes, simulated, network, and how far both are from the simulated.
    """
    face, panels = head.skin_wrap.vertices[head.regions["face"]], _panels(head, result)
    images = {
        "from the front": draw_strip(panels, view=FRONT),
        "from three quarters": draw_strip(panels, view=VIEW),
        "the face": draw_strip([panels[k] for k in (0, 2, 3)], view=VIEW, size=CLOSE, framed=face),
    }
    if network is not None:
        images["beside the surrogate"] = draw_strip(_beside(head, result, shape, network), view=VIEW, framed=face)
    return images


def _beside(head: LayeredHead, result: EffectResult, shape: Floats, network: Floats) -> list[Panel]:
    """Blendshapes and network beside the simulated skin, with distances to it in the same colours."""
    simulated = head.skin.with_vertices(result.with_it)
    off = [distances(skin, result.with_it) for skin in (shape, network)]
    top = max(LEAST_TOP, float(np.percentile(off[0], 99.5)))
    return [
        Panel("blendshapes", head.skin.with_vertices(shape)),
        Panel("simulated (PD)", simulated),
        Panel("surrogate", head.skin.with_vertices(network)),
        Panel(f"blendshapes - PD, mean {off[0].mean():.2f} mm", simulated, off[0], top),
        Panel(f"surrogate - PD, mean {off[1].mean():.2f} mm", simulated, off[1], top),
    ]


def _panels(head: LayeredHead, result: EffectResult) -> list[Panel]:
    def panel(caption: str, skin: Floats, values: Floats | None = None, top: float = 1.0) -> Panel:
        return Panel(caption, head.skin.with_vertices(skin), values, top)

    moved = distances(result.with_it, result.without)
    top = max(LEAST_TOP, float(np.percentile(moved, 99.5)))
    return [
        panel("neutral", head.skin.vertices),
        panel("neutral under the effect", result.neutral),
        panel("expression", result.without),
        panel("expression under the effect", result.with_it),
        panel("difference of both", result.with_it, moved, top),
    ]
