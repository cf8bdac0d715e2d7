"""How every study is run: a study is data, one runner makes its rows, and one page shows them."""

from .compare import Change, compared
from .runner import Asked, Results, Row, run, run_together
from .study import Column, Study, Table, Task, Values

__all__ = [
    "Asked", "Change", "Column", "Results", "Row", "Study", "Table", "Task", "Values", "compared", "run",
    "run_together",
]  # fmt: skip
