"""The facial scene: parameters, bone motion, and the terms of Eq. 15."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.lhm import InputError, Surface, fit_head, identities, load_template
from softdeca.lhm.base.geometry.warp import rigid_motion
from softdeca.lhm.remesh import refine_head
from softdeca.reference import Parameters, SceneError, apply_law, facial_scene, terms
from softdeca.reference.face.bones import carry_wraps
from softdeca.reference.face.palsy import Springs
from softdeca.reference.face.tissue import Attachment, Stack, bone_points, connecting_tets, eyeballs


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
    n = len(head.bone)
    placed = carry_wraps(head, Parameters(), head.skin_wrap.vertices, targets)[2]
    skull = head.skull_wrap.vertices
    expected = np.where(jaw[:, None], skull @ rotation.T, skull)
    assert placed[head.bone > 0] == pytest.approx(expected[head.bone > 0], abs=1e-10)
    fixed = facial_scene(head, Parameters(), targets, bones="prescribed").of(terms.Fixed)[0]
    assert set(fixed.vertices - 2 * n) == set(np.flatnonzero(head.bone > 0))
    assert fixed.values == pytest.approx(placed[head.bone > 0])


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
    soft, muscle = apply_law(scene, "neo-Hookean").of(terms.Hyperelastic)
    assert (soft.material.mu, soft.material.lmbda) == (2.0, 20.0)
    assert muscle.material.mu == pytest.approx(0.3 * 2.0)
    grown = facial_scene(sphere_head, Parameters(soft_volume=1.2), sphere_head.skin.vertices)
    assert [np.max(law.growth) for law in apply_law(grown, "neo-Hookean").of(terms.Hyperelastic)] == [1.2, 1.0]
    limited = facial_scene(sphere_head, Parameters(strain_limit=1.1), sphere_head.skin.vertices)
    with pytest.raises(SceneError, match="no counterpart"):
        apply_law(limited, "neo-Hookean")


def test_targets_of_another_skin_are_refused(sphere_head):
    with pytest.raises(SceneError, match="expected the skin's shape"):
        facial_scene(sphere_head, Parameters(), np.zeros((5, 3)))
    with pytest.raises(SceneError, match="not finite"):
        facial_scene(sphere_head, Parameters(), np.full_like(sphere_head.skin.vertices, np.nan))


def test_skin_after_adds_only_the_deviation(sphere_head):
    head = sphere_head
    expression = head.skin.vertices * 1.1
    assert head.skin_after(expression, head.wrap_targets(expression)) == pytest.approx(expression)


def test_rigid_bones_are_a_held_cranium_and_a_free_mandible(sphere_head):
    head, n = sphere_head, len(sphere_head.bone)
    p = Parameters(mandible_scale_y=1.1)
    scene = facial_scene(head, p, head.skin.vertices, bones="rigid")
    (held,), (jaw,) = scene.of(terms.Fixed), scene.of(terms.RigidBody)
    assert set(held.vertices - 2 * n) == set(np.flatnonzero(head.bone == 1))
    assert set(jaw.vertices - 2 * n) == set(np.flatnonzero(head.bone == 2))
    was, scaled = head.skull_wrap.vertices[head.bone == 2], jaw.rest
    # A tenth more height, the same width and length, and the condyles stay.
    assert np.ptp(scaled, axis=0) == pytest.approx(np.ptp(was, axis=0) * [1.0, 1.1, 1.0])
    assert scaled[:, 1].min() < was[:, 1].min() - 0.05 * np.ptp(was[:, 1])
    assert scaled[:, [0, 2]] == pytest.approx(was[:, [0, 2]])


def test_soft_bones_are_stiff_curved_surfaces_under_springs(sphere_head):
    scene = facial_scene(sphere_head, Parameters(skin_stiffness=30.0), sphere_head.skin.vertices, bones="soft")
    surface = scene.of(terms.SurfaceStrain)[1]
    assert surface.stiffness == 30e3 and not scene.of(terms.Fixed)
    assert len(scene.of(terms.Bending)[0].triangles) == len(surface.triangles) > 0
    assert len(scene.of(terms.Target)) == 2


def test_parameters_may_vary_over_the_face(sphere_head):
    head = sphere_head
    faces = len(head.skin_wrap.triangles)
    soft = np.linspace(2.0, 8.0, faces)
    scene = facial_scene(head, Parameters(soft_stiffness=soft, target_stiffness=soft), head.skin.vertices)
    strain = scene.of(terms.Strain)[0].stiffness
    assert strain == pytest.approx(np.repeat(soft, 3))
    # One value per tet says the same, and the springs' sum is the integral over the skin.
    again = facial_scene(head, Parameters(soft_stiffness=np.repeat(soft, 3)), head.skin.vertices)
    assert np.array_equal(again.of(terms.Strain)[0].stiffness, strain)
    assert scene.of(terms.Target)[0].stiffness.sum() == pytest.approx(soft @ head.skin_wrap.areas)
    uniform = Parameters(soft_stiffness=np.full(faces, 4.0))
    assert uniform == Parameters(soft_stiffness=np.full(faces, 4.0)) != Parameters(soft_stiffness=4.0)
    assert hash(uniform) == hash(Parameters(soft_stiffness=np.full(faces, 4.0)))
    with pytest.raises(SceneError, match="soft_stiffness: 7 values for"):
        facial_scene(head, Parameters(soft_stiffness=np.full(7, 4.0)), head.skin.vertices)
    with pytest.raises(InputError, match=r"soft_stiffness = 40 \(number 2\) is outside"):
        Parameters(soft_stiffness=np.array([4.0, 5.0, 40.0]))
    with pytest.raises(InputError, match="gravity: one number for the whole head"):
        Parameters(gravity=np.ones(faces))
    with pytest.raises(InputError, match="soft_stiffness varies over the face"):
        uniform.vector()


def test_a_paralysed_half_lets_go_of_its_targets(sphere_head):
    palsied = Parameters(paralysis_left=1.0)
    whole = Springs.from_head(sphere_head, Parameters()).stiffness
    kept = Springs.from_head(sphere_head, palsied).stiffness / whole
    x, _, z = sphere_head.skin_wrap.vertices.T
    assert np.all(kept[x > 10.0] == 0.0) and np.all(kept[x < -10.0] == 1.0)
    assert kept[np.argmin(np.abs(x))] == pytest.approx(0.5, abs=0.2)
    # What is not face stays tied.
    faced = replace(sphere_head, regions={"face": z > 0.0})
    kept = Springs.from_head(faced, palsied).stiffness / whole
    assert np.all(kept[z <= 0.0] == 1.0) and np.all(kept[x < -10.0] == 1.0)
    assert kept[(x > 10.0) & (z > 60.0)].max() < 0.1


def test_what_lines_a_paralysed_eye_stays_with_the_face_at_rest_and_a_mouths_lining_with_the_jaw(sphere_head):
    x = sphere_head.skin_wrap.vertices
    rim, inner = (x[:, 2] > 40.0) & (x[:, 2] <= 60.0), x[:, 2] > 60.0
    regions = {"face": x[:, 2] < 90.0}
    eyed, mouthed = (
        replace(sphere_head, regions=regions | {edge: rim, lining: inner})
        for lining, edge in (("eyes", "lids"), ("mouth", "lips"))
    )
    far, left = x[:, 2] > 92.0, x[:, 0] > 12.0
    smile = x + np.array([1.0, 2.0, 0.0])
    for head, drawn in ((eyed, x), (mouthed, smile)):
        whole, springs = (Springs.from_head(head, Parameters(paralysis_left=share)) for share in (0.0, 1.0))
        assert (far & left).any() and np.allclose(springs.stiffness[far & left], whole.stiffness[far & left])
        assert np.all(springs.stiffness[rim & left] < 1e-9 * whole.stiffness[rim & left])
        assert np.allclose(springs.positions(smile, x)[far & left], drawn[far & left])
        assert np.array_equal(springs.positions(smile, x)[x[:, 0] < -12.0], smile[x[:, 0] < -12.0])
        assert np.array_equal(springs.move(smile - x), springs.positions(smile, x) - x)
    half = Springs.from_head(eyed, Parameters(paralysis_left=0.5))
    assert np.allclose(half.positions(smile, x)[far & left], 0.5 * (smile + x)[far & left])


def test_gravity_acts_as_the_difference_to_the_scans_own():
    assert not np.any(Parameters().added_gravity)
    assert Parameters(gravity=3.0).added_gravity == pytest.approx([0, -2 * 9810, 0])
    # Lying on the back: 1 g along -z in place of 1 g along -y, whatever the direction's length.
    lying = Parameters(gravity_y=0.0, gravity_z=-0.5)
    assert lying.added_gravity == pytest.approx([0, 9810, -9810])
    with pytest.raises(InputError, match="all zero"):
        Parameters(gravity_y=0.0)


def test_a_region_keeps_its_tets_and_holds_the_rest(sphere_head):
    head, n = sphere_head, len(sphere_head.bone)
    front = head.skin_wrap.vertices[:, 2] > 0.0
    targets = head.skin.vertices + [0.0, 0.0, 1.0]
    scene = facial_scene(head, Parameters(), targets, region=front, bones="prescribed")
    kept = front[head.skin_wrap.triangles].any(axis=1)
    assert len(scene.tets) == 6 * kept.sum()
    held, values = scene.dirichlet()
    assert held[:n][~front].all() and not held[:n][front].any()
    assert values[:n][~front] == pytest.approx(targets[~front])
    with pytest.raises(SceneError, match="region 'nose'"):
        facial_scene(head, Parameters(), targets, region="nose")
    with pytest.raises(SceneError, match="expected a mask"):
        facial_scene(head, Parameters(), targets, region=front[:-1])


def test_layers_that_are_left_out_cost_nothing(sphere_head):
    head, n = sphere_head, len(sphere_head.bone)
    whole = facial_scene(head, Parameters(), head.skin.vertices)
    merged = facial_scene(head, Parameters(), head.skin.vertices, without=("muscle", "skin"))
    assert len(merged.tets) == len(whole.tets) // 2
    assert merged.volumes.sum() == pytest.approx(whole.volumes.sum(), rel=1e-2)
    assert not merged.of(terms.SurfaceStrain) and len(merged.vertices) == 2 * n
    front = head.skin.vertices[:, 2] > 0
    finer = facial_scene(head, Parameters(), head.skin.vertices, bones="prescribed", layers=(2, 3), region=front)
    assert len(finer.vertices) == 6 * n and len(finer.tets) > 2 * len(whole.tets) // 2
    assert np.array_equal(finer.vertices[2 * n : 3 * n], head.muscle_wrap.vertices)
    assert finer.of(terms.Fixed)[0].values == pytest.approx(head.skull_wrap.vertices[head.bone > 0])
    held = np.flatnonzero(finer.dirichlet()[0][: 5 * n].any(axis=1)) % n
    assert np.all(head.skin.vertices[held, 2] <= 0)
    with pytest.raises(SceneError, match="layers"):
        facial_scene(head, Parameters(), head.skin.vertices, layers=(0, 1))
    with pytest.raises(InputError, match="without"):
        facial_scene(head, Parameters(), head.skin.vertices, without="muscle")
    literal = facial_scene(head, Parameters(strain_limit=1.05), head.skin.vertices, rule="indicator")
    assert [strain.rule for strain in literal.of(terms.Strain)] == ["indicator", "clamp"]
    with pytest.raises(SceneError, match="no counterpart"):
        apply_law(facial_scene(head, Parameters(), head.skin.vertices, rule="indicator"), "neo-Hookean")
    with pytest.raises(SceneError, match="bones 'hard'"):
        facial_scene(head, Parameters(), head.skin.vertices, bones="hard")


def test_connecting_tets_are_sound_and_hold_their_points(sphere_head):
    wrap = sphere_head.skull_wrap
    rng = np.random.default_rng(0)
    points = wrap.vertices[rng.choice(len(wrap.vertices), 50, replace=False)] * 0.97
    triangles, tets = connecting_tets(points, wrap)
    stack = np.vstack([wrap.vertices, points])
    edges = stack[tets[:, 1:]] - stack[tets[:, :1]]
    mean = np.linalg.norm(np.diff(stack[wrap.triangles[triangles]], axis=1, append=0)[:, :2], axis=2).mean(axis=1)
    assert np.all(np.linalg.det(edges) > 0.015 * mean**3)
    assert np.array_equal(np.sort(tets, axis=1)[:, 3], len(wrap.vertices) + np.arange(50))
    flat = Surface(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]]), np.array([[0, 1, 2], [1, 3, 2]]))
    with pytest.raises(SceneError, match="attached point 1: it lies in the plane"):
        connecting_tets(np.array([[0.2, 0.2, 1.0], [0.2, 0.2, 0.0]]), flat)


def test_an_attached_skull_takes_the_place_of_its_bone(sphere_head):
    head, n = sphere_head, len(sphere_head.bone)
    skull = bone_points(head)
    scene = facial_scene(head, Parameters(), head.skin.vertices, bones="rigid", attached=skull)
    (held,), (jaw,) = scene.of(terms.Fixed), scene.of(terms.RigidBody)
    assert held.vertices.min() >= 3 * n and jaw.vertices.min() >= 3 * n
    assert len(scene.vertices) == 3 * n + sum(len(thing.points) for thing in skull)
    # Stiffer than soft tissue by connector_ratio, and at rest without force.
    assert scene.of(terms.Strain)[2].stiffness == pytest.approx(10.0 * 5.0)
    with pytest.raises(SceneError, match="no bone"):
        facial_scene(head, Parameters(), head.skin.vertices, bones="soft", attached=skull)
    with pytest.raises(SceneError, match="lids"):
        eyeballs(head)
    with pytest.raises(SceneError, match="bone 7"):
        Attachment(np.zeros((4, 3)), 7)


def test_a_head_of_a_volume_mesh_has_the_same_scene(sphere_head):
    # Its own prisms, told as a volume.
    head = replace(sphere_head, volume=(sphere_head.soft, sphere_head.muscle))
    targets = head.skin.vertices * 1.05
    own, told = (facial_scene(h, Parameters(), targets, bones="prescribed") for h in (sphere_head, head))
    assert np.array_equal(own.tets, told.tets) and np.array_equal(own.vertices, told.vertices)
    for a, b in zip(own.terms, told.terms, strict=True):
        assert type(a) is type(b)
    assert np.array_equal(own.of(terms.Fixed)[0].vertices, told.of(terms.Fixed)[0].vertices)
    assert np.array_equal(own.of(terms.Strain)[1].tets, told.of(terms.Strain)[1].tets)
    merged = facial_scene(head, Parameters(), targets, without=("muscle",))
    assert len(merged.of(terms.Strain)) == 1 and len(merged.tets) == len(own.tets)


def test_a_volume_mesh_is_whole_and_of_one_value(sphere_head):
    head = refine_head(sphere_head)
    rest = head.skin.vertices
    with pytest.raises(SceneError, match="layers"):
        facial_scene(head, Parameters(), rest, layers=(2, 1))
    with pytest.raises(SceneError, match="region"):
        facial_scene(head, Parameters(), rest, region=head.skin_wrap.vertices[:, 2] > 0)
    many = np.full(len(head.skin_wrap.triangles), 5.0)
    with pytest.raises(SceneError, match="soft_stiffness: expected one number"):
        facial_scene(head, Parameters(soft_stiffness=many), rest)
    # The membrane has its triangles still.
    assert facial_scene(head, Parameters(skin_stiffness=many), rest).of(terms.SurfaceStrain)


def test_a_volume_mesh_is_carried_with_its_wraps(sphere_head):
    head = refine_head(sphere_head)
    stack = Stack.from_head(head, (1, 1), ())
    wraps = [wrap.vertices for wrap in (head.skin_wrap, head.muscle_wrap, head.skull_wrap)]
    assert stack.interpolate(*wraps) == pytest.approx(head.vertices)
    shift = np.array([1.0, -2.0, 3.0])
    assert stack.interpolate(*(wrap + shift for wrap in wraps)) == pytest.approx(head.vertices + shift)
    assert stack.first_of_skull == 2 * len(head.bone)


def test_prisms_that_fold_without_the_muscle_wrap_are_few_and_left_out():
    head = fit_head(load_template(), identities.Anny().sample(np.random.default_rng(0))[1])
    whole = 3 * len(head.skin_wrap.triangles)
    scene = facial_scene(head, Parameters(), head.skin.vertices, without=("muscle",))
    assert whole - 29 < len(scene.tets) < whole
    assert np.array_equal(np.unique(scene.tets), np.arange(len(scene.vertices)))
    crossed = replace(head, muscle_wrap=head.muscle_wrap)
    twisted = np.array(head.skull_wrap.vertices)
    object.__setattr__(crossed, "skull_wrap", head.skull_wrap.with_vertices(twisted[::-1]))
    with pytest.raises(SceneError, match="without muscle .* tets from skin to skull are folded"):
        facial_scene(crossed, Parameters(), head.skin.vertices, without=("muscle",))
