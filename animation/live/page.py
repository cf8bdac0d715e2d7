"""The live page: a head, its sliders, and the script that asks the server for frames."""

from __future__ import annotations

import numpy as np

from ...reference import Face
from ...surrogate import Surrogate
from ..page import POSES, Packed, fill_page, pack_skin
from .controls import PRESETS, describe_controls
from .face import list_methods


def render_live_page(title: str, face: Face, network: Surrogate, socket: str, detail: bool = False) -> str:
    """Render the page of a face whose websocket is at the path `socket`; InputError for p that no slider shows.

    network: of the first answers. With `detail` it draws the head's fine skin.
    """
    packed = Packed()
    content = pack_skin(packed, face.head.skin, face.head.fine_skin if detail else None) | {
        "neutral": packed.add("neutral", face.head.skin.vertices.astype(np.float32)),
        "socket": socket,
        "controls": describe_controls(face.parameters),
        "effects": PRESETS,
        "poses": POSES,
        "methods": list_methods(face, network),
    }
    return fill_page("live.html", packed, content, app="live.js", title=title)
