"""softdeca bench split: the parts of a frame's error, with the check that PD and FEniCSx agree beneath them."""

import pytest

pytest.importorskip("dolfinx")

from softdeca.benchmarks.harness import run
from softdeca.benchmarks.studies.split import PARTS, Split
from softdeca.lhm import InputError


def test_the_parts_of_an_error_and_their_check(tmp_path):
    results = run(Split(level=1, expressions=("mouthPucker",), effects=("softer, 2 g",)), tmp_path)
    assert results.passed and "Simulation moves the skin by" in results.words
    assert "<svg" in (tmp_path / "index.html").read_text()
    values = results.rows[0].values
    assert values["fenicsx"] < 1e-4 < values["moved"]
    parts = [values[key] for key in list(PARTS)[:3]]
    # A triangle's sides: the whole is at most its parts, and no part more than the others and the whole.
    assert values["total"] <= sum(parts) + 1e-6 and parts[0] <= parts[1] + parts[2] + values["total"] + 1e-6
    assert values["tolerance"] < 0.1 * values["network"]


def test_an_unknown_effect_is_named():
    with pytest.raises(InputError, match="effect 'zombie': there are defaults"):
        Split(effects=("zombie",)).tasks()
