"""softdeca bench split: the parts of a frame's error, and that PD and FEniCSx agree beneath."""

import pytest

pytest.importorskip("dolfinx")

from softdeca.benchmarks.harness import run
from softdeca.benchmarks.studies.surrogate.split import Split

pytestmark = pytest.mark.usefixtures("measured_here")

EFFECT, TEXT = "softer, 2 g", "mouthPucker"


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The coarsest head, which is the study's own level and the coarse one at once."""
    out = tmp_path_factory.mktemp("split")
    return run(Split(level=1, expressions=(TEXT,), effects=(EFFECT,), refined=(EFFECT,)), out, workers=1), out


def test_the_parts_of_an_error_and_their_check(measured):
    results, out = measured
    assert [(row.case, row.reason) for row in results.rows if row.status == "failed"] == []
    assert "Simulation moves the skin by" in results.words
    text = (out / "index.html").read_text()
    assert "<svg" in text and "measured" in text
    values = results.rows[0].values
    assert values["fenicsx"] < 1e-4 < values["moved"]
    assert values["tolerance"] < 0.1 * values["network"]
    # No bone is scaled here, so nothing is carried and that rival leaves all that moves.
    assert values["share_carried"] == pytest.approx(1.0)
