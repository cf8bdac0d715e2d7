"""Scenes that no target holds: bones where they were put, loads that balance, and flesh that follows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from softdeca.reference import Parameters, solve, terms
from softdeca.reference.face.free_scenes import jaw_hinge, open_jaw_scene, push_cheek_scene
from softdeca.reference.face.parameters import TISSUE_DENSITY

GRAVITY = 9810.0


@pytest.fixture(scope="module")
def head(spheres):
    with pytest.MonkeyPatch.context() as path:
        path.syspath_prepend(Path(__file__).parents[1])
        from sphere_studies import with_regions
    return with_regions(spheres(3))


@pytest.fixture(scope="module")
def bare(head):
    """The same without regions: nothing lines a mouth, so bones alone hold the flesh."""
    return replace(head, regions={})


def test_a_jaw_opens_by_its_angle_about_its_hinge(head):
    scene = open_jaw_scene(head, Parameters(), angle=10.0)
    solution = solve(scene)
    n, jaw = len(head.bone), head.bone == 2
    hinge, rest, moved = jaw_hinge(head), head.skull_wrap.vertices[jaw], solution.positions[2 * n :][jaw]
    arms = [(points - hinge)[:, 1:] for points in (rest, moved)]
    turned = np.arctan2(*arms[1].T[::-1]) - np.arctan2(*arms[0].T[::-1])
    np.testing.assert_allclose(np.degrees(turned), 10.0, atol=1e-9)
    np.testing.assert_allclose(solution.positions[2 * n :][head.bone == 1], head.skull_wrap.vertices[head.bone == 1])
    # The skin over the bone goes with it: tissue hangs on nothing else there.
    skin = solution.positions[:n][jaw] - head.skin_wrap.vertices[jaw]
    np.testing.assert_allclose(skin.mean(axis=0), (moved - rest).mean(axis=0), atol=0.3 * np.abs(moved - rest).max())


def test_what_holds_the_bones_bears_the_flesh(bare):
    """Reactions of a face that no spring holds are its weight, exactly."""
    scene = open_jaw_scene(bare, Parameters(gravity=2.0), angle=10.0)
    assert not np.any(scene.of(terms.Target)[0].stiffness)
    reactions = solve(scene, tolerance=1e-10).reactions.sum(axis=0)
    weight = TISSUE_DENSITY * GRAVITY * scene.volumes.sum()
    np.testing.assert_allclose(reactions, [0.0, weight, 0.0], atol=1e-6 * weight)


def test_what_holds_the_bones_bears_the_push(bare):
    centre = bare.skin_wrap.vertices[np.argmax(bare.skin_wrap.vertices @ [1.0, 0.0, 1.0])]
    scene = push_cheek_scene(bare, Parameters(), pressure=0.5, radius=30.0, centre=centre)
    (push,) = scene.of(terms.Traction)
    x = bare.skin_wrap.vertices[push.triangles]
    area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum()
    solution = solve(scene, tolerance=1e-10)
    inward = push.vector / np.linalg.norm(push.vector)
    np.testing.assert_allclose(solution.reactions.sum(axis=0), -0.5 * area * inward, atol=1e-6 * area)
    at = np.unique(push.triangles)
    moved = (solution.positions - scene.vertices)[at] @ inward
    assert np.all(moved > -0.1 * moved.max()) and moved.mean() > 0.3 * moved.max(), "but for a bulge at its edge"


def test_a_small_push_at_half_strength_moves_half_as_far(head):
    moved = []
    for pressure in (0.02, 0.04):
        scene = push_cheek_scene(head, Parameters(), pressure=pressure, radius=30.0)
        moved.append(solve(scene, tolerance=1e-4).positions - scene.vertices)
    assert np.abs(moved[1] - 2.0 * moved[0]).max() < 0.05 * np.abs(moved[1]).max()


def test_the_lining_alone_is_held(head):
    stiffness = push_cheek_scene(head, Parameters(), radius=30.0).of(terms.Target)[0].stiffness
    eyes, lips = head.regions["eyes"], head.regions["lips"]
    assert np.all(stiffness[eyes & ~lips] > 0.0) and not stiffness[~eyes].any()
