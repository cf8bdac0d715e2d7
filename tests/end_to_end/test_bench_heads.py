"""The study of random identities: repeated, and with failures in its list."""

import numpy as np
import pytest

from softdeca.benchmarks.harness import run
from softdeca.benchmarks.studies.heads import fit as study
from softdeca.benchmarks.studies.heads.fit import Heads, sample, try_fit
from softdeca.lhm import FitError, check_head, fit_head, identities, load_template

pytestmark = pytest.mark.usefixtures("measured_here")


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """Two heads, of which one is drawn: the folder and its results."""
    out = tmp_path_factory.mktemp("heads")
    return out, run(Heads(count=2, gallery=1, level=1), out, workers=1)


def test_each_head_is_that_of_its_seed(two):
    _, results = two
    space = identities.Anny()
    _, skin = space.sample(np.random.default_rng(1))
    report = check_head(fit_head(load_template(space, level=1), skin))
    assert results.passed and results.rows[1].case == "seed 1"
    assert results.rows[1].values["figures"]["smallest_dihedral"] == report.smallest_dihedral
    found = {figure.name: [value for value, _ in values] for figure, values in study.collect_figures(results.rows[:2])}
    assert report.lip_path in found["lip_path"] and len(set(found["lip_path"])) == 2 and min(found["fit_s"]) > 0


def test_the_gallery_shows_a_head_as_it_moves(two):
    out, results = two
    assert results.rows[2].case == "seed 0"
    text = (out / "index.html").read_text()
    assert text.count('<div class="panels">') == 2 and text.count("src=") == text.count('src="data:')
    assert "<svg" in text and "at least 2 °" in text and "missed by" in text


def test_scaled_samples_reach_further():
    space = identities.Anny()
    mean = space.mean.vertices
    default, far = (sample(space, 0, sigma).vertices - mean for sigma in (2.5, 4.0))
    np.testing.assert_allclose(far, 1.6 * default, atol=1e-9)


def test_what_cannot_be_fitted_has_a_reason(monkeypatch):
    def flat(template, skin):
        raise FitError("layers: 3 tets are flat")

    monkeypatch.setattr(study, "fit_head", flat)
    assert try_fit(None, None)["error"] == "layers: 3 tets are flat"
    monkeypatch.setattr(study, "fit_head", lambda template, skin: 1 / 0)
    assert try_fit(None, None)["error"] == "ZeroDivisionError: division by zero"
