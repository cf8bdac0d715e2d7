"""The study of registration: slides and cosines follow from what registration gives."""

import numpy as np
import pytest
from scipy.sparse import identity

from softdeca.benchmarks.studies.heads import registration
from softdeca.lhm import identities
from softdeca.lhm.arkit import ARKIT
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
    assert registration.measure_slide(space, forth, space, forth).max() < 1e-9
    # The way back moves everything by 3 mm.
    back = exactly(space, space.mean, space.mean.vertices + [3.0, 0, 0])
    np.testing.assert_allclose(registration.measure_slide(space, forth, space, back), 3.0, atol=1e-9)
    assert 1500 < registration.find_visible_face(space).sum() < 2000


def test_cosine_and_distance_of_shapes(space):
    own = space.expressions
    visible = np.ones(own.shape[1], bool)
    rows = registration.measure_agreement(2.0 * own, own, visible)
    jaw = next(row for row in rows if row["shape"] == "jawOpen")
    mean = np.linalg.norm(own[ARKIT.index("jawOpen")], axis=1).mean()
    assert jaw["cosine"] == pytest.approx(1.0) and jaw["mean_mm"] == pytest.approx(mean)
    # What one of the two has not is left out.
    none = own.copy()
    none[ARKIT.index("jawOpen")] = 0.0
    assert "jawOpen" not in {row["shape"] for row in registration.measure_agreement(none, own, visible)}
    assert registration.median(rows)[0] == pytest.approx(1.0)


def test_slides_and_shapes_are_measured_and_told(space, monkeypatch):
    asked = []

    def register(template, parts, skin):
        asked.append(skin)
        # The order of triangles gives the vertices away; each point is then put beside its own.
        ids = np.zeros((len(skin.vertices), 3), dtype=np.int64)
        for k in range(3):
            ids[template.triangles[:, k]] = skin.triangles[:, [k, (k + 1) % 3, (k + 2) % 3]]
        away = 0.0 if np.array_equal(skin.triangles, template.triangles) else 0.1
        return register_by_mapping(template, parts, (ids, np.tile([1 - 2 * away, away, away], (len(ids), 1))), skin)

    monkeypatch.setattr(registration, "register", register)
    study = registration.Registrations(upon="anny")
    (task,) = study.tasks()
    values = study.measure(task)
    assert len(asked) == 4
    slides = [line for line in values["rows"] if line["compared"].startswith("slide")]
    assert len(slides) == 2 and all(line["mean_mm"] < 1e-6 for line in slides)
    cosines = [line["cosine"] for line in values["rows"] if "cosine" in line]
    for another, exact, registered in (cosines[:3], cosines[3:]):
        assert another == pytest.approx(1.0, abs=1e-4)
        assert 0.97 < exact <= 1.0 and registered < exact
    assert {line["compared"] for line in values["shapes"]} <= {line["compared"] for line in values["rows"]}
