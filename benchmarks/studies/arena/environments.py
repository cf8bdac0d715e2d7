"""Make the environments of solvers whose packages clash with softdeca's: python -m ... [NAME...]; see docs/arena.md."""

from __future__ import annotations

import subprocess
import sys
import venv
from collections.abc import Sequence

from .contest import environments
from .study import load_file

APART = ("torch_fem", "sfepy_newton")
"""Solvers whose packages need others than softdeca does: a newer pyvista, and another HDF5 beside dolfinx."""


def make_environments(names: Sequence[str] = APART) -> None:
    """Make an environment for each solver's file, with the versions that it names."""
    for name in names:
        folder = environments() / name
        print(f"{folder}: {' '.join(load_file(name).PACKAGES)}", flush=True)
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run([folder / "bin" / "python", "-m", "pip", "install", "-q", *load_file(name).PACKAGES], check=True)


if __name__ == "__main__":
    make_environments(sys.argv[1:] or APART)
