"""How every study is run: a study is data, one runner makes its rows, and one page shows them."""

from ...lhm.base.option import option
from .results import Change, Comparison, compare_results
from .runner import RunRequest, run, run_together
from .study import Column, Results, Row, Study, Table, Task, Values

__all__ = [
    "Change", "Column", "Comparison", "Results", "Row", "RunRequest", "Study", "Table", "Task", "Values",
    "compare_results", "option", "run", "run_together",
]  # fmt: skip
