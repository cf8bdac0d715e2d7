"""The facial scene: parameters, bone motion, and the terms of Eq. 15."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.reference import Parameters, apply_law, facial_scene, prepare, terms
from softdeca.reference.face.bones import carry_wraps
from softdeca.reference.face.palsy import Springs
from softdeca.reference.face.tissue import Guard, bone_points, eyeballs

from ..conftest import with_regions


def test_parameters_normalise_their_range_to_plus_minus_one():
    for info in Parameters.infos():
        assert info.normalise(np.array([info.low, info.high])) == pytest.approx([-1, 1])
        rng = np.random.default_rng(0)
        assert all(info.low <= info.sample(rng) <= info.high for _ in range(100))


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


def test_cells_are_prisms_or_their_tets(sphere_head):
    """Attached things hang by tets; what is left of a prism that has folded is tets; a volume mesh is."""
    head, skin = sphere_head, sphere_head.skin.vertices
    prisms = facial_scene(head, Parameters(soft_volume=1.2), skin, layers=(2, 1), attached=bone_points(head)[:1])
    by_tets = facial_scene(
        head, Parameters(soft_volume=1.2), skin, layers=(2, 1), attached=bone_points(head)[:1], cells="tets"
    )
    triangles = len(head.skin_wrap.triangles)
    assert len(prisms.prisms) == 3 * triangles and not len(by_tets.prisms)
    assert np.array_equal(prisms.tets, by_tets.tets)
    whole = [term for term in prisms.of(terms.Solid) if term.on_prisms]
    assert {type(term) for term in whole} == {terms.Strain, terms.Volume, terms.Hourglass, Guard}
    assert [len(term.tets) for term in prisms.of(terms.Volume)] == [
        2 * triangles,
        triangles,
        len(prisms.tets) - 9 * triangles,
    ]
    assert [scene.of(terms.Target)[0].lumped for scene in (prisms, by_tets)] == [False, True]
    stretched = [prepare(replace(scene, terms=scene.of(terms.Solid))) for scene in (prisms, by_tets)]
    motion = prisms.vertices @ np.diag([0.1, -0.05, 0.02])
    energies = [each.energy.evaluate(motion)[0] for each in stretched]
    assert energies[0] == pytest.approx(energies[1], rel=1e-12)
    law = apply_law(facial_scene(head, Parameters(), skin), "neo-Hookean")
    assert all(term.on_prisms for term in law.of(terms.Hyperelastic)) and law.of(terms.Hourglass)


def test_parameters_may_vary_over_the_face(sphere_head):
    head = sphere_head
    faces = len(head.skin_wrap.triangles)
    soft = np.linspace(2.0, 8.0, faces)
    graded = Parameters(soft_stiffness=soft, target_stiffness=soft)
    for cells, count in (("prisms", 1), ("tets", 3)):
        scene = facial_scene(head, graded, head.skin.vertices, cells=cells)
        strain = scene.of(terms.Strain)[0].stiffness
        assert np.array_equal(strain, np.repeat(soft, count))
        # One value per tet says the same, and the springs' sum is the integral over the skin.
        again = facial_scene(head, Parameters(soft_stiffness=np.repeat(soft, 3)), head.skin.vertices, cells=cells)
        assert np.array_equal(again.of(terms.Strain)[0].stiffness, strain)
    assert scene.of(terms.Target)[0].stiffness.sum() == pytest.approx(soft @ head.skin_wrap.areas)
    uniform = Parameters(soft_stiffness=np.full(faces, 4.0))
    assert uniform == Parameters(soft_stiffness=np.full(faces, 4.0)) != Parameters(soft_stiffness=4.0)
    assert hash(uniform) == hash(Parameters(soft_stiffness=np.full(faces, 4.0)))


def test_a_paralysed_half_lets_go_of_its_targets(sphere_head):
    palsied = Parameters(paralysis_left=1.0)
    whole = Springs.from_head(sphere_head, Parameters()).stiffness
    kept = Springs.from_head(sphere_head, palsied).stiffness / whole
    x, _, z = sphere_head.skin_wrap.vertices.T
    assert np.all(kept[x > 10.0] == 0.0) and np.all(kept[x < -10.0] == 1.0)
    assert kept[np.argmin(np.abs(x))] == pytest.approx(0.5, abs=0.2)
    # Skin outside the face stays tied.
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
    assert Parameters(gravity_y=0.0, gravity_z=-5e-324).added_gravity == pytest.approx([0, 9810, -9810])
    assert len({Parameters(gravity_x=0.0), Parameters(gravity_x=-0.0)}) == 1


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


def test_an_attached_skull_takes_the_place_of_its_bone(sphere_head, spheres):
    head, n = sphere_head, len(sphere_head.bone)
    skull = bone_points(head)
    scene = facial_scene(head, Parameters(), head.skin.vertices, bones="rigid", attached=skull)
    (held,), (jaw,) = scene.of(terms.Fixed), scene.of(terms.RigidBody)
    assert held.vertices.min() >= 3 * n and jaw.vertices.min() >= 3 * n
    assert len(scene.vertices) == 3 * n + sum(len(thing.points) for thing in skull)
    # Stiffer than soft tissue by connector_ratio, and at rest without force.
    assert scene.of(terms.Strain)[2].stiffness == pytest.approx(10.0 * 5.0)
    lids = with_regions(spheres(3))
    eyes = eyeballs(lids, radius=12.0)
    seen = facial_scene(lids, Parameters(), lids.skin.vertices, attached=eyes)
    assert len(seen.of(terms.RigidBody)) == 3
    assert len(seen.vertices) == 3 * len(lids.bone) + sum(len(eye.points) for eye in eyes)
    for eye in eyes:
        assert np.ptp(eye.points, axis=0) == pytest.approx([24.0] * 3, rel=0.1)
