"""The default head and ICT-FaceKit's: layers that are valid, and a mouth that opens."""

import numpy as np
import pytest

from softdeca.lhm import check_head, expressions, fit_head, identities, load_template
from softdeca.lhm.head.skin import check_skin
from softdeca.reference import Face, Parameters


@pytest.fixture(scope="module", params=["anny", "ict"])
def space(request):
    if request.param == "anny":
        return identities.Anny()
    return identities.ICTFaceKit(request.getfixturevalue("data") / "ict_facekit.npz")


@pytest.fixture(scope="module")
def template(space):
    return load_template(space)


def test_skin_is_closed_and_of_human_size(space):
    check_skin(space.mean)
    assert 200 < np.ptp(space.mean.vertices[:, 1]) < 320
    assert space.expressions.shape == (52, len(space.mean.vertices), 3)
    silent = {name for name, delta in zip(expressions.ARKIT, space.expressions, strict=True) if not delta.any()}
    assert silent == set(space.missing)


def test_template_passes_its_gates(template):
    head = template.head
    assert (len(head.skin_wrap.vertices), len(head.tets)) == (4842, 58080)
    report = check_head(head)
    assert report.problems == ()
    assert report.wrap_to_skin_mean < 0.5 and report.wrap_to_skin_95 < 1.0
    assert report.cranium_vertices > 1000 and report.mandible_vertices > 50
    assert {"lips", "mouth", "eyes", "neck", "face"} <= set(head.regions)


def test_jaw_open_opens_the_mouth_and_details_survive(space, template):
    head = template.head
    opened = expressions.blend(space, np.zeros(space.code_size), expressions.weights_of({"jawOpen": 1.0}))[0]
    targets = head.wrap_targets(opened)
    np.testing.assert_allclose(head.skin_after(opened, targets), opened, atol=1e-12)
    rim = template.landmarks.rim
    middle = np.abs(space.mean.vertices[rim, 0]) < 8
    gap = np.ptp(opened[rim][middle, 1]) - np.ptp(space.mean.vertices[rim][middle, 1])
    assert gap > 20
    lips = head.regions["lips"] & (np.abs(head.skin_wrap.vertices[:, 0]) < 8)
    assert np.ptp(targets[lips, 1]) - np.ptp(head.skin_wrap.vertices[lips, 1]) > 0.7 * gap
    assert np.linalg.norm((targets - head.skin_wrap.vertices)[head.bone == 2], axis=1).min() > 5
    assert np.linalg.norm((targets - head.skin_wrap.vertices)[head.bone == 1], axis=1).max() < 3.5


@pytest.mark.parametrize("seed", range(3))
def test_random_identities_have_valid_layers(space, template, seed):
    _, skin = space.sample(np.random.default_rng(seed))
    head = fit_head(template, skin)
    report = check_head(head)
    assert report.problems == ()
    assert report.wrap_to_skin_95 < 1.5


def test_fitting_again_gives_the_same_head(space, template):
    _, skin = space.sample(np.random.default_rng(4))
    np.testing.assert_array_equal(fit_head(template, skin).vertices, fit_head(template, skin).vertices)


def test_people_alike_have_answers_alike():
    """A head is made of choices; a hundredth of a deviation of the code may not turn them round."""
    space = identities.Anny()
    template = load_template(space)
    rng = np.random.default_rng(2)
    code = space.sample(rng)[0]
    near = code + 0.01 * rng.normal(size=code.size)
    parameters = Parameters(soft_stiffness=4.0, target_stiffness=5.0)
    heads = [fit_head(template, space.skin(each)) for each in (code, near)]
    one, other = (
        Face(head, space.expression_deltas(each), parameters).responses
        for head, each in zip(heads, (code, near), strict=True)
    )
    assert np.linalg.norm(one - other, axis=2).mean() < 0.05 * np.linalg.norm(one, axis=2).mean()
