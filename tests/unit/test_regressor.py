"""The depth regressor: its algebra, the rays that measure depths, the prior, and what it refuses."""

import numpy as np
import pytest
import trimesh
from scipy.sparse import csr_matrix

from softdeca.lhm import Surface, identities, load_template
from softdeca.lhm.base.geometry.bvh import TriangleTree
from softdeca.lhm.base.geometry.rays import first_hits
from softdeca.lhm.template.depths.depths import DepthPairs, DepthRegressor, _leave_one_out
from softdeca.lhm.template.depths.pairs import inward_normals, measure_depths, move_wrap, read_pairs
from softdeca.lhm.template.depths.prior import default_regressor
from softdeca.lhm.template.registration import Registration, Residual

from ..refusals import refused

BALL = trimesh.creation.icosphere(3)
UNIT, FACES = np.asarray(BALL.vertices), np.asarray(BALL.faces)


def ball(radius) -> Surface:
    return Surface(radius * UNIT, FACES)


def ellipsoids(count: int, *, noise: float) -> DepthPairs:
    """Heads of three random half axes; their depths follow from two of them, but for a factor of the whole head."""
    rng = np.random.default_rng(0)
    axes = 100 * np.exp(0.1 * rng.standard_normal((count, 3)))
    logs = np.log(8.0) + 2 * np.log(axes[:, :1] / 100) * (1 + UNIT[:, 1]) - np.log(axes[:, 2:] / 100)
    depths = np.exp(logs + noise * rng.standard_normal((count, 1)))
    return DepthPairs("ellipsoids", tuple(f"e{i}" for i in range(count)), axes[:, None] * UNIT, depths)


@pytest.fixture(scope="module")
def space():
    return identities.Anny()


@pytest.fixture(scope="module")
def template(space):
    return load_template(space)


def test_rays_meet_what_brute_force_meets():
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(300, 1, 3)) * 3 + rng.normal(size=(300, 3, 3))
    tree = TriangleTree(corners.reshape(-1, 3), np.arange(900).reshape(-1, 3))
    origins, directions = rng.normal(size=(2, 200, 3)) * [[[4.0]], [[1.0]]]
    directions[:5] = np.eye(3)[[0, 1, 2, 0, 1]]
    which, way = first_hits(tree, origins, directions, 6.0)
    for i, (origin, direction) in enumerate(zip(origins, directions, strict=True)):
        # origin + t direction = a + u (b - a) + v (c - a), solved for all triangles at once.
        a, b, c = corners.transpose(1, 0, 2)
        matrix = np.stack([b - a, c - a, np.broadcast_to(-direction, a.shape)], axis=2)
        u, v, t = np.linalg.solve(matrix, (origin - a)[..., None])[..., 0].T
        t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 6.0), t, np.inf)
        assert way[i] == pytest.approx(t.min(), rel=1e-9)
        assert which[i] == (t.argmin() if np.isfinite(t.min()) else -1)
    assert 50 < np.isfinite(way).sum() < 190


def test_no_ray_slips_through_a_closed_surface():
    """Rays from the centre to corners, along edges' planes and through their middles."""
    middles = UNIT[FACES[:, [0, 1, 1, 2, 2, 0]]].reshape(-1, 2, 3).mean(axis=1)
    directions = np.vstack([UNIT, middles])
    way = first_hits(TriangleTree(100 * UNIT, FACES), np.zeros_like(directions), directions, 200.0)[1]
    np.testing.assert_allclose(way, 100.0, rtol=1e-9)


def test_depth_between_spheres_is_the_difference_of_their_radii():
    skin = ball(100.0)
    measured = measure_depths(skin.vertices, inward_normals(skin), [ball(92.0)])
    assert measured.missed == 0
    # Flat triangles lie inside their sphere by edge² / 8 r, here up to .35 mm.
    assert 7.99 < measured.depths.min() and measured.depths.max() < 8.4


def test_where_no_ray_meets_bone_the_closest_point_counts_within_the_plausible_range():
    skin, half = ball(100.0), FACES[(UNIT[FACES][:, :, 1] > 0).all(axis=1)]
    measured = measure_depths(skin.vertices, inward_normals(skin), [Surface(92.0 * UNIT, half)])
    below, above = UNIT[:, 1] < -0.1, UNIT[:, 1] > 0.25
    assert measured.met[above].all() and not measured.met[below].any()
    assert measured.depths[below].min() > 8.0 and measured.depths.max() == 40.0
    lowest = UNIT[:, 1].argmin()
    assert measured.depths[lowest] == 40.0
    # Bone that touches the skin leaves the least depth, not none.
    assert measure_depths(skin.vertices, inward_normals(skin), [ball(99.99)]).depths.min() == 1.0


def test_a_ray_that_slips_through_a_hole_does_not_measure_the_wall_behind():
    highest = UNIT[:, 1].argmax()
    around = (FACES == highest).any(axis=1)
    skin, holed = ball(100.0), Surface(92.0 * UNIT, FACES[~around])
    measured = measure_depths(skin.vertices, inward_normals(skin), [holed, ball(62.0)])
    assert not measured.met[highest] and measured.met[UNIT[:, 1] < 0.98].all()
    # The hole's rim is one edge of 8 degrees off the axis: 8 mm below the vertex and 92 sin 8° = 13 mm beside it.
    assert 12 < measured.depths[highest] < 18


def test_the_closed_form_of_leave_one_out_is_that_of_refitting():
    rng = np.random.default_rng(1)
    shape = rng.normal(size=(12, 4)) * [5.0, 3.0, 1.0, 0.5]
    u, size, _ = np.linalg.svd(shape - shape.mean(axis=0), full_matrices=False)
    wanted, ridge = rng.normal(size=(12, 3)), 7.0
    total = 0.0
    for i in range(12):
        kept = np.arange(12) != i
        x, y = (u * size)[kept], wanted[kept]
        centre = x.mean(axis=0)
        slope = np.linalg.solve(
            (x - centre).T @ (x - centre) + ridge * np.eye(4), (x - centre).T @ (y - y.mean(axis=0))
        )
        total += ((y.mean(axis=0) + ((u * size)[i] - centre) @ slope - wanted[i]) ** 2).sum()
    assert _leave_one_out(u, size**2 / (size**2 + ridge), wanted - wanted.mean(axis=0)) == pytest.approx(
        total, rel=1e-9
    )


def test_it_is_read_as_it_was_written_and_refused_for_another_template(tmp_path):
    regressor = DepthRegressor.fit(ellipsoids(10, noise=0.1), ball(100.0))
    file = tmp_path / "d.npz"
    regressor.save(file)
    read = DepthRegressor.load(file, ball(100.0))
    assert (read.label, read.pairs, read.ridge) == ("ellipsoids", 10, regressor.ridge)
    np.testing.assert_array_equal(read.predict(90 * UNIT), regressor.predict(90 * UNIT))
    refused(r"d\.npz: depth regressor \(ellipsoids\): .*another template", DepthRegressor.load, file, ball(101.0))
    file.write_bytes(file.read_bytes()[:200])
    refused(r"d\.npz", DepthRegressor.load, file, ball(100.0))


def test_the_default_regressor_is_the_same_each_time(template, space, tmp_path, monkeypatch):
    monkeypatch.setenv("SOFTDECA_CACHE", str(tmp_path))
    made, read = default_regressor(template, space), default_regressor(template, space)
    assert made.label.startswith("synthetic prior") and "not anatomy" in made.label and made.pairs == 60
    made.check(template.skin_wrap)
    skin = space.sample(np.random.default_rng(5))[1]
    wrap = move_wrap(template, skin.vertices)
    depths = made.predict(wrap)
    np.testing.assert_array_equal(read.predict(wrap), depths)
    assert depths.shape == (4842,) and 2 < depths.min() and depths.max() < 25


def connectors(template):
    return template.head.skull_wrap.vertices - template.skin_wrap.vertices


def write(folder, name, skin, skull):
    for kind, surface in (("skin", skin), ("skull", skull)):
        if surface is not None:
            np.savez(folder / f"{name}_{kind}.npz", vertices=surface.vertices, triangles=surface.triangles)


def head(template, space, seed: int, factor: float = 1.0) -> tuple[Surface, Surface]:
    """A skin of the space and a skull wrap under it, by the template's connectors times a factor."""
    skin = space.sample(np.random.default_rng(seed))[1]
    wrap = move_wrap(template, skin.vertices)
    return skin, template.skin_wrap.with_vertices(wrap + factor * connectors(template))


@pytest.fixture
def folder(tmp_path, template, space):
    for seed in range(4):
        write(tmp_path, f"p{seed}", *head(template, space, seed, 0.7 + 0.2 * seed))
    return tmp_path


def test_depths_of_a_folder_are_those_of_its_skulls(folder, template, space):
    pairs, reports = read_pairs(folder, template, space)
    assert pairs.names == ("p0", "p1", "p2", "p3") and pairs.label == f"4 pairs from {folder}"
    known = np.linalg.norm(connectors(template), axis=1)
    assert all(r.missed < 0.05 * len(known) and r.off == 0 for r in reports)
    scalp = template.regions["face"] & (template.skin_wrap.vertices[:, 1] > 50)
    for i in range(4):
        expected = np.maximum((0.7 + 0.2 * i) * known, 1.0)
        # Smooth skin: rays and connectors go the same way; skull wrap and ray differ by its curvature.
        assert np.quantile(np.abs(pairs.depths[i] - expected)[scalp], 0.9) < 0.5


def _moved(surface, scale, shift=0.0):
    return surface.with_vertices(scale * surface.vertices + shift)


def test_skins_of_another_topology_are_registered(folder, template, space, monkeypatch):
    """A registered skin replaces the one read; a failure names the file. The registration has tests of its own."""
    skin, skull = head(template, space, 1, 0.9)
    other = Surface(skin.vertices[::-1], len(skin.vertices) - 1 - skin.triangles)
    write(folder, "p1", other, skull)

    def registered(template_skin, parts, given):
        np.testing.assert_array_equal(given.triangles, other.triangles)
        assert template_skin is space.mean and parts is space.parts
        return Registration(skin, Residual(0.25, 1.0, 2.0), csr_matrix((1, 1)), 0)

    monkeypatch.setattr("softdeca.lhm.template.depths.pairs.register", registered)
    pairs, reports = read_pairs(folder, template, space)
    np.testing.assert_allclose(pairs.wraps[1], move_wrap(template, skin.vertices))
    assert [r.off for r in reports] == [0, 0.25, 0, 0]


def test_a_folder_in_centimetres(folder, template, space):
    mm = read_pairs(folder, template, space)[0]
    for seed in range(4):
        skin, skull = head(template, space, seed, 0.7 + 0.2 * seed)
        write(folder, f"p{seed}", _moved(skin, 0.1), _moved(skull, 0.1))
    np.testing.assert_allclose(read_pairs(folder, template, space, unit="cm")[0].depths, mm.depths, atol=1e-6)
