"""The default depths against one real skull: the Visible Male's, under his own skin."""

import pytest

from softdeca.benchmarks.harness import run
from softdeca.benchmarks.studies.heads.depth import Depth

pytestmark = pytest.mark.usefixtures("measured_here")


@pytest.fixture(scope="module")
def checked(data, tmp_path_factory):
    folder = data / "visible_male"
    if not folder.is_dir():
        pytest.skip(f"no Visible Male at {folder}")
    bones = tuple(str(folder / f"vm_{name}.ply") for name in ("cranium", "mandible"))
    out = tmp_path_factory.mktemp("visible_male")
    return run(Depth(str(folder / "vm_skin.ply"), bones), out, workers=1), out


@pytest.fixture(scope="module")
def values(checked):
    (row,) = checked[0].rows
    return dict(row.values) | {"regions": {of["region"]: of for of in row.values["rows"]}}


def test_default_depths_over_a_real_skull(values):
    face, scalp = (values["regions"][name] for name in ("face", "scalp"))
    assert scalp["measured_share"] > 0.95 and face["measured_share"] > 0.6
    assert 0 < values["registered_off"] < 1.0

    # Scalp: the published 5 mm, this man has 6.
    assert scalp["mean"] < 2.0 and scalp["quantile_95"] < 4.0
    # Face: a heavy man, and between the landmarks bone is farther away than at them; the prior is far too thin.
    assert face["mean"] < 10.0 and -10.0 < face["bias"] < 0.0


def test_the_fitted_skull_wrap_over_a_real_skull(values):
    regions = values["regions"]
    # A wrap that follows the depths is on the scalp no farther from the bone than they are.
    assert regions["scalp"]["wrap_mean"] < 2.0 and regions["scalp"]["wrap_95"] < 4.0
    assert regions["face"]["wrap_mean"] < 12.0
