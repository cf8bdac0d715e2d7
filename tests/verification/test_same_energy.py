"""One energy, one minimiser: projective dynamics, FEniCSx and scikit-fem on a layered sphere that stands for a head."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.lhm.head import MANDIBLE
from softdeca.reference import (
    MissingDependencyError,
    Parameters,
    Scene,
    facial_scene,
    materials,
    neo_hookean_scene,
    solve,
    terms,
)
from softdeca.reference.problems import meshes

CASES = {
    "smile and gravity": (Parameters(gravity=3.0), 0.0),
    "jaw open": (Parameters(), 15.0),
    "near-incompressible": (Parameters(volume_ratio=75.0), 5.0),
    "swollen": (Parameters(soft_volume=1.3, target_stiffness=1.0), 0.0),
    "limited strain": (Parameters(strain_limit=1.1, skin_growth=1.2), 5.0),
}


LAWS = {
    "neo-Hookean": materials.NeoHookean.from_young(15.0, 0.45),
    "stable neo-Hookean": materials.StableNeoHookean.from_young(15.0, 0.45),
    "corotated": materials.Corotated.from_young(15.0, 0.45),
    "St. Venant-Kirchhoff": materials.StVenantKirchhoff.from_young(15.0, 0.3),
    "isochoric, quadratic": materials.IsochoricNeoHookean.from_young(15.0, 0.45),
    "isochoric, logarithmic": materials.IsochoricNeoHookean.from_young(15.0, 0.45, "kappa/4 (J^2-1-2 ln J)"),
    "Mooney-Rivlin": materials.MooneyRivlin(1.5, 1.0, 50.0, C20=0.7),
    "face": materials.tissues.FACE,
}


def expression(head, jaw_degrees):
    """The skin [mm] with one cheek pulled, and all over the mandible turned about an axis from ear to ear."""
    X = np.array(head.skin.vertices)  # some releases of scipy refuse read-only points
    cheek = np.exp(-np.sum((X - [60.0, 0.0, 70.0]) ** 2, axis=1) / (2 * 40.0**2))
    turned = Rotation.from_euler("x", jaw_degrees, degrees=True).apply(X)
    share = np.clip((-X[:, 1] - 20.0) / 40.0, 0.0, 1.0)
    assert (share[head.bone == MANDIBLE] == 1.0).all()
    return X + cheek[:, None] * [3.0, 8.0, -2.0] + share[:, None] * (turned - X)


def largest_difference(scene, solver, other, tolerance, at_least=1.0):
    """Of two solvers, relative to the largest displacement."""
    answers = []
    for name in (solver, other):
        try:
            answers.append(solve(scene, solver=name, tolerance=tolerance, max_iterations=3000))
        except MissingDependencyError as missing:
            pytest.skip(str(missing))
    assert all(answer.converged for answer in answers), [str(answer.reason) for answer in answers]
    moved = np.linalg.norm(answers[1].positions - scene.vertices, axis=1).max()
    assert moved > at_least
    return np.linalg.norm(answers[0].positions - answers[1].positions, axis=1).max() / moved


@pytest.mark.parametrize("name", CASES)
def test_skfem_and_fenicsx_agree(sphere_head, name):
    parameters, jaw = CASES[name]
    scene = facial_scene(sphere_head, parameters, expression(sphere_head, jaw))
    assert largest_difference(scene, "skfem", "fenicsx", 1e-11) < 1e-8


@pytest.mark.parametrize("name", CASES)
def test_projective_and_skfem_agree(sphere_head, name):
    parameters, jaw = CASES[name]
    scene = facial_scene(sphere_head, parameters, expression(sphere_head, jaw))
    assert largest_difference(scene, "projective", "skfem", 1e-11) < 1e-8


@pytest.mark.parametrize("jaw", [0.0, 15.0])
def test_neo_hookean_agrees(sphere_head, jaw):
    scene = neo_hookean_scene(facial_scene(sphere_head, Parameters(gravity=2.0), expression(sphere_head, jaw)))
    assert largest_difference(scene, "skfem", "fenicsx", 1e-11) < 1e-8


def sheared_block(law):
    """A cube of 2 mm, neo-Hookean below and `law` above, pulled at one side, its top moved sideways and up."""
    X, tets = meshes.unstructured(3, 2.0)
    lower = np.flatnonzero(X[tets, 2].mean(axis=1) < 1.0)
    upper = np.setdiff1d(np.arange(len(tets)), lower)
    top = meshes.vertices_at(X, 2, 2.0)
    return Scene(
        X,
        tets,
        [
            terms.Hyperelastic(materials.NeoHookean.from_young(15.0, 0.4), tets=lower),
            terms.Hyperelastic(law, tets=upper),
            terms.Fixed(meshes.vertices_at(X, 2, 0.0)),
            terms.Fixed(top, X[top] + [0.5, 0.0, 0.3]),
            terms.Traction(meshes.triangles_at(X, tets, 1, 2.0), (0.0, 1.5, 0.0)),
        ],
    )


@pytest.mark.parametrize("name", LAWS)
def test_laws_agree(name):
    """FEniCSx derives a law from its density; scikit-fem has its derivatives written by hand."""
    assert largest_difference(sheared_block(LAWS[name]), "skfem", "fenicsx", 1e-11, at_least=0.5) < 1e-8


def test_laws_add_up_where_they_share_tets():
    """Laws by UFL, laws of the singular values and PD's energies on the same tets, all of them or some."""
    scene = sheared_block(materials.StableNeoHookean.from_young(5.0, 0.4))
    some = np.arange(0, len(scene.tets), 3)
    shared = [
        terms.Hyperelastic(materials.MooneyRivlin(1.0, 0.5, 20.0), tets=some[::-1]),
        terms.Hyperelastic(materials.Corotated.from_young(3.0, 0.3), tets=some[1:]),
        terms.Strain(2.0),
    ]
    mixed = Scene(scene.vertices, scene.tets, [*scene.terms, *shared])
    assert largest_difference(mixed, "skfem", "fenicsx", 1e-11, at_least=0.5) < 1e-8
