"""Quadratic elements: nodes on edges, what is held, consistent loads, derivatives, exact quadratic fields."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

pytest.importorskip("dolfinx")

from softdeca.reference import Scene, SceneError, materials, prepare, solve, terms
from softdeca.reference.fenicsx.loads import dead_loads
from softdeca.reference.fenicsx.numbering import Numbering
from softdeca.reference.fenicsx.problem import Problem
from softdeca.reference.problems import meshes

SOFT = terms.Hyperelastic(materials.NeoHookean.from_young(1.0, 0.3))
LAWS = {
    "neo-Hookean": [SOFT],
    "projective": [terms.Strain(2.0), terms.Volume(5.0, target=1.1)],
    "corotated and Mooney-Rivlin": [
        terms.Hyperelastic(materials.Corotated(1.0, 2.0)),
        terms.Hyperelastic(materials.MooneyRivlin(0.3, 0.1, 2.0, 0.1)),
    ],
}


def test_numbering():
    """Nodes lie where dolfinx has them, one per vertex and edge; faces find those on their sides."""
    X, tets = meshes.unstructured(2)
    order = Numbering(Scene(X, tets, []), 2)
    assert np.allclose(order.X, order.space.tabulate_dof_coordinates(), atol=1e-14)
    edges = np.unique(np.sort(tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2), axis=1), axis=0)
    assert len(order.X) == len(X) + len(edges)
    assert np.array_equal(order.X[order.dof], X)
    triangles = meshes.boundary_triangles(tets)
    nodes = order.face_dofs("faces", triangles)
    corners = X[triangles]
    for a in range(3):
        assert np.allclose(order.X[nodes[:, a]], corners[:, a])
        assert np.allclose(order.X[nodes[:, 3 + a]], (corners.sum(axis=1) - corners[:, a]) / 2)
    with pytest.raises(SceneError, match="faces: triangle 0 is no face of a tet"):
        order.face_dofs("faces", np.array([[0, 1, 26]]))


def test_what_is_held():
    """All of a clamped face; not the edge through the inside of a corner's tet that joins two held faces."""
    X, tets = meshes.block(1)
    order = Numbering(Scene(X, tets, []), 2)
    held = np.zeros(X.shape, dtype=bool)
    held[X[:, 0] == 0] = True
    held[X[:, 1] == 0, 1] = True
    nodes = order.held(held)
    assert np.array_equal(nodes[:, 0], order.X[:, 0] == 0)
    assert np.array_equal(nodes[:, 1], (order.X[:, 0] == 0) | (order.X[:, 1] == 0))
    nodes = order.held(np.ones(X.shape, dtype=bool))
    inner = (order.X == 0.5).all(axis=1)
    assert inner.sum() == 1
    assert np.array_equal(nodes, np.repeat(~inner[:, None], 3, axis=1))


def test_loads_integrate_quadratic_fields():
    """The work of gravity and traction on u = x² e: integrals of x², 1/3 over the cube and the face."""
    X, tets = meshes.unstructured(2)
    face = meshes.triangles_at(X, tets, 2, 1.0)
    order = Numbering(Scene(X, tets, []), 2)
    gravity = Scene(X, tets, [terms.Gravity((0, 0, -3.0), density=2.0)])
    traction = Scene(X, tets, [terms.Traction(face, (0.5, 0.0, 4.0))])
    squares = order.X[:, 0] ** 2
    assert squares @ dead_loads(gravity, order) == pytest.approx([0, 0, -2.0], abs=1e-13)
    assert squares @ dead_loads(traction, order) == pytest.approx([0.5 / 3, 0, 4.0 / 3], abs=1e-13)


def loaded_bar(energies):
    X, tets = meshes.box((3, 1, 1), (3.0, 1.0, 1.0))
    end = meshes.vertices_at(X, 0, 3.0)
    skin = meshes.boundary_triangles(tets)
    others = [
        terms.SurfaceStrain(skin, np.linspace(1.0, 2.0, len(skin)), growth=1.1, rest=X * [1.0, 1.1, 0.9]),
        terms.Target(end, X[end] + [0.2, 0.3, 0.1], 0.7),
        terms.Fixed(meshes.vertices_at(X, 0, 0.0)),
        terms.Gravity((0, -1.0, 0.2), density=0.05),
    ]
    return Scene(X, tets, [*energies, *others])


def csr(matrix):
    indptr, indices, values = matrix.getValuesCSR()
    return csr_matrix((values.copy(), indices.copy(), indptr.copy()), shape=matrix.size)


@pytest.mark.parametrize("law", LAWS)
def test_gradient_and_hessian_are_derivatives(law):
    scene = loaded_bar(LAWS[law])
    problem = Problem(scene, Numbering(scene, 2))
    u, d = np.random.default_rng(0).normal(size=(2, *problem.numbering.X.shape)) * [[[0.02]], [[1.0]]]
    h = 1e-4

    def differences(f):
        return (8 * (f(u + h * d) - f(u - h * d)) - (f(u + 2 * h * d) - f(u - 2 * h * d))) / (12 * h)

    slope = float(np.sum(problem.at(u).gradient() * d))
    assert abs(differences(lambda v: problem.at(v).energy) - slope) < 1e-7 * abs(slope)
    matrix = csr(problem.at(u).hessian())
    change = differences(lambda v: problem.at(v).gradient()).ravel()
    assert np.abs(matrix @ d.ravel() - change).max() < 1e-6 * np.abs(change).max()
    projected = csr(problem.at(u).softened_hessian(0.0)).toarray()
    assert np.linalg.eigvalsh(projected).min() > -1e-10 * np.abs(projected).max()


def test_a_membrane_is_that_of_its_quadratic_triangles():
    """An affine motion costs what linear triangles cost; a bump between vertices, unseen by those, more."""
    scene = loaded_bar([SOFT])
    surface = Scene(scene.vertices, scene.tets, [t for t in scene.terms if isinstance(t, terms.SurfaceStrain)])
    linear, quadratic = (Problem(surface, Numbering(surface, degree)) for degree in (1, 2))
    A = np.array([[1.1, 0.2, 0.0], [0.0, 0.9, 0.1], [0.1, 0.0, 1.2]]) - np.eye(3)
    energies = [problem.at(problem.numbering.X @ A.T).energy for problem in (linear, quadratic)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-12)
    bump = np.array(quadratic.numbering.X @ A.T)
    ends = quadratic.numbering.ends
    bump[ends[:, 0] != ends[:, 1], 1] += 0.05
    assert quadratic.at(bump).energy > energies[1] * 1.001


@pytest.mark.parametrize("linear_solver", ["cg", "mumps"])
@pytest.mark.parametrize("law", LAWS)
def test_patch(law, linear_solver):
    """V1 with quadratic elements; the volume's target is 1 here, lest rest is not at ease."""
    X, tets = meshes.unstructured(2)
    A = np.array([[1.1, 0.05, 0.0], [0.0, 0.95, 0.1], [0.02, 0.0, 1.03]])
    skin = np.unique(meshes.boundary_triangles(tets))
    energies = [terms.Strain(2.0), terms.Volume(5.0)] if law == "projective" else LAWS[law]
    scene = Scene(X, tets, [*energies, terms.Fixed(skin, X[skin] @ A.T)])
    solution = solve(scene, solver="fenicsx", element="P2", linear_solver=linear_solver, tolerance=1e-12)
    assert solution.converged, solution.reason
    assert np.abs(solution.positions - X @ A.T).max() < 1e-11


def test_a_bar_under_its_own_weight_is_quadratic():
    """Laterally held, its displacement g ρ (L x - x²/2) / (λ + 2μ) lies in the element's space, at small strain."""
    X, tets = meshes.box((3, 1, 1), (3.0, 1.0, 1.0))
    density = 1e-6
    walls = [terms.Fixed(meshes.vertices_at(X, c, end), components=c) for c in (1, 2) for end in (0.0, 1.0)]
    held = [terms.Fixed(meshes.vertices_at(X, 0, 0.0), components=0), *walls]
    scene = Scene(X, tets, [SOFT, terms.Gravity((1.0, 0, 0), density=density), *held])
    solution = solve(scene, solver="fenicsx", element="P2", tolerance=1e-10)
    law = SOFT.material
    expected = density * (3.0 * X[:, 0] - X[:, 0] ** 2 / 2) / (law.lmbda + 2 * law.mu)
    moved = solution.positions - X
    assert np.abs(moved[:, 0] - expected).max() < 1e-4 * expected.max()
    assert np.abs(moved[:, 1:]).max() < 1e-4 * expected.max()


def test_a_sequence_on_quadratic_elements():
    scene = loaded_bar([SOFT])
    prepared = prepare(scene, solver="fenicsx", element="P2")
    prepared.solve()
    (target,) = scene.of(terms.Target)
    other = scene.with_targets(target.positions + [0.1, -0.4, 0.0])
    again = prepared.solve(other, tolerance=1e-10)
    assert again.converged
    fresh = solve(other, solver="fenicsx", element="P2", tolerance=1e-10)
    assert np.abs(again.positions - fresh.positions).max() < 1e-8


@pytest.mark.parametrize("poisson", [0.4999, 0.49999])
def test_a_nearly_incompressible_block_is_solved_to_the_end(poisson):
    """By factors, whatever the usual solver is: CG's steps creep there."""
    X, tets = meshes.box((3, 3, 3))
    low, high = (meshes.vertices_at(X, 2, at) for at in (0.0, 1.0))
    law = terms.Hyperelastic(materials.NeoHookean.from_young(10.0, poisson))
    scene = Scene(X, tets, [law, terms.Fixed(low), terms.Fixed(high, X[high] + [0.1, 0.05, 0.2])])
    answer = solve(scene, solver="fenicsx", element="P2", tolerance=1e-9)
    assert answer.converged and answer.iterations < 40
    assert answer.detail["linear_iterations"] == answer.detail["linear_solves"]
    other = solve(scene, solver="skfem", element="P2", start=answer.positions, tolerance=1e-9)
    assert other.converged and np.abs(other.positions - answer.positions).max() < 1e-6
