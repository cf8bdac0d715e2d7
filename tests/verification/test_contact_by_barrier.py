"""Projective dynamics' contact against other code: ipctk's barrier in Newton's method over scikit-fem's energy."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.reference import Scene, solve, terms
from softdeca.reference.problems import meshes

from ..unit.test_contact import bar, solve_with_pairs, stacked, two_bars

APART = 0.01
"""[mm] The barrier's reach, within which surfaces in contact come to rest."""


def stamp_on_block():
    """A stamp is pressed down and moved sideways on a block that is stuck to its foot; and where both are held."""
    X, tets, _ = stacked(bar((6, 2, 6), (9, 3, 9), (0, 0, 0)), bar((2, 2, 2), (3, 3, 3), (2.4, 3.2, 3)))
    foot, top = np.flatnonzero(X[:, 1] == 0.0), np.flatnonzero(X[:, 1] == X[:, 1].max())
    values = np.vstack([X[foot], X[top] + [0.6, -0.9, 0]])
    fixed = terms.Fixed(np.concatenate([foot, top]), values)
    contact = terms.Contact(meshes.boundary_triangles(tets), 100.0, 0.02)
    return Scene(X, tets, [terms.Strain(5.0), terms.Volume(5.0), fixed, contact]), top


def bars_and_far_end():
    scene, _, _ = two_bars(thickness=0.05)
    return scene, np.flatnonzero(scene.vertices[:, 1] == 16.5)


@pytest.mark.parametrize("make", [bars_and_far_end, stamp_on_block])
def test_both_codes_part_surfaces_alike_in_mm_and_force(make):
    pytest.importorskip("ipctk")
    scene, pressed = make()
    by_pd = solve(scene, tolerance=1e-9)
    by_barrier = solve(scene, solver="skfem", tolerance=1e-8)
    assert by_pd.converged and by_barrier.converged and by_pd.detail["contact_crossings"] == 0
    apart = np.linalg.norm(by_pd.positions - by_barrier.positions, axis=1)
    free = solve(replace(scene, terms=scene.terms[:-1]), tolerance=1e-9)
    moved = np.linalg.norm(by_pd.positions - free.positions, axis=1).max()
    assert moved > 0.2 and apart.mean() <= APART and apart.max() <= 2.0 * APART
    forces = [solution.reactions[pressed, 1].sum() for solution in (by_pd, by_barrier)]
    assert forces[0] < -1.0 and forces[1] == pytest.approx(forces[0], rel=0.02)


def test_finite_elements_answer_alike_with_the_pairs_that_pd_found():
    """Distances, gradients and Hessians are each solver's own; from a little beside PD's answer."""
    scene, _ = stamp_on_block()
    by_pd, frozen, start, solution = solve_with_pairs(scene)
    size = np.linalg.norm(by_pd.positions - scene.vertices, axis=1).max()
    assert np.linalg.norm(solution.positions - by_pd.positions, axis=1).max() <= 1e-6 * size
    away = solve(replace(frozen, terms=frozen.terms[:-1]), solver="fenicsx", start=start, tolerance=1e-8)
    assert np.linalg.norm(away.positions - by_pd.positions, axis=1).max() > 1e-2 * size
