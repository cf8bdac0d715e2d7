"""Takes by name: recorded, made up or spoken, and a part of one."""

from __future__ import annotations

import numpy as np

from ..lhm.base.errors import InputError
from ..lhm.expressions import Take, conversation_take, read_take, speech

MADE_UP, SPOKEN = "conversation", "speech"
SECONDS, RATE = 10.0, 60.0


def take_from_text(text: str) -> Take:
    """A file by `read_take`, or one made up: "conversation[:SECONDS[:SEED]]" (10 s and seed 0) or "speech:TEXT"."""
    name, colon, rest = text.partition(":")
    if name == SPOKEN and colon:
        return speech(rest)
    return _conversation(text, rest.split(":") if colon else []) if name == MADE_UP else read_take(text)


def _conversation(text: str, rest: list[str]) -> Take:
    try:
        seconds = float(rest[0]) if rest else SECONDS
        seed = int(rest[1]) if len(rest) > 1 else 0
        if len(rest) > 2 or not 0.0 < seconds < 36000.0 or seed < 0:
            raise ValueError
    except ValueError:
        raise InputError(f"take {text!r}: expected {MADE_UP}[:SECONDS[:SEED]]") from None
    count = max(1, round(seconds * RATE))
    return conversation_take(np.random.default_rng(seed), count, rate=RATE)


def cut_take(take: Take, text: str) -> Take:
    """The frames A:B of a take, B left out, either left out for the take's end; InputError if there are none."""
    try:
        first, last = (int(part) if part.strip() else None for part in text.split(":"))
    except ValueError:
        raise InputError(f"frames {text!r}: expected A:B") from None
    chosen = slice(first, last)
    if not len(take.times[chosen]):
        raise InputError(f"frames {text!r}: none of the take's {len(take.times)}")
    return take.part(chosen)
