"""Shared inputs: a layered sphere that stands for a head, and the folder of real data where it is present."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import signal
import sys
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.sparse import identity

from softdeca.lhm import LayeredHead, Surface, fit_head, identities, load_template

# Under nohup, and in a background job, SIGINT is ignored, and so it would be in the commands that tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

DATA = Path(os.environ.get("SOFTDECA_DATA") or Path(__file__).resolve().parents[2] / "shared" / "data")
"""Real heads and takes, which docs/architecture.md names."""


MAY_SKIP = (
    "no real data",
    "no Visible Male",
    "no bones and muscles",
    "another user",
    "docs/arena.md",
    "no npm",
    "no datasets",
)
"""Words of skips for what set-up does not install."""


def _fail_if_skipped(report):
    """Make a failure of a report of a skip, where $SOFTDECA_SKIPS_FAIL is set and set-up installs what was missing."""
    why = str(report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr)
    wanted = os.environ.get("SOFTDECA_SKIPS_FAIL") and not hasattr(report, "wasxfail")
    if report.skipped and wanted and not any(words in why for words in MAY_SKIP):
        report.outcome, report.longrepr = "failed", f"{why}; set-up installs what this needs"
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    return _fail_if_skipped((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report():
    return _fail_if_skipped((yield))


@pytest.fixture(scope="session")
def data():
    """The folder of real heads; a test that needs it skips, by name, where it is missing."""
    if not DATA.is_dir():
        pytest.skip(f"no real data at {DATA}: $SOFTDECA_DATA, or docs/architecture.md")
    return DATA


def layered_sphere(subdivisions: int = 2, radii=(100.0, 92.0, 85.0)) -> LayeredHead:
    """Three concentric spheres [mm]: the upper half of the innermost is cranium, its lowest tenth mandible."""
    sphere = trimesh.creation.icosphere(subdivisions)
    unit, faces = np.asarray(sphere.vertices), np.asarray(sphere.faces)
    wraps = [Surface(radius * unit, faces) for radius in radii]
    bone = np.where(unit[:, 1] > 0.0, 1, np.where(unit[:, 1] < -0.8, 2, 0))
    weights = identity(len(unit), format="csr")
    return LayeredHead(wraps[0], *wraps, bone, weights, weights)


def with_regions(head):
    """A sphere with a mouth before and below its middle, and eyes above it."""
    x = head.skin_wrap.vertices
    front = x[:, 2] > 0
    regions = {"face": front & (x[:, 1] > -80), "neck": x[:, 1] <= -80}
    regions["lips"] = front & (np.abs(x[:, 0]) < 30) & (np.abs(x[:, 1] + 40) < 12)
    eyes = front & (np.abs(np.abs(x[:, 0]) - 35) < 10) & (np.abs(x[:, 1] - 30) < 8)
    return replace(head, regions=regions | dict.fromkeys(("lids", "mouth", "eyes", "teeth", "ears"), eyes))


@pytest.fixture(scope="session")
def sphere_head():
    return layered_sphere()


@pytest.fixture(scope="session")
def spheres():
    """`layered_sphere`, for heads of more vertices."""
    return layered_sphere


@pytest.fixture(scope="session")
def template():
    """The default template of level 1; one object, so that what fitting prepares from it is made once."""
    return load_template(level=1)


@pytest.fixture(scope="session")
def anny():
    """The space of identities of the default head."""
    return identities.Anny()


@pytest.fixture(scope="session")
def mean_head(anny, template):
    """The mean identity's head of level 1, 1,212 vertices a wrap."""
    return fit_head(template, anny.skin(np.zeros(anny.code_size)))


def measure_here(monkeypatch):
    """Let studies measure in this process, which has loaded what they need; test_harness has them in their own."""
    from softdeca.benchmarks.harness import processes, runner

    monkeypatch.setattr(runner, "measure_jobs", lambda jobs, lanes: map(processes._measure, jobs))


@pytest.fixture(scope="module")
def measured_here():
    """`measure_here` for the tests of a module."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        measure_here(monkeypatch)
        yield


@pytest.fixture(scope="session")
def verified(tmp_path_factory):
    """The folder of a small study that was run: two layers in series, by scikit-fem."""
    from softdeca.benchmarks.harness import run
    from softdeca.benchmarks.studies.verification import Verification

    out = tmp_path_factory.mktemp("verification")
    with pytest.MonkeyPatch.context() as monkeypatch:
        measure_here(monkeypatch)
        run(Verification(solvers=("skfem",)), out, match="two layers")
    return out


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit status, and the lines of its two streams."""

    status: int
    out: str
    errors: list[str]

    def refusal(self) -> str:
        """The one line of a command that was refused."""
        assert self.status in (1, 2) and len(self.errors) == 1, self
        assert self.errors[0].startswith("softdeca: error: ") and "Traceback" not in self.errors[0]
        return self.errors[0]


@pytest.fixture
def command(monkeypatch, capsys):
    """Run `softdeca ARGUMENTS` in this process; progress on stderr is left out of `errors`."""
    from softdeca.cli import main

    def run(*arguments) -> Ended:
        monkeypatch.setattr(sys, "argv", ["softdeca", *map(str, arguments)])
        capsys.readouterr()
        # A process of its own would leave these out, and main's way of showing warnings ends with it.
        with warnings.catch_warnings(), pytest.raises(SystemExit) as ended:
            warnings.simplefilter("ignore", DeprecationWarning)
            main()
        out, err = capsys.readouterr()
        return Ended(ended.value.code, out, [line for line in err.splitlines() if not line.endswith(" s)")])

    return run
