"""The values of the homogeneous problems from one-dimensional equations, and the meshes that problems are posed on."""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

from softdeca.reference import Scene, solve
from softdeca.reference.problems import bars, meshes
from softdeca.reference.problems.homogeneous import (
    COMPRESSED_DENSITIES,
    LIMIT,
    LIMITED_ROW,
    NEO_HOOKEAN_ROWS,
    STRAIN_ROWS,
)
from softdeca.reference.terms import Strain


def neo_hookean_stresses(loaded_stretch, free_stretch, loaded):
    """Nominal stresses dpsi/dstretch of the loaded and the free axes for E = 1, nu = .45."""
    mu, lmbda = 1 / 2.9, 0.45 / (1.45 * 0.1)
    free = 3 - loaded
    log_J = loaded * np.log(loaded_stretch) + free * np.log(free_stretch)
    return [mu * (s - 1 / s) + lmbda * log_J / s for s in (loaded_stretch, free_stretch)]


@pytest.mark.parametrize("row", NEO_HOOKEAN_ROWS, ids=lambda row: f"{row.label} {row.stretch}")
def test_neo_hookean_rows(row):
    free = brentq(lambda s: neo_hookean_stresses(row.stretch, s, row.loaded)[1], 0.1, 3.0, xtol=1e-14)
    assert free == pytest.approx(row.free_stretch, abs=1e-10)
    assert neo_hookean_stresses(row.stretch, free, row.loaded)[0] == pytest.approx(row.stress, abs=1e-10)


def volume_distance(stretch, lateral):
    """The squared distance of diag(stretch, lateral, lateral) to the unimodular matrices that are symmetric alike."""
    return minimize_scalar(
        lambda s: (s**-2 - stretch) ** 2 + 2 * (s - lateral) ** 2,
        bounds=(0.3, 2.5),
        method="bounded",
        options={"xatol": 1e-13},
    ).fun


def strain_density(stretch, volume_stiffness):
    """The density at its best lateral stretch, and that stretch."""
    best = minimize_scalar(
        lambda lateral: ((stretch - 1) ** 2 + 2 * (lateral - 1) ** 2) / 2
        + volume_stiffness / 2 * volume_distance(stretch, lateral),
        bounds=(0.4, 2.0),
        method="bounded",
        options={"xatol": 1e-12},
    )
    return best.fun, best.x


@pytest.mark.parametrize("row", STRAIN_ROWS, ids=lambda row: f"{row.label} {row.stretch}")
def test_strain_rows(row):
    volume_stiffness = 10.0 if "Volume" in row.label else 0.0
    assert strain_density(row.stretch, volume_stiffness)[1] == pytest.approx(row.free_stretch, abs=1e-6)
    h = 1e-3
    slope = strain_density(row.stretch + h, volume_stiffness)[0] - strain_density(row.stretch - h, volume_stiffness)[0]
    assert slope / (2 * h) == pytest.approx(row.stress, abs=3e-6)
    for compressed, density in COMPRESSED_DENSITIES:
        if compressed is row:
            assert strain_density(row.stretch, volume_stiffness)[0] == pytest.approx(density, abs=1e-7)


def test_limited_row():
    """A stretch beyond the limit is projected to it, so stress is stiffness times the rest."""
    assert LIMITED_ROW.stress == pytest.approx(LIMITED_ROW.stretch - LIMIT)


def test_weights_of_the_bars():
    """The weight is rho g times the volume, and the pull F/A: 9810 N/m² on 1/16 m², a tenth of 1/16."""
    assert bars.self_weight().loads().sum(axis=0) == pytest.approx([9810 / 16, 0, 0])
    assert bars.layers(10.0).loads().sum(axis=0) == pytest.approx([0.1 / 16, 0, 0])


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


def test_unstructured_is_unstructured():
    X, tets = meshes.unstructured(3)
    volumes = Scene(X, tets, []).volumes
    assert volumes.max() > 1.5 * volumes.min()


def test_rest_is_the_answer_without_loads():
    X, tets = meshes.block(2)
    solution = solve(Scene(X, tets, [Strain(1.0)]), solver="skfem")
    assert solution.converged
    assert solution.iterations == 0
