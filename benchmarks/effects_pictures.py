"""Pictures of effects: neutral, the expression without and with it, and the difference as colours. PNG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..lhm.head import LayeredHead
from ..lhm.mesh import Floats
from ..lhm.progress import OnProgress
from .differences import distances
from .effect_run import EffectResult
from .pictures import VIEW, Panel, strip

FRONT = (0.0, 0.05, 1.0)
CLOSE = 560
"""Width [pixels] of each close picture."""
LEAST_TOP = 0.05
"""[mm]; the colours' end where an effect moves hardly anything."""


def effect_pictures(head: LayeredHead, done: Sequence[EffectResult], progress: OnProgress) -> Mapping[str, bytes]:
    """PNG by the effect's name: the head from the front; NAME-side, from three quarters; NAME-close, the face of it."""
    images, face = {}, head.skin_wrap.vertices[head.regions["face"]]
    for i, result in enumerate(done):
        name = result.record["name"]
        progress(f"pictures: {name}", i / len(done))
        panels = _panels(head, result)
        images[name] = strip(panels, view=FRONT)
        images[f"{name}-side"] = strip(panels, view=VIEW)
        images[f"{name}-close"] = strip([panels[k] for k in (0, 2, 3)], view=VIEW, size=CLOSE, framed=face)
    progress("pictures", 1.0)
    return images


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
