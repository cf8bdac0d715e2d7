"""Closed envelopes and what they are made with, against spheres; bones and muscles inside ICT-FaceKit's head."""

import numpy as np
import pytest
import trimesh

from softdeca.lhm import identities
from softdeca.lhm.anatomy import bodyparts
from softdeca.lhm.anatomy.envelope import (
    EnvelopePolicy,
    bone_at,
    closed_envelope,
    closed_surface,
    muscle_surface,
    skull_surface,
)
from softdeca.lhm.anatomy.placement import POLICY, close_pockets, keep_triangles, place
from softdeca.lhm.base.geometry.bvh import TriangleTree
from softdeca.lhm.base.geometry.distance import SignedDistance
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.mesh import Surface
from softdeca.lhm.head.head import CRANIUM, FREE, MANDIBLE
from softdeca.lhm.identities.space import MOUTH, OUTSIDE
from softdeca.lhm.template.build import find_connectors

BALL = 4 / 3 * np.pi


def ball(centre, radius: float, frequency: int = 12) -> Surface:
    x, triangles = geodesic_sphere(frequency)
    return Surface(radius * x + np.asarray(centre), triangles)


def as_trimesh(surface: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices, surface.triangles, process=False)


def grid(half: float, step: float):
    axis = np.arange(-half, half + step / 2, step)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


@pytest.mark.parametrize("most", [None, 40_000, 2000])
def test_the_closed_surface_of_a_spheres_field(most):
    surface = closed_surface(np.linalg.norm(grid(24, 1.0), axis=-1) - 20.0, np.full(3, -24.0), 1.0, most=most)
    mesh = as_trimesh(surface)
    assert mesh.is_watertight and mesh.euler_number == 2 and len(surface.triangles) <= (most or 10**6)
    assert len(TriangleTree(surface.vertices, surface.triangles).self_crossings()) == 0
    assert abs(np.linalg.norm(surface.vertices, axis=1) - 20.0).max() < 0.1
    assert mesh.volume == pytest.approx(BALL * 20**3, rel=0.02)


def test_envelope_of_a_ball_is_the_ball():
    surface = closed_envelope([ball((3, -2, 1), 20.0)], closing=5.0, spacing=1.5)
    mesh = as_trimesh(surface)
    assert mesh.is_watertight and mesh.euler_number == 2
    radius = np.linalg.norm(surface.vertices - [3, -2, 1], axis=1)
    assert abs(radius - 20.0).max() < 0.6 and mesh.volume == pytest.approx(BALL * 20**3, rel=0.03)


def test_envelope_inflates_and_keeps_clear():
    surface = closed_envelope([ball((0, 0, 0), 20.0)], closing=5.0, spacing=1.5, inflate=2.0)
    assert abs(np.linalg.norm(surface.vertices, axis=1) - 22.0).max() < 0.6
    skin = ball((6, 0, 0), 20.0)
    cut = closed_envelope([ball((0, 0, 0), 20.0)], closing=5.0, spacing=1.5, within=skin, clearance=2.0)
    # The lens of a ball of 20 and one of 18 whose centres are 6 apart; the skin reaches out of the ball's grid.
    assert SignedDistance(skin)(cut.vertices)[0].max() < -1.8
    assert np.linalg.norm(cut.vertices, axis=1).max() < 20.6
    assert as_trimesh(cut).is_watertight and as_trimesh(cut).volume < BALL * 18**3


@pytest.mark.parametrize(("gap", "bridged"), [(4.0, True), (8.0, True), (17.0, False), (30.0, False)])
def test_closing_bridges_narrow_gaps_between_two_balls(gap, bridged):
    """Balls of 20 mm and a closing of 9: the bridge's neck has radius sqrt(29² - (20 + gap/2)²) - 9 if positive."""
    neck = 29.0**2 - (20.0 + gap / 2) ** 2
    assert bridged == (neck > 9.0**2)
    surface = closed_envelope([ball((0, 0, 0), 20.0), ball((40 + gap, 0, 0), 20.0)], closing=9.0, spacing=1.5)
    volume = as_trimesh(surface).volume
    assert as_trimesh(surface).is_watertight
    assert (volume > 1.5 * BALL * 20**3) == bridged
    if bridged:
        middle = surface.vertices[np.abs(surface.vertices[:, 0] - 20 - gap / 2) < 1.0]
        assert np.linalg.norm(middle[:, 1:], axis=1).mean() == pytest.approx(np.sqrt(neck) - 9.0, abs=1.0)


def test_cavity_with_an_opening_is_filled_where_a_ball_does_not_pass():
    """A bowl with an opening of 12 mm radius, in a sphere of 40 mm."""
    sphere = ball((0, 0, 0), 40.0, 24)
    up = sphere.vertices[sphere.triangles].mean(axis=1)[:, 1]
    bowl = keep_triangles(sphere, up < np.sqrt(40.0**2 - 12.0**2))
    filled = closed_envelope([bowl], closing=5.0, spacing=1.5, cavity=20.0)
    assert as_trimesh(filled).volume > 0.95 * BALL * 40**3
    wide = closed_envelope([bowl], closing=5.0, spacing=1.5, cavity=8.0)
    assert as_trimesh(wide).volume < 0.2 * BALL * 40**3


def test_connectors_between_spheres_and_where_there_is_no_bone():
    skin = ball((0, 0, 0), 30.0)
    normals = skin.vertex_normals
    bone = ball((0, 15, 0), 10.0, 20)
    connectors, found = find_connectors(skin, normals, -normals, bone)
    assert np.isnan(connectors[~found]).all() and 0 < found.sum() < len(found)
    tips = skin.vertices[found] + connectors[found]
    assert abs(np.linalg.norm(tips - [0, 15, 0], axis=1) - 10.0).max() < 0.15
    # The way in passes the skin's centre: |t n - c| = 10 with t = 30 - length.
    along = normals[found] @ [0.0, 15.0, 0.0]
    length = 30.0 - along - np.sqrt(np.maximum(along**2 - 225.0 + 100.0, 0.0))
    np.testing.assert_allclose(np.linalg.norm(connectors[found], axis=1), length, atol=0.5)
    # Outward directions fail, and the normals stand in for them.
    again, same = find_connectors(skin, normals, normals, bone)
    np.testing.assert_array_equal(same, found)
    np.testing.assert_allclose(again[found], connectors[found], atol=1e-9)
    assert not find_connectors(skin, normals, -normals, bone, longest=3.0)[1].any()


@pytest.fixture(scope="module")
def bones(data):
    path = data / "bodyparts3d_head.npz"
    if not path.is_file():
        pytest.skip(f"no bones and muscles at {path}")
    return bodyparts.load(path)


@pytest.fixture(scope="module")
def space(data):
    return identities.ICTFaceKit(data / "ict_facekit.npz")


@pytest.fixture(scope="module")
def placed(bones, space):
    return place(bones, space.mean, space.parts)


@pytest.fixture(scope="module")
def skull(placed, space):
    return skull_surface(placed.anatomy, space.mean, policy=EnvelopePolicy(spacing=2.0))


def test_bodyparts_hold_a_skull_with_28_teeth_and_muscles(bones):
    assert bones.eyes[0, 0] > 25 and bones.eyes[1, 0] < -25
    assert len(bones.muscles) == 59 and "Zygomatic Maj. L" in bones.muscles
    assert 0 < bones.eyes[0, 1] - bones.bite[1] < 80 and bones.mandible.vertices[:, 1].max() < bones.eyes[0, 1]
    shifted = bones.moved(lambda points: points + [1.0, 2.0, 3.0])
    np.testing.assert_allclose(shifted.bite - bones.bite, [1, 2, 3])
    np.testing.assert_allclose(
        shifted.muscles["Procerus R"].vertices[0] - bones.muscles["Procerus R"].vertices[0], [1, 2, 3]
    )


def test_skin_without_pockets_is_closed_and_holds_the_mouth(space):
    outer = close_pockets(space.mean, space.parts)
    assert as_trimesh(outer).is_watertight
    bag = space.mean.vertices[space.parts == MOUTH]
    assert (SignedDistance(outer)(bag)[0] < 1.0).all()
    assert as_trimesh(outer).volume > as_trimesh(space.mean).volume + 5e4


def test_placed_bone_has_published_depth(placed):
    """Published means are met within a quarter, about one standard deviation, over most bone that faces the skin."""
    before, after = placed.aligned, placed.warped
    ratio = (after.depth / after.wanted)[after.near_skin]
    assert np.mean(np.abs(ratio - 1) < 0.25) > 0.8
    assert np.mean(ratio < POLICY.thickest + 0.2) > 0.8
    error = [np.median(np.abs(d.depth - d.wanted)[d.near_skin]) for d in (before, after)]
    assert error[1] < 1.0 < 3.0 < error[0]


def test_placed_anatomy_lies_inside_and_its_joints_are_open(placed, space):
    anatomy = placed.anatomy
    phi = SignedDistance(close_pockets(space.mean, space.parts))
    mouth = space.mean.vertices[space.parts == MOUTH]
    front = mouth[:, 2].max() - 15.0
    for bone in (anatomy.cranium, anatomy.mandible):
        # Between the lips the surface without pockets is a lid, not skin: the incisors reach it.
        behind = (bone.vertices[:, 2] < front) | (np.abs(bone.vertices[:, 1] - anatomy.bite[1]) > 15.0)
        assert phi(bone.vertices[behind])[0].max() < -1.0
    for muscle in anatomy.muscles.values():
        assert phi(muscle.vertices)[0].max() < -1.2
        assert muscle.vertices[:, 1].min() > space.mean.vertices[:, 1].min()
    jaw = anatomy.mandible.vertices
    condyles = jaw[(jaw[:, 2] < jaw[:, 2].min() + 25.0) & (jaw[:, 1] > jaw[:, 1].max() - 20.0)]
    cranium = TriangleTree(anatomy.cranium.vertices, anatomy.cranium.triangles)
    assert cranium.closest(condyles)[2].min() > 1.0


def test_placed_skull_agrees_with_the_kit_s_own_teeth(placed, data):
    """ICT-FaceKit's modelled teeth, which the placement does not use, tell where the dental arch belongs."""
    kit = np.load(data / "ict_facekit.npz")
    which = kit["part_names"].tolist().index("teeth")
    teeth = 10.0 * kit["vertices"][kit["vertex_part"] == which].astype(float)
    assert abs(teeth[:, 2].max() - placed.anatomy.bite[2]) < 4.0
    assert abs(np.median(teeth[:, 1]) - placed.anatomy.bite[1]) < 6.0


def test_surfaces_of_the_placed_anatomy(placed, space, skull):
    muscle = muscle_surface(placed.anatomy, space.mean, skull, policy=EnvelopePolicy(spacing=2.0))
    phi = SignedDistance(space.mean)
    for surface, clearance in ((skull, 1.5), (muscle, 1.0)):
        assert as_trimesh(surface).is_watertight and as_trimesh(surface).body_count == 1
        assert len(surface.triangles) <= 40_000
        # The kit's neutral lips cross each other at their corners, where single vertices find no inside.
        distance = phi(surface.vertices)[0]
        assert np.mean(distance < -0.9 * clearance) > 0.999 and distance.max() < 1.0
    assert 1.8e6 < as_trimesh(skull).volume < as_trimesh(muscle).volume < as_trimesh(space.mean).volume
    assert np.mean(SignedDistance(muscle)(skull.vertices)[0] < 0.1) > 0.98
    bone = bone_at(placed.anatomy, skull.vertices)
    assert (np.bincount(bone, minlength=3) > 200).all()
    assert skull.vertices[bone == MANDIBLE][:, 1].max() < placed.anatomy.eyes[0, 1]
    assert bone_at(placed.anatomy, placed.anatomy.cranium.vertices[:5]).tolist() == [CRANIUM] * 5
    assert bone_at(placed.anatomy, np.array([[0.0, 0.0, 500.0]])).tolist() == [FREE]


def test_connectors_of_the_visible_skin_reach_the_skull(placed, space, skull):
    skin = space.mean
    normals = skin.vertex_normals
    connectors, found = find_connectors(skin, normals, -normals, skull)
    scalp = (space.parts == OUTSIDE) & (skin.vertices[:, 1] > placed.anatomy.eyes[0, 1] + 30.0)
    assert found[scalp].mean() > 0.95
    length = np.linalg.norm(connectors[found & scalp], axis=1)
    assert 3.0 < np.median(length) < 8.0
