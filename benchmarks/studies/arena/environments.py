"""Make the environments of solvers whose packages clash with softdeca's: python -m ... [NAME...]; see docs/arena.md."""

from __future__ import annotations

import subprocess
import sys
import venv
from collections.abc import Sequence

from .entrants import load_file
from .runs import environments

SHARED = ("jax_fem_newton",)
"""Solvers that need what the system brings FEniCSx with, petsc4py and basix, but their own versions of the rest."""
APART = ("torch_fem", "sfepy_newton", *SHARED)
"""Solvers whose packages need others than softdeca does, such as a newer pyvista."""


def make_environments(names: Sequence[str] = APART) -> None:
    """Make an environment for each solver's file, with the versions that it names."""
    for name in names:
        folder = environments() / name
        print(f"{folder}: {' '.join(load_file(name).PACKAGES)}", flush=True)
        venv.create(folder, with_pip=True, clear=True, system_site_packages=name in SHARED)
        subprocess.run([folder / "bin" / "python", "-m", "pip", "install", "-q", *load_file(name).PACKAGES], check=True)


if __name__ == "__main__":
    make_environments(sys.argv[1:] or APART)
