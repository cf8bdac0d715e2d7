"""Places to write: refused before any work is done where nothing can be written, or where its name says otherwise."""

from pathlib import Path

import click

from ..lhm.base.files.atomic import check_place


class WrittenFile(click.Path):
    """A file to write; its name ends in one of `suffixes`, such as .npz, if there are any."""

    def __init__(self, *suffixes: str):
        super().__init__(path_type=Path)
        self.suffixes = suffixes

    def convert(self, value, param, ctx):
        """Give the path; click's usage error for another ending, InputError where no file can be."""
        super().convert(value, param, ctx)
        path = Path(value)
        if self.suffixes and path.suffix not in self.suffixes:
            self.fail(f"{path}: expected a file that ends in {' or '.join(self.suffixes)}", param, ctx)
        check_place(path, folder=False)
        return path


class WrittenFolder(click.Path):
    """A folder to write into, made where it is missing."""

    def __init__(self):
        super().__init__(path_type=Path)

    def convert(self, value, param, ctx):
        """Give the path; InputError where no folder can be."""
        super().convert(value, param, ctx)
        path = Path(value)
        check_place(path, folder=True)
        return path


NPZ, CSV, ZIP, PNG, HTML, RIG, ANY, FOLDER = (
    WrittenFile(".npz"),
    WrittenFile(".csv"),
    WrittenFile(".zip"),
    WrittenFile(".png"),
    WrittenFile(".html"),
    WrittenFile(".glb", ".usd", ".usdc", ".usda"),
    WrittenFile(),
    WrittenFolder(),
)
