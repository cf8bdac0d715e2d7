"""Places to write: refused before any work is done where nothing can be written, or where its name says otherwise."""

from pathlib import Path

import click

from ..lhm.base.files.atomic import check_place


class WrittenPath(click.Path):
    """A file to write, whose name ends in one of `suffixes`, such as .npz, if there are any; or a folder to make."""

    def __init__(self, *suffixes: str, folder: bool = False):
        super().__init__(path_type=Path)
        self.suffixes, self.folder = suffixes, folder

    def convert(self, value, param, ctx):
        """Check the path's ending (click's usage error) and that a file can be written there (InputError)."""
        super().convert(value, param, ctx)
        path = Path(value)
        if self.suffixes and path.suffix not in self.suffixes:
            self.fail(f"{path}: expected a file that ends in {' or '.join(self.suffixes)}", param, ctx)
        check_place(path, folder=self.folder)
        return path


NPZ, CSV, ZIP, PNG, HTML, RIG, ANY, FOLDER = (
    WrittenPath(".npz"),
    WrittenPath(".csv"),
    WrittenPath(".zip"),
    WrittenPath(".png"),
    WrittenPath(".html"),
    WrittenPath(".glb", ".usd", ".usdc", ".usda"),
    WrittenPath(),
    WrittenPath(folder=True),
)
