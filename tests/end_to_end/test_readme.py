"""The README's Python examples run as they stand."""

import re
from pathlib import Path

import meshio
import numpy as np
import pytest

from softdeca.reference import Parameters, facial_scene, solve
from softdeca.reference.problems import meshes

README = Path(__file__).resolve().parents[2] / "README.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", README.read_text(), flags=re.DOTALL)


def example(words: str) -> str:
    """The one Python block of the README with these words."""
    (found,) = [block for block in EXAMPLES if words in block]
    return found


def test_a_face_by_three_solvers(tmp_path, monkeypatch):
    pytest.importorskip("dolfinx")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(example("neo_hookean_scene(scene)"), names)
    assert names["fast"].converged and names["exact"].converged and names["real"].converged
    moved = np.abs(names["exact"].positions - names["scene"].vertices).max()
    # At the default tolerance of 1e-6 projective dynamics ends within a thousandth of the displacement.
    assert np.abs(names["fast"].positions - names["exact"].positions).max() < 1e-3 * moved
    exec(example("heavier = settled"), names)
    assert names["heavier"].solution.converged and names["answer"].converged
    # The README's picture: 40 % more soft tissue shows, as it does not by targets alone.
    head = names["head"]
    assert 2.0 < np.linalg.norm(names["neutral"] - head.skin.vertices, axis=1).max() < 10.0
    leaner = solve(facial_scene(head, Parameters(), names["targets"])).positions[: len(head.skin_wrap.vertices)]
    assert np.linalg.norm(names["grown"] - head.skin_after(names["targets"], leaner), axis=1).max() > 2.0


def test_a_mesh_of_ones_own(tmp_path, monkeypatch):
    pytest.importorskip("dolfinx")
    monkeypatch.chdir(tmp_path)
    vertices, tets = meshes.block(3)
    meshio.Mesh(20.0 * vertices, [("tetra", tets)]).write("part.vtu")
    names: dict = {}
    exec(example("part.vtu"), names)
    assert names["solution"].converged
    # It hangs under its own weight: the top sinks.
    sunk = (names["solution"].positions - names["mesh"].points)[:, 2].min()
    assert sunk < 0
