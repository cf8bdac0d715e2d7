"""softdeca head train-regressor: from a folder of pairs, or the prior, to a file, a report and a picture."""

import json

import numpy as np
import pytest

from softdeca.lhm import identities, load_template
from softdeca.lhm.template.depths.depths import DepthRegressor

from ..unit.test_regressor import connectors, head, write


@pytest.fixture(scope="module")
def space():
    return identities.Anny()


@pytest.fixture
def folder(tmp_path, space):
    """Four heads, their skulls the template's connectors under the skin times a factor of the head."""
    out = tmp_path / "pairs"
    out.mkdir()
    for seed in range(4):
        write(out, f"p{seed}", *head(load_template(space), space, seed, 0.8 + 0.1 * seed))
    return out


def test_pairs_become_a_regressor_and_a_report(command, folder, tmp_path, space):
    file = tmp_path / "d.npz"
    ended = command("head", "train-regressor", folder, "--out", file, "--json")
    assert ended.status == 0 and ended.errors == []
    report = json.loads(ended.out)
    assert report["pairs"] == 4 and report["trained_on"] == f"4 pairs from {folder}"
    assert set(report["per_pair_mm"]) == set(report["rays_missed"]) == {"p0", "p1", "p2", "p3"}
    assert 0 < report["leave_one_out_mm"] < 5 and 0 < report["predicting_the_mean_mm"] < 5
    assert report["leave_one_out_mm"] == pytest.approx(np.mean(list(report["per_pair_mm"].values())))
    assert [row["mean_mm"] for row in report["published"]] == [3.83, 1.98]

    template = load_template(space)
    depths = DepthRegressor.load(file, template.skin_wrap).predict(template.skin_wrap.vertices)
    scalp = template.regions["face"] & (template.skin_wrap.vertices[:, 1] > 50)
    known = np.linalg.norm(connectors(template), axis=1)
    # The heads' factors go from .8 to 1.1.
    assert 0.75 < np.median(depths[scalp] / known[scalp]) < 1.15


def test_the_prior_is_named_as_such_beside_the_published_errors(command, tmp_path):
    ended = command("head", "train-regressor", "--prior", 8, "--out", tmp_path / "d.npz")
    assert ended.status == 0 and ended.errors == []
    assert "synthetic prior" in ended.out and "not anatomy" in ended.out
    assert "3.83 mm" in ended.out and "1.98 mm" in ended.out and "SKULLS" in ended.out
    assert (tmp_path / "d.npz").is_file()


def test_a_pair_without_its_skull_is_one_line_and_writes_nothing(command, folder, tmp_path):
    file = tmp_path / "d.npz"
    (folder / "p1_skull.npz").unlink()
    ended = command("head", "train-regressor", folder, "--out", file)
    assert "pair p1 has no p1_skull" in ended.refusal() and not file.exists()
