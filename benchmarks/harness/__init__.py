"""How every study is run: a study is data, one runner makes its rows, and one page shows them."""

from .compare import Change, compared
from .runner import Results, Row, run
from .study import Column, Study, Table, Task, Values

__all__ = ["Change", "Column", "Results", "Row", "Study", "Table", "Task", "Values", "compared", "run"]
