"""The largest counts and sizes that are accepted from files and arguments: one name, one number and one reason each.

`docs/bounds.md` is made of this table. A bound lies far above every real use and below what exhausts a small machine.
"""

from __future__ import annotations

import numbers
from dataclasses import dataclass
from typing import Any

from .errors import InputError


@dataclass(frozen=True)
class Bound:
    """A count of `what` lies within least..most, for `reason`."""

    what: str
    most: int
    reason: str
    least: int = 0

    def check(self, name: str, count: Any) -> int:
        """Return a count as int; InputError names it for another kind of value, or one outside the bound."""
        good = isinstance(count, numbers.Integral) and not isinstance(count, bool)
        if not good or not self.least <= int(count) <= self.most:
            allowed = f"{self.least:,} to {self.most:,}" if self.least else f"at most {self.most:,}"
            raise InputError(f"{name}: {shown(count)} {self.what}; expected {allowed}")
        return int(count)


def shown(value: Any, longest: int = 40) -> str:
    """Quote a value in an error: one line of printable characters, at most `longest` of them and three dots."""
    if isinstance(value, numbers.Integral) and not isinstance(value, bool):
        # Python refuses to print an integer of more than 4,300 digits.
        return f"{int(value):,}" if abs(int(value)) < 10**18 else "more than 10^18" if value > 0 else "less than -10^18"
    text = plain(value if isinstance(value, str) else repr(value))
    return text if len(text) <= longest else text[:longest] + "..."


def plain(text: str) -> str:
    """Escape what is no printable character, so that a text from a file cannot steer the terminal."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


FILE_BYTES = Bound(
    "bytes", 2_000_000_000, "the largest scans have 1 GB; a reader needs some five times the file's size"
)
UNPACKED_BYTES = Bound("bytes unpacked", 2_000_000_000, "a template of level 3 unpacks to 0.2 GB; more is a zip bomb")
JSON_BYTES = Bound("bytes of JSON", 200_000_000, "an hour's take at 60 Hz has 100 MB; Python needs ten times its size")
JSON_DEPTH = Bound("levels of brackets", 64, "no format that is read nests more than ten levels")
JSON_DIGITS = Bound("digits in an integer", 18, "18 digits fit 64 bits; no index, count or time needs more")
