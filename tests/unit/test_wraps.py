"""Eq. 4, the climb and the repair on spheres whose answers are known."""

import numpy as np
import pytest
import trimesh

from softdeca.lhm.base.geometry.tets import smallest_dihedrals
from softdeca.lhm.head.columns import Columns
from softdeca.lhm.template.wraps import climb, inner
from softdeca.lhm.template.wraps.skull import SkullFit


@pytest.fixture(scope="module")
def ball():
    sphere = trimesh.creation.icosphere(3)
    unit = np.asarray(sphere.vertices)
    return Columns(np.asarray(sphere.faces, dtype=np.int64), len(unit)), unit


def stacked(unit, skin, muscle, skull):
    return np.vstack([skin * unit, muscle * unit, skull * unit])


def test_a_wrap_that_is_one_point_has_normals_without_length(ball):
    columns, unit = ball
    normals, least = inner.cone_normals(columns, np.zeros_like(unit))
    assert not normals.any() and not least.any()


def test_smallest_sine_is_that_of_the_smallest_dihedral_angle():
    points, tets = np.random.default_rng(0).standard_normal((400, 3)), np.arange(400).reshape(100, 4)
    volume = np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]])
    sines = inner.sines(points, tets)
    assert (np.sign(sines) == np.sign(volume)).all()
    turned = tets.copy()
    turned[volume < 0] = tets[volume < 0][:, [0, 2, 1, 3]]
    x = points[turned]
    for k, tet in enumerate(x[:20]):
        normals = [
            np.cross(tet[b] - tet[a], tet[c] - tet[a]) for a, b, c in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))
        ]
        normals = [n / np.linalg.norm(n) for n in normals]
        expected = min(np.linalg.norm(np.cross(normals[i], normals[j])) for i in range(4) for j in range(i))
        assert inner.sines(points, turned)[k] == pytest.approx(expected, rel=1e-9)


def test_eq4_finds_the_inner_sphere_and_its_energy_falls(ball):
    columns, unit = ball
    fit = SkullFit(columns, 100.0 * unit, 90.0 * unit)
    rng = np.random.default_rng(1)
    start = 90.0 * unit + 1.0 * rng.standard_normal(unit.shape)
    skull, energies = fit.fitted(100.0 * unit, np.full(columns.n, 10.0), start)
    assert (np.diff(energies) <= 1e-9 * energies[0]).all()
    assert energies[-1] < 0.05 * energies[0]
    # Rectangles would make both triangulations alike in size, which pulls a concentric sphere outward by little.
    assert np.abs(np.linalg.norm(skull, axis=1) - 90.0).max() < 0.5


def test_eq4_follows_depths_that_grow(ball):
    columns, unit = ball
    fit = SkullFit(columns, 100.0 * unit, 90.0 * unit)
    depths = 10.0 + 3.0 * unit[:, 1]
    skull, _ = fit.fitted(100.0 * unit, depths, 90.0 * unit)
    assert np.abs(np.linalg.norm(skull - 100.0 * unit, axis=1) - depths).mean() < 0.3


def test_eq4_does_not_depend_on_where_the_head_is(ball):
    columns, unit = ball
    fit = SkullFit(columns, 100.0 * unit, 90.0 * unit)
    depths = 10.0 + 3.0 * unit[:, 1]
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    here, _ = fit.fitted(100.0 * unit, depths, 90.0 * unit)
    there, _ = fit.fitted(100.0 * unit @ turn.T + 50.0, depths, 90.0 * unit @ turn.T + 50.0)
    # The rotations of one-rings are found to a tenth of a degree in the first steps only.
    assert np.abs(there - (here @ turn.T + 50.0)).max() < 0.05


def test_climb_untangles_what_noise_inverted(ball):
    columns, unit = ball
    rng = np.random.default_rng(2)
    stack = stacked(unit, 100.0, 94.0, 90.0)
    stack[columns.n :] += 1.5 * rng.standard_normal((2 * columns.n, 3))
    assert (inner.sines(stack, columns.tets) <= 0).sum() > 5
    better = climb.improve(columns, stack, least=0.5)
    assert inner.sines(better, columns.tets).min() > 0.02
    assert np.abs(np.linalg.norm(better[: columns.n], axis=1) - 100.0).max() < 1.0


def test_valid_layers_leave_good_ones_alone(ball):
    columns, unit = ball
    stack = stacked(unit, 100.0, 94.0, 90.0)
    assert np.array_equal(inner.make_valid(columns, stack), stack)


def test_valid_layers_of_wraps_that_cross(ball):
    columns, unit = ball
    dent = np.where(unit[:, 1:2] > 0.9, -14.0, 0.0)
    stack = stacked(unit, 100.0, 94.0, 90.0)
    stack[2 * columns.n :] -= dent * unit  # the skull wrap passes through the others there
    valid = inner.make_valid(columns, stack)
    skin_pairs, pairs = inner.Crossings.from_wraps(columns, valid).find(valid)
    assert len(skin_pairs) == len(pairs) == 0
    assert smallest_dihedrals(valid, columns.tets).min() > 2.0
