"""The facial scene: parameters, bone motion, and the terms of Eq. 15."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.lhm import InputError
from softdeca.lhm.geometry.rigid import rigid_motion
from softdeca.reference import Parameters, SceneError, facial_scene, neo_hookean_scene, terms
from softdeca.reference.facial import bone_positions


def test_parameters_name_what_is_out_of_range():
    assert Parameters(gravity=1.5).gravity == 1.5
    with pytest.raises(InputError, match=r"gravity = 5 is outside \[0, 3\] g"):
        Parameters(gravity=5)
    with pytest.raises(InputError, match="soft_stiffness: expected a number"):
        Parameters(soft_stiffness="soft")
    with pytest.raises(InputError, match="nan"):
        Parameters(skin_stiffness=float("nan"))
    with pytest.raises(InputError, match="unknown parameter 'weight'"):
        Parameters().vector(("weight",))


def test_parameters_normalise_their_range_to_plus_minus_one():
    for info in Parameters.infos():
        assert info.normalise(np.array([info.low, info.high])) == pytest.approx([-1, 1])
        rng = np.random.default_rng(0)
        assert all(info.low <= info.sample(rng) <= info.high for _ in range(100))


def test_rigid_motion_is_recovered_exactly():
    points = np.random.default_rng(1).normal(size=(20, 3))
    rotation = Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_matrix()
    found, translation = rigid_motion(points, points @ rotation.T + [1, 2, 3])
    assert found == pytest.approx(rotation, abs=1e-12)
    assert translation == pytest.approx([1, 2, 3], abs=1e-12)


def test_mandible_follows_the_skin_over_it_and_the_cranium_stays(sphere_head):
    head = sphere_head
    targets = np.array(head.skin_wrap.vertices)
    jaw = head.bone == 2
    rotation = Rotation.from_euler("x", 0.2).as_matrix()
    targets[jaw] = targets[jaw] @ rotation.T
    ids, placed = bone_positions(head, targets)
    n = len(head.bone)
    skull = head.skull_wrap.vertices
    expected = np.where(jaw[:, None], skull @ rotation.T, skull)[ids - 2 * n]
    assert placed == pytest.approx(expected, abs=1e-10)
    assert set(ids - 2 * n) == set(np.flatnonzero(head.bone > 0))


def test_the_scene_has_only_what_it_needs(sphere_head):
    head = sphere_head
    scene = facial_scene(head, Parameters(), head.skin.vertices)
    assert not scene.of(terms.Gravity)
    heavier = facial_scene(head, Parameters(gravity=3.0), head.skin.vertices)
    # The scan hangs under 1 g already: 3 g adds twice its weight.
    weight = 2 * 9810 * 1.04e-6 * scene.volumes.sum()
    assert heavier.loads().sum(axis=0) == pytest.approx([0, -weight, 0])
    # Springs of 10 kPa/mm over the whole skin.
    assert scene.of(terms.Target)[0].stiffness.sum() == pytest.approx(10.0 * head.skin_wrap.areas.sum())


def test_neo_hookean_counterpart_has_the_same_small_strain_moduli(sphere_head):
    scene = facial_scene(sphere_head, Parameters(soft_stiffness=4.0, volume_ratio=15.0), sphere_head.skin.vertices)
    soft, muscle = neo_hookean_scene(scene).of(terms.Hyperelastic)
    assert (soft.material.mu, soft.material.lmbda) == (2.0, 20.0)
    assert muscle.material.mu == pytest.approx(0.3 * 2.0)
    with pytest.raises(SceneError, match="no counterpart"):
        neo_hookean_scene(facial_scene(sphere_head, Parameters(soft_volume=1.2), sphere_head.skin.vertices))


def test_targets_of_another_skin_are_refused(sphere_head):
    with pytest.raises(SceneError, match="expected the skin's shape"):
        facial_scene(sphere_head, Parameters(), np.zeros((5, 3)))
    with pytest.raises(SceneError, match="not finite"):
        facial_scene(sphere_head, Parameters(), np.full_like(sphere_head.skin.vertices, np.nan))


def test_skin_after_adds_only_the_deviation(sphere_head):
    head = sphere_head
    expression = head.skin.vertices * 1.1
    assert head.skin_after(expression, head.wrap_targets(expression)) == pytest.approx(expression)
