"""softdeca bench split: the parts of a frame's error, and that PD and FEniCSx agree beneath."""

import pytest

pytest.importorskip("dolfinx")

from softdeca.benchmarks.contest import collect_rows, summarise
from softdeca.benchmarks.harness import run
from softdeca.benchmarks.studies.agreement.solvers import FENICSX_FROM_PD
from softdeca.benchmarks.studies.surrogate.split import Split
from softdeca.surrogate import methods as m

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
    assert "Simulation moves the skin by" in results.words and "FEniCSx, P2" in results.words
    assert "Parts of the error" in (out / "index.html").read_text()
    lines = collect_rows(results.rows)
    found = {truth: summarise(lines, "method", truth) for truth in (m.PD, m.PD_AS_TRAINED)}
    network = found[m.PD_AS_TRAINED][m.NETWORK].everywhere
    assert found[m.PD][FENICSX_FROM_PD].farthest < 1e-4 < found[m.PD][m.CARRIED].everywhere
    assert found[m.PD][m.PD_AS_TRAINED].everywhere < 0.1 * network
    # No bone is scaled here, so nothing is carried and that rival leaves all that moves.
    assert found[m.PD][m.CARRIED].share == pytest.approx(1.0)
    assert {line["cells"] for line in lines if line["method"] != m.FENICSX_P2} == {"prisms"}
