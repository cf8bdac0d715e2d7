"""The race with FastCorotatedFEM: its rotations' ruler, and what is said without its sources."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.benchmarks.studies.scaling import corotated
from softdeca.lhm.base.errors import MissingDependencyError, SoftdecaError

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]])
TETS = np.array([[0, 1, 2, 3]])


@pytest.mark.parametrize("stretch", [(1.0, 1.0, 1.0), (1.4, 0.7, 1.0), (1.2, 0.9, -0.3)])
def test_rotations_of_turned_and_stretched_tets_are_found(stretch):
    """A symmetric stretch leaves the rotation; an inverted tet has that of its flipped shortest axis."""
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8])
    moved = turn.apply(CORNERS * stretch)
    (found,) = corotated._rotations(CORNERS, moved, TETS)
    assert (found * turn.inv()).magnitude() < 1e-12


def test_without_sources_theirs_is_skipped(tmp_path):
    for folder in (None, tmp_path):
        with pytest.raises(MissingDependencyError, match="--sources names no folder with FastCorotFEM.cpp"):
            corotated.time_theirs(SimpleNamespace(), CORNERS, folder)


def test_a_program_that_fails_says_why(tmp_path):
    with pytest.raises(SoftdecaError, match=r"sh: error: no such thing"):
        corotated._run(["sh", "-c", "echo note >&2; echo error: no such thing >&2; exit 1"])


def test_words_need_both_codes():
    parts = (corotated.STRETCH, corotated.BOTH, corotated.WHOLE)

    def row(code, nanoseconds):
        lines = [{"code": code, "what": what, "ns": nanoseconds} for what in parts]
        return SimpleNamespace(method=code, values={"rows": lines, "off_degrees": (3.0, 0.5)})

    ours, theirs = row(corotated.OURS, 20.0), row(corotated.THEIRS, 10.0)
    words = corotated.OperatorSplitting().words([ours, theirs])
    assert "take 10 ns a tet in FastCorotatedFEM (float32) and 20 ns here" in words and "3 degrees" in words
    assert corotated.OperatorSplitting().words([ours]) == ""
