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
    # Where landmarks lie on bone under thin tissue, it is close.
    rows = {(row["landmark"], row["side"]): row for row in values["landmarks"]}
    for name in ("supraorbital", "temple"):
        assert rows[name, "left"]["met"] and abs(rows[name, "left"]["error"]) < 5.0, name
    # His chin is 18 mm of flesh where the published mean is 10.5: measured on the chin, not under it.
    assert rows["chin", "middle"]["met"] and 14.0 < rows["chin", "middle"]["measured"] < 22.0


def test_the_fitted_skull_wrap_over_a_real_skull(values):
    regions = values["regions"]
    # A wrap that follows the depths is on the scalp no farther from the bone than they are.
    assert regions["scalp"]["skull_wrap"]["mean"] < 2.0 and regions["scalp"]["skull_wrap"]["quantile_95"] < 4.0
    # In the face the room in front of the mouth's pocket limits it besides.
    assert regions["face"]["fitted_mean"] < regions["face"]["predicted_mean"]
    assert regions["face"]["skull_wrap"]["mean"] < 12.0
