"""One energy, one minimiser: projective dynamics, FEniCSx and scikit-fem on a layered sphere that stands for a head."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from softdeca.lhm.head import MANDIBLE
from softdeca.reference import (
    MissingDependencyError,
    Parameters,
    Scene,
    apply_law,
    facial_scene,
    materials,
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


def largest_difference(scene, solver, other, tolerance, at_least=1.0, **options):
    """Of two solvers, with the same options, relative to the largest displacement."""
    answers = []
    for name in (solver, other):
        try:
            answers.append(solve(scene, solver=name, tolerance=tolerance, max_iterations=3000, **options))
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


BONES = {
    "free mandible": (Parameters(gravity=3.0), "rigid"),
    "free mandible, another size": (Parameters(mandible_scale_y=1.1, skin_bending=50.0), "rigid"),
    "soft bones": (Parameters(mandible_scale_z=0.9), "soft"),
}


@pytest.mark.parametrize("other", ["fenicsx", "projective"])
@pytest.mark.parametrize("name", BONES)
def test_bones_agree(sphere_head, name, other):
    """Exact unknowns of a body thrice: by exponentials, by Cayley turns, by a Schur complement."""
    parameters, bones = BONES[name]
    scene = facial_scene(sphere_head, parameters, expression(sphere_head, 15.0), bones=bones)
    assert largest_difference(scene, "skfem", other, 1e-11, at_least=10.0) < 1e-8


def moving_jaw(head):
    """A free mandible, bent surfaces and inertia in one scene."""
    scene = facial_scene(head, Parameters(gravity=2.0), expression(head, 15.0), bones="rigid")
    n, rest = len(head.bone), np.array(scene.vertices)
    rest[:n] *= 1.03
    velocities = np.tile([100.0, 0.0, 30.0], (len(rest), 1))
    more = [
        terms.SurfaceStrain(n + head.skin_wrap.triangles, 20.0, rest=1.02 * rest),
        terms.Bending(head.skin_wrap.triangles, 3e3, rest=rest),
        terms.Bending(2 * n + head.skin_wrap.triangles, np.linspace(1e3, 1e4, len(head.skin_wrap.triangles))),
        terms.Inertia(1e-6, 1 / 60, positions=rest, velocities=velocities),
    ]
    return Scene(scene.vertices, scene.tets, [*scene.terms, *more])


@pytest.mark.parametrize("other", ["fenicsx", "projective"])
def test_inertia_and_bending_agree(sphere_head, other):
    assert largest_difference(moving_jaw(sphere_head), "skfem", other, 1e-11, at_least=10.0) < 1e-8


@pytest.mark.parametrize(("element", "subdivisions"), [("P1", 2), ("P2", 1)])
def test_energy_gradient_and_hessian_agree_far_from_rest(spheres, element, subdivisions):
    """At one disturbed state; every Hessian by its products with the same changes of the unknowns."""
    pytest.importorskip("dolfinx")
    from softdeca.reference.fenicsx.bodies import RigidProblem
    from softdeca.reference.fenicsx.numbering import Numbering
    from softdeca.reference.fenicsx.problem import Problem
    from softdeca.reference.fenicsx.scope import DEGREE_OF
    from softdeca.reference.skfem.discretisation import Discretisation
    from softdeca.reference.skfem.energy import Energy
    from softdeca.reference.skfem.unknowns import Body, Unknowns

    scene = moving_jaw(spheres(subdivisions))
    at = Discretisation(scene, element)
    energy, bodies = Energy(scene, at), Body.from_scene(scene, at)
    rng = np.random.default_rng(4)
    flat = at.by_dof(scene.vertices) + rng.normal(0.0, 0.5, at.size)
    pose = Rotation.from_rotvec([0.4, -0.2, 0.1])
    flat[bodies[0].dofs] = pose.apply(bodies[0].rest) + [1.0, -6.0, 2.0]
    loose = np.flatnonzero(~np.isin(at.dofs[:, 0], bodies[0].dofs))
    unknowns = Unknowns(at.dofs[loose].ravel(), at.size, bodies)
    forces = energy.gradient(flat)

    order = Numbering(scene, DEGREE_OF[element])
    theirs, ours = (np.lexsort(ends.T) for ends in (order.ends, at.ends))
    assert np.array_equal(order.ends[theirs], at.ends[ours])
    node = np.empty_like(theirs)  # FEniCSx' by scikit-fem's
    node[ours] = theirs
    x = np.empty_like(order.X)
    x[node] = flat[at.dofs]
    problem = RigidProblem(scene, order, Problem(scene, order))
    state = problem.at(x - order.X, problem.nearest(x))
    assert state.energy == pytest.approx(energy.value(flat), rel=1e-12)

    # FEniCSx' unknowns by block of three in the order of scikit-fem's here: loose nodes, translation, turn.
    block = np.concatenate([np.searchsorted(problem.free, node[loose]), len(loose) + np.arange(2)])
    expected = unknowns.gradient(flat, forces).reshape(-1, 3)
    np.testing.assert_allclose(state.gradient()[block], expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())
    hessian = unknowns.hessian(flat, forces, energy.exact_hessian(flat))
    changes = rng.normal(size=(len(block), 3, 4))
    indptr, columns, values = state.hessian().getValuesCSR()
    by_node = np.empty_like(changes)
    by_node[block] = changes
    found = csr_matrix((values, columns, indptr)) @ by_node.reshape(-1, 4)
    expected = (hessian @ changes.reshape(-1, 4)).reshape(changes.shape)
    found = found.reshape(changes.shape)[block]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())


QUADRATIC = {
    "limited strain": lambda head: facial_scene(head, CASES["limited strain"][0], expression(head, 5.0)),
    "neo-Hookean": lambda head: apply_law(
        facial_scene(head, Parameters(gravity=2.0), expression(head, 15.0)), "neo-Hookean"
    ),
    "moving jaw": moving_jaw,
}


@pytest.mark.parametrize("name", QUADRATIC)
def test_quadratic_elements_agree(spheres, name):
    """With laws at fourteen points of a tet and skin at six of a triangle, by each solver's own tables."""
    scene = QUADRATIC[name](spheres(1))
    assert largest_difference(scene, "skfem", "fenicsx", 1e-11, element="P2") < 1e-8


@pytest.mark.parametrize("name", ["corotated", "Mooney-Rivlin"])
def test_laws_agree_on_quadratic_elements(name):
    scene = sheared_block(LAWS[name])
    assert largest_difference(scene, "skfem", "fenicsx", 1e-11, at_least=0.5, element="P2") < 1e-8


@pytest.mark.parametrize("jaw", [0.0, 15.0])
def test_neo_hookean_agrees(sphere_head, jaw):
    scene = apply_law(facial_scene(sphere_head, Parameters(gravity=2.0), expression(sphere_head, jaw)), "neo-Hookean")
    assert largest_difference(scene, "skfem", "fenicsx", 1e-11) < 1e-8


def test_free_mandible_follows_a_cranium_that_turns_in_load_steps(sphere_head):
    """By 20° at once a neo-Hookean tet would be inverted: the body is held until the cranium has arrived."""
    expressed = expression(sphere_head, 15.0)
    scene = apply_law(facial_scene(sphere_head, Parameters(), expressed, bones="rigid"), "neo-Hookean")
    cranium = scene.of(terms.Fixed)[0].values
    turned = scene.with_fixed(Rotation.from_euler("y", 20.0, degrees=True).apply(cranium) + [0.0, 0.0, 7.0])
    assert largest_difference(turned, "skfem", "fenicsx", 1e-10, at_least=20.0) < 1e-8


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
