"""`bench registration`: slides and cosines follow from what registration gives, and the command tells them."""

import json

import numpy as np
import pytest
from scipy.sparse import identity

from softdeca.benchmarks import registrations
from softdeca.lhm import identities
from softdeca.lhm.arkit import ARKIT
from softdeca.lhm.base.provenance import list_missing
from softdeca.lhm.registration import register_by_mapping
from softdeca.lhm.registration.registration import Registration


@pytest.fixture(scope="module")
def space():
    return identities.Anny()


def exactly(space, skin, vertices=None) -> Registration:
    """The template laid on a skin of its own triangles, by their numbers."""
    n = len(skin.vertices)
    laid = register_by_mapping(space.mean, space.parts, identity(n, format="csr"), skin)
    return laid if vertices is None else Registration(skin.with_vertices(vertices), *list(vars(laid).values())[1:])


def test_points_carried_along_the_skin_are_off_by_as_much(space):
    forth = exactly(space, space.mean)
    assert registrations.slide(space, forth, space, forth).max() < 1e-9
    # The way back moves everything by 3 mm.
    back = exactly(space, space.mean, space.mean.vertices + [3.0, 0, 0])
    np.testing.assert_allclose(registrations.slide(space, forth, space, back), 3.0, atol=1e-9)
    assert 1500 < registrations.visible_face(space).sum() < 2000


def test_cosine_and_distance_of_shapes(space):
    own = space.expressions
    visible = np.ones(own.shape[1], bool)
    rows = registrations.agreement(2.0 * own, own, visible)
    jaw = next(row for row in rows if row["shape"] == "jawOpen")
    mean = np.linalg.norm(own[ARKIT.index("jawOpen")], axis=1).mean()
    assert jaw["cosine"] == pytest.approx(1.0) and jaw["mean_mm"] == pytest.approx(mean)
    # What one of the two has not is left out.
    none = own.copy()
    none[ARKIT.index("jawOpen")] = 0.0
    assert "jawOpen" not in {row["shape"] for row in registrations.agreement(none, own, visible)}
    assert registrations.median(rows)[0] == pytest.approx(1.0)


def test_slides_and_shapes_are_measured_and_told(space, command, monkeypatch):
    asked = []

    def register(template, parts, skin):
        asked.append(skin)
        # The order of triangles gives the vertices away; each point is then put beside its own.
        ids = np.zeros((len(skin.vertices), 3), dtype=np.int64)
        for k in range(3):
            ids[template.triangles[:, k]] = skin.triangles[:, [k, (k + 1) % 3, (k + 2) % 3]]
        away = 0.0 if np.array_equal(skin.triangles, template.triangles) else 0.1
        return register_by_mapping(template, parts, (ids, np.tile([1 - 2 * away, away, away], (len(ids), 1))), skin)

    monkeypatch.setattr(registrations, "register", register)
    ended = command("bench", "registration", "--upon", "anny", "--json")
    results = json.loads(ended.out)
    assert ended.status == 0 and len(asked) == 4
    assert set(list_missing(results)) <= {"clean tree", "commit"} and results["options"]["seed"] == 0
    assert [row["mean_mm"] < 1e-6 for row in results["slide"]] == [True, True]
    for group in results["shapes"]:
        cosines = {what: registrations.median(rows)[0] for what, rows in group["rows"].items()}
        assert cosines["another rig"] == pytest.approx(1.0, abs=1e-4)
        assert 0.97 < cosines["a person, exact points"] <= 1.0
        assert cosines["a person, registered"] < cosines["a person, exact points"]
    lines = command("bench", "registration", "--upon", "anny").out.splitlines()
    assert lines[0].startswith("anny to anny and back [mm]: mean 0.000") and len(lines) == 8
    assert sum("cosine, median" in line for line in lines) == 6
    ended = command("bench", "registration", "--upon", "nobody")
    assert ended.status != 0 and "nobody" in ended.errors[-1]
