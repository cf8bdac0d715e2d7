"""The default depths against one real skull: the Visible Male's, under his own skin."""

import numpy as np
import pytest

from softdeca.benchmarks.depth_error import depth_comparison
from softdeca.lhm import identities, load_template
from softdeca.lhm.files.surface_file import read_surface
from softdeca.lhm.registration import register
from softdeca.lhm.regressor import DepthErrors, default_regressor, inward_normals, measured_depths, moved_wrap


@pytest.fixture(scope="module")
def surfaces(data):
    folder = data / "visible_male"
    if not folder.is_dir():
        pytest.skip(f"no Visible Male at {folder}")
    return [read_surface(folder / f"vm_{name}.ply") for name in ("skin", "cranium", "mandible")]


def test_default_depths_over_a_real_skull(surfaces):
    skin, *bones = surfaces
    space = identities.Anny()
    template = load_template(space)
    registered = register(space.mean, space.parts, skin)
    wrap = template.skin_wrap.with_vertices(moved_wrap(template, registered.vertices))
    measured = measured_depths(wrap.vertices, inward_normals(wrap), bones)
    predicted = default_regressor(template, space).predict(wrap.vertices)

    eyes, mouth = template.marks.eyes.mean(axis=0), template.marks.mouth
    rest, face = template.skin_wrap.vertices, template.regions["face"]
    above = rest[:, 1] > eyes[1] + 0.9 * (eyes[1] - mouth[1])
    assert measured.met[above].mean() > 0.95 and measured.met[face].mean() > 0.6

    # Scalp: the published 5 mm, this man has 6.
    scalp = DepthErrors.between(predicted[above & measured.met], measured.depths[above & measured.met])
    assert scalp.mean < 2.0 and scalp.quantile_95 < 4.0
    # Face: a heavy man, and between the landmarks bone is farther away than at them; the prior is far too thin.
    of_face = DepthErrors.between(predicted[face & measured.met], measured.depths[face & measured.met])
    assert of_face.mean < 10.0 and -10.0 < of_face.bias < 0.0
    # Where landmarks lie on bone under thin tissue, it is close.
    for name, x, y, most in (("chin", 0.0, -1.6, 6.0), ("supraorbital", 1.0, 0.35, 5.0), ("temple", 1.7, 0.4, 5.0)):
        place = eyes[:2] + [x * template.marks.face_width, y * np.linalg.norm(eyes - mouth)]
        front = np.flatnonzero(face)
        vertex = front[np.linalg.norm(rest[front, :2] - place, axis=1).argmin()]
        assert abs(predicted[vertex] - measured.depths[vertex]) < most, name
    assert depth_comparison(wrap, predicted, measured.depths).startswith(b"\x89PNG")
