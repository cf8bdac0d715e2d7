"""A file to write whose name has to say what it will be."""

from pathlib import Path

import click


class WrittenFile(click.Path):
    """A path that ends as what is written does, such as .npz; another ending is refused before any work is done."""

    def __init__(self, suffix: str):
        super().__init__(path_type=Path)
        self.suffix = suffix

    def convert(self, value, param, ctx):
        """The path; click's usage error for another ending."""
        path = Path(value)
        super().convert(path, param, ctx)
        if path.suffix != self.suffix:
            self.fail(f"{path}: expected a file that ends in {self.suffix}", param, ctx)
        return path


NPZ, PNG = WrittenFile(".npz"), WrittenFile(".png")
