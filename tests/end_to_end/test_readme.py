"""The README's Python examples run as they stand."""

import re
from pathlib import Path

import meshio
import numpy as np
import pytest

from softdeca.reference.problems import meshes

README = Path(__file__).resolve().parents[2] / "README.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)


def test_a_face_by_three_solvers(tmp_path, monkeypatch):
    pytest.importorskip("dolfinx")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(EXAMPLES[0], names)
    assert names["fast"].converged and names["exact"].converged and names["real"].converged
    moved = np.abs(names["exact"].positions - names["scene"].vertices).max()
    # At the default tolerance of 1e-6 projective dynamics ends within a thousandth of the displacement.
    assert np.abs(names["fast"].positions - names["exact"].positions).max() < 1e-3 * moved


def test_a_mesh_of_ones_own(tmp_path, monkeypatch):
    pytest.importorskip("dolfinx")
    monkeypatch.chdir(tmp_path)
    vertices, tets = meshes.block(3)
    meshio.Mesh(20.0 * vertices, [("tetra", tets)]).write("part.vtu")
    names: dict = {}
    exec(EXAMPLES[1], names)
    assert names["solution"].converged
    # It hangs under its own weight: the top sinks.
    sunk = (names["solution"].positions - names["mesh"].points)[:, 2].min()
    assert sunk < 0
