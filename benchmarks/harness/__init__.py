"""How every study is run: a study is data, one runner makes its rows, and one page shows them."""

from .results import Change, Comparison, compared
from .runner import Asked, run, run_together
from .study import Column, Results, Row, Study, Table, Task, Values

__all__ = [
    "Asked", "Change", "Column", "Comparison", "Results", "Row", "Study", "Table", "Task", "Values", "compared", "run",
    "run_together",
]  # fmt: skip
