"""Surfaces that bend and stretch to another rest shape by projective dynamics, without any tets."""

import numpy as np
import pytest

from softdeca.reference import Scene, prepare, solve, terms
from softdeca.reference.problems import meshes


def rolled_sheet(radius, membrane, bending):
    """A flat unit square whose border is held on a cylinder about an axis along y, which its terms seek; that shape."""
    points, tets = meshes.box((12, 6, 1))
    lower = meshes.vertices_at(points, 2, 0.0)
    triangles = np.searchsorted(lower, meshes.triangles_at(points, tets, 2, 0.0))
    X = points[lower]
    angle = X[:, 0] / radius
    rest = np.column_stack([radius * np.sin(angle), X[:, 1], radius * (1 - np.cos(angle))])
    border = np.flatnonzero(((X[:, :2] == 0.0) | (X[:, :2] == 1.0)).any(axis=1))
    elastic = [terms.SurfaceStrain(triangles, membrane, rest=rest), terms.Bending(triangles, bending, rest=rest)]
    return Scene(X, np.zeros((0, 4), dtype=int), [*elastic, terms.Fixed(border, rest[border])]), rest


def test_a_flat_sheet_takes_another_rest_shape():
    """It is reached, the energy falling throughout."""
    scene, rest = rolled_sheet(0.5, 10.0, 0.5)
    solution = solve(scene, tolerance=1e-10)
    assert solution.converged
    assert (np.diff(solution.history.energy) <= 1e-13 * solution.history.energy[0]).all()
    assert solution.energy == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(solution.positions, rest, atol=1e-6)


def test_plain_steps_are_safeguarded():
    """On a cylinder so narrow that rings turn far, plain local/global steps would raise the energy again and again."""
    scene, _ = rolled_sheet(0.2, 1.0, 5.0)
    solution = prepare(scene, method="plain").solve(tolerance=1e-6, max_iterations=200)
    assert (np.diff(solution.history.energy) <= 1e-13 * solution.history.energy[0]).all()
