"""ARKit's names as programs and phone apps write them: eyeBlink_L, blendShape1.jawOpen, MouthSmileLeft."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from ..arkit import ARKIT
from ..base.mesh import Floats

_SIDES = {"_l": "left", "_r": "right", ".l": "left", ".r": "right", "-l": "left", "-r": "right"}
_KNOWN = {name.lower(): name for name in ARKIT}
_HALVED = {name.lower() for name in ("browInnerUp", "cheekPuff")}


def arkit_name(name: str) -> str | None:
    """The ARKit expression that a morph target's name stands for, or None.

    Letters' case, underscores, what stands before a dot or colon, and _L, _R for Left, Right make no difference. The
    halves of browInnerUp and cheekPuff, which some rigs have, stand for the whole.
    """
    for text in (name, re.split(r"[.:|]", name)[-1] if not re.search(r"[.][lrLR]$", name) else name):
        text = text.strip().lower()
        if text[-2:] in _SIDES:
            text = text[:-2] + _SIDES[text[-2:]]
        text = re.sub(r"[\s_.-]", "", text)
        if text in _KNOWN:
            return _KNOWN[text]
        for side in ("left", "right"):
            if text.removesuffix(side) in _HALVED:
                return _KNOWN[text.removesuffix(side)]
    return None


def arkit_named(morphs: Mapping[str, Floats]) -> dict[str, Floats]:
    """Morph targets (n, 3) by ARKit's names, halves added; those of other names, or that are zero, are left out."""
    found: dict[str, Floats] = {}
    for name, delta in morphs.items():
        known = arkit_name(name)
        if known is not None and np.any(delta):
            found[known] = found[known] + delta if known in found else delta
    return found
