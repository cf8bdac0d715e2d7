"""A symmetric skin has a symmetric head: twins of vertices, tets and ties, and mirrored answers to mirrored loads."""

import numpy as np
import pytest

from softdeca.lhm import expressions, fit_head
from softdeca.lhm.base.geometry.mirror import find_middle, find_twins, is_symmetric, symmetrise
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.geometry.topology import subdivide
from softdeca.lhm.head.layers import prism_tets
from softdeca.reference import Parameters, facial_scene, solve

MIRROR = np.array([-1.0, 1.0, 1.0])


def are_mirrored(elements, twins):
    """Find the triangles or tets (m, k), over wraps whose vertices have `twins`, that have a mirror image."""
    n = len(twins)
    own = {tuple(each) for each in np.sort(elements, axis=1).tolist()}
    image = np.sort(twins[elements % n] + elements // n * n, axis=1)
    return np.array([tuple(each) in own for each in image.tolist()])


def gap(points, twins):
    """The farthest of points (..., n, 3) [mm] from its twin's mirror image."""
    return np.abs(points - symmetrise(points, twins)).max()


@pytest.fixture(scope="module")
def skin_twins(anny):
    return find_twins(anny.mean.vertices)


@pytest.fixture(scope="module")
def twins(template):
    return find_twins(template.skin_wrap.vertices)


def test_points_find_their_twins_about_any_plane():
    x = geodesic_sphere(3)[0] + [7.0, 0.0, 0.0]
    twins = find_twins(x)
    np.testing.assert_allclose(x[twins] * MIRROR + [14.0, 0.0, 0.0], x, atol=1e-12)
    assert find_middle(x, twins) == pytest.approx(7.0)
    lopsided = x.copy()
    lopsided[x[:, 0].argsort()[5]] += 0.3
    assert find_twins(lopsided) is None and not is_symmetric(lopsided, twins)
    even = symmetrise(lopsided, twins)
    assert find_middle(even, twins) == pytest.approx(7.0) and is_symmetric(even, twins)
    np.testing.assert_array_equal(symmetrise(lopsided, None), lopsided)


def test_split_prisms_of_the_sphere_mirror_each_other_but_for_those_across_the_plane():
    x, triangles = geodesic_sphere(11)
    for across in (22, 44):
        twins = find_twins(x)
        assert are_mirrored(triangles, twins).all()
        beside = (twins[triangles] == np.roll(triangles, 1, axis=1)).any(axis=1)
        assert beside.sum() == 2 * across
        mirrored = are_mirrored(prism_tets(triangles, 0, len(x)), twins).reshape(-1, 3)
        assert mirrored[~beside].all() and not mirrored[beside].all(axis=1).any()
        x, triangles = subdivide(x, triangles)


def test_the_template_is_its_own_mirror_image(template, twins, skin_twins):
    n = len(twins)
    assert gap(template.stack.reshape(3, n, 3), twins) < 1e-9
    assert are_mirrored(template.triangles, twins).all() and are_mirrored(template.head.tets, twins).mean() > 0.98
    for labels in (template.bone, *template.regions.values()):
        np.testing.assert_array_equal(labels, labels[twins])
    np.testing.assert_allclose(template.room, template.room[twins], rtol=1e-12)
    off = template.wrap_from_skin - template.wrap_from_skin[twins][:, skin_twins]
    back = template.skin_from_wrap - template.skin_from_wrap[skin_twins][:, twins]
    assert abs(off).max() < 1e-12 and abs(back).max() < 1e-12


def test_heads_of_symmetric_skins_are_symmetric_and_others_are_not(template, anny, twins, skin_twins):
    skin = anny.skin(np.where(np.arange(anny.code_size) % 2, 1.5, -1.5))
    assert is_symmetric(skin.vertices, skin_twins)
    assert gap(fit_head(template, skin).vertices.reshape(3, -1, 3), twins) < 1e-9
    x = skin.vertices
    leaning = skin.with_vertices(
        x + [2.0, 0.0, 0.0] * np.exp(-((x - x[x[:, 2].argmax()]) ** 2).sum(axis=1) / 400)[:, None]
    )
    assert template.columns_of(leaning) is template.columns
    assert gap(fit_head(template, leaning).skin_wrap.vertices, twins) > 0.5


def test_rounding_decides_nothing_about_a_head(template, anny):
    for seed in range(3):
        skin = anny.sample(np.random.default_rng(seed))[1]
        noise = 1e-9 * np.random.default_rng(0).standard_normal(skin.vertices.shape)
        heads = [fit_head(template, skin.with_vertices(skin.vertices + share * noise)) for share in (0.0, 1.0)]
        assert np.abs(heads[0].vertices - heads[1].vertices).max() < 1e-5


def simulate(head, parameters, shape):
    scene = facial_scene(head, parameters, shape)
    solution = solve(scene, solver="projective", tolerance=1e-7, max_iterations=3000)
    assert solution.converged
    return head.skin_after(shape, solution.positions[: len(head.bone)])


def bump(head, side):
    """A stiffness per triangle of the wraps that is threefold in one cheek."""
    x = head.skin_wrap.vertices
    middle = x[head.regions["lips"]].mean(axis=0) + [35.0 * side, 20.0, -25.0]
    off = x[head.skin_wrap.triangles].mean(axis=1) - middle
    return 3.0 * np.exp(np.exp(-(off**2).sum(axis=1) / 20.0**2))


@pytest.mark.parametrize(
    ("weights", "parameters"),
    [
        ({"mouthSmileLeft": 0.6}, lambda head, side: Parameters()),
        ({"jawLeft": 1.0}, lambda head, side: Parameters()),
        ({"eyeBlinkLeft": 1.0}, lambda head, side: Parameters()),
        ({}, lambda head, side: Parameters(gravity=2.0, gravity_x=side, gravity_y=0.0)),
        ({"jawOpen": 0.4}, lambda head, side: Parameters(gravity=2.0, soft_stiffness=bump(head, side))),
    ],
    ids=["smile", "jaw", "blink", "gravity", "stiffness"],
)
def test_mirrored_loads_on_a_head_have_mirrored_answers(mean_head, anny, skin_twins, weights, parameters):
    rest = mean_head.skin.vertices
    shape = expressions.blend(anny, np.zeros(anny.code_size), expressions.weights_of(weights)[None])[0]
    answer = simulate(mean_head, parameters(mean_head, 1.0), shape)
    opposite = rest + (shape - rest)[skin_twins] * MIRROR
    image = simulate(mean_head, parameters(mean_head, -1.0), opposite)[skin_twins] * MIRROR
    moved = np.linalg.norm(answer - shape, axis=1).mean()
    assert np.linalg.norm(answer - image, axis=1).mean() < 0.01 * moved
