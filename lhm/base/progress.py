"""How long work tells a caller where it is."""

from collections.abc import Callable

OnProgress = Callable[[str, float], None]
"""Called with what is being done and the fraction done, 0 to 1."""


def silent(what: str, fraction: float) -> None:
    """Show nothing."""
