"""Statements with a measured value and a bound, each {what, value, bound, passed, answer}.

`answer` says that a miss is a wrong answer; the others are figures of speed, which a busy machine changes.
"""

from __future__ import annotations


def at_most(what: str, value: float | None, bound: float, *, answer: bool = True) -> dict:
    """One statement; None, what was not measured, does not pass."""
    return _gate(what, value, f"at most {bound:g}", value is not None and value <= bound, answer)


def at_least(what: str, value: float | None, bound: float, *, answer: bool = True) -> dict:
    """The same from below."""
    return _gate(what, value, f"at least {bound:g}", value is not None and value >= bound, answer)


def above(what: str, value: float, bound: float) -> dict:
    """The same from below, the bound left out."""
    return _gate(what, value, f"above {bound:g}", value > bound, True)


def _gate(what: str, value: float | None, bound: str, passed: bool, answer: bool) -> dict:
    return {"what": what, "value": value, "bound": bound, "passed": bool(passed), "answer": answer}
