"""softdeca bench: one study by name."""

from pathlib import Path

import click

from .study_command import Studies, changes, listed, report

AFile = click.Path(path_type=Path)


def _add(context: click.Context, parameter: click.Parameter, files: tuple[Path, ...]) -> None:
    from ..reference.added import add_file

    for path in files:
        add_file(path)


@click.group(cls=Studies, no_args_is_help=False)
@click.option(
    "--add",
    type=AFile,
    multiple=True,
    callback=_add,
    is_eager=True,
    expose_value=False,
    help="a Python file of laws, solvers or studies of your own; repeat for several",
)
def bench() -> None:
    """Single studies by name."""


bench.add_command(listed)
bench.add_command(changes)
bench.add_command(report)
