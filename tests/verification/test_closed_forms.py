"""Faults of a problem that no solver could find: its derivations, and the meshes that problems are posed on."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from softdeca.reference import Scene, materials
from softdeca.reference.problems import homogeneous, incompressible, meshes
from softdeca.reference.skfem import solids as skfem
from softdeca.reference.terms import Strain


def nominal_stress(energies, stretches, axis):
    """Give the law's stress; tests/unit/test_laws.py holds the law to its formula."""
    (law,) = (term.material for term in energies)
    form = skfem.ByRotation if isinstance(law, materials.Corotated) else skfem.ByInvariants
    return form(law).stress(np.diag(np.array(stretches, dtype=float))[None])[0, axis, axis]


def free_stretch_and_stress(row, stretch):
    """The free stretch without stress along its axes, and the nominal stress, where the loaded stretch is held."""
    free = 3 - row.loaded - row.confined

    def stretches(s):
        return [stretch] * row.loaded + [1.0] * row.confined + [s] * free

    found = brentq(lambda s: nominal_stress(row.energies, stretches(s), 2), 0.15, 1.6, xtol=1e-15, rtol=1e-15)
    return found, nominal_stress(row.energies, stretches(found), 0)


@pytest.mark.parametrize("row", homogeneous.SOLVED_ROWS, ids=lambda row: f"{row.label} {row.stretch}")
def test_solved_rows(row):
    assert free_stretch_and_stress(row, row.stretch) == pytest.approx((row.free_stretch, row.stress), abs=1e-9)


def gradient(motion, X, h=1e-6):
    """F of a motion at one place, by central differences."""
    return np.stack([(motion(X + d)[0] - motion(X - d)[0]) / (2 * h) for d in h * np.eye(3)[:, None]], axis=1)


def test_the_bent_block_keeps_volume_and_its_curved_faces_carry_no_load():
    """The equation along r, d(sigma_rr)/dr = (sigma_tt - sigma_rr)/r, takes sigma_rr from 0 to 0 through the block."""
    for x in (-0.5, -0.1, 0.4):
        F = gradient(incompressible.bend, np.array([[x, 0.7, 0.3]]))
        assert np.linalg.det(F) == pytest.approx(1.0, abs=1e-8)
    r = [float(np.sqrt(2 * incompressible.BLOCK_RADIUS * x + incompressible.offset())) for x in (-0.5, 0.5)]

    def slope(r):
        stretch = r / incompressible.BLOCK_RADIUS
        return (stretch**2 - stretch**-2) / r

    assert quad(slope, *r)[0] == pytest.approx(0.0, abs=1e-12)

    def density(x):
        F = gradient(incompressible.bend, np.array([[x, 0.0, 0.0]]))
        return (np.sum(F * F) - 3) / 2

    assert incompressible.BLOCK_LENGTH * quad(density, -0.5, 0.5)[0] == pytest.approx(
        incompressible.energy_per_depth(), rel=1e-7
    )


@pytest.mark.parametrize("mesh", [meshes.box((3, 2, 4), (1.5, 1.0, 2.0)), meshes.unstructured(3, 1.0)])
def test_meshes(mesh):
    X, tets = mesh
    size = X.max(axis=0)
    scene = Scene(X, tets, [Strain(1.0)])
    assert scene.volumes.min() > 0
    assert scene.volumes.sum() == pytest.approx(np.prod(size), rel=1e-12)
    triangles = meshes.boundary_triangles(tets)
    a, b, c = (X[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a) / 2
    # The divergence theorem with the field x/3: outward triangles give the volume.
    assert np.einsum("ij,ij->", normals, a + b + c) / 9 == pytest.approx(np.prod(size), rel=1e-12)
    top = meshes.triangles_at(X, tets, 2, size[2])
    assert set(np.unique(top)) == set(meshes.vertices_at(X, 2, size[2]))
