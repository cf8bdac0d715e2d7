"""How long work tells a caller where it is."""

from collections.abc import Callable

OnProgress = Callable[[str, float], None]
"""Called with what is being done and the fraction done, 0 to 1."""


def silent(what: str, fraction: float) -> None:
    """Show nothing."""


def describe_duration(seconds: float) -> str:
    """Write a time: 54 s, 15 min or 1 h 48 min."""
    if seconds < 59.5:
        return f"{seconds:.0f} s"
    minutes = int(seconds / 60.0 + 0.5)
    return f"{minutes // 60} h {minutes % 60:02d} min" if minutes >= 60 else f"{minutes} min"


def describe_left(seconds: float, done: float) -> str:
    """Write the time left of work whose share `done` took so long, as ", 4 min left"; nothing in its first seconds."""
    return f", {describe_duration(seconds * (1.0 / done - 1.0))} left" if seconds > 5.0 and 0.0 < done < 1.0 else ""
