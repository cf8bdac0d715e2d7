"""The FEniCSx solver through the public entry: patch test, closed forms, numbering, linear solvers, refusals."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.sparse import csr_matrix

pytest.importorskip("dolfinx")

from softdeca.lhm.base.errors import MissingDependencyError
from softdeca.reference import Reason, Scene, SceneError, materials, prepare, solve, terms
from softdeca.reference.fenicsx.dolfinx_version import parse_version
from softdeca.reference.fenicsx.loads import dead_loads
from softdeca.reference.fenicsx.numbering import Numbering
from softdeca.reference.fenicsx.problem import Problem
from softdeca.reference.problems import meshes

NEO_HOOKE = terms.Hyperelastic(materials.NeoHookean.from_young(1.0, 0.45))
SOFT = terms.Hyperelastic(materials.NeoHookean.from_young(1.0, 0.3))


def rollers(X, axis_lengths=None):
    """Symmetry planes x = y = z = 0, and the far faces of the axes in `axis_lengths` moved there."""
    held = [terms.Fixed(X[:, c] == 0, components=c) for c in range(3)]
    for c, length in (axis_lengths or {}).items():
        face = np.flatnonzero(X[:, c] == X[:, c].max())
        values = np.array(X[face])
        values[:, c] = length
        held.append(terms.Fixed(face, values, components=c))
    return held


ENERGIES = {
    "neo-Hookean": [SOFT],
    "projective": [terms.Strain(1.0), terms.Volume(10.0)],
    "a strain limit": [terms.Strain(1.0, limit=1.02)],
    "corotated and Mooney-Rivlin": [
        terms.Hyperelastic(materials.Corotated(1.0, 2.0)),
        terms.Hyperelastic(materials.MooneyRivlin(0.3, 0.1, 2.0, 0.1)),
    ],
}


@pytest.mark.parametrize("linear_solver", ["cg", "mumps"])
@pytest.mark.parametrize("energies", ENERGIES)
@pytest.mark.parametrize("element", ["P1", "P2"])
def test_patch(element, energies, linear_solver):
    """V1: an affine motion of the boundary moves the interior alike."""
    X, tets = meshes.unstructured({"P1": 3, "P2": 2}[element])
    A = np.array([[1.1, 0.05, 0.0], [0.0, 0.95, 0.1], [0.02, 0.0, 1.03]])
    goal = X @ A.T + [0.3, -0.2, 0.1]
    skin = np.unique(meshes.boundary_triangles(tets))
    scene = Scene(X, tets, [*ENERGIES[energies], terms.Fixed(skin, goal[skin])])
    solution = solve(scene, solver="fenicsx", element=element, linear_solver=linear_solver, tolerance=1e-12)
    assert solution.converged, solution.reason
    assert np.abs(solution.positions - goal).max() < {"P1": 1e-12, "P2": 1e-11}[element]
    assert np.allclose(solution.volume_ratio, np.linalg.det(A), atol=1e-11)


def test_the_energy_of_a_stretched_bar():
    """V2, E = 1, nu = .45: the integral of the published law at the published stretches."""
    X, tets = meshes.unstructured(2)
    stretch, lateral = 2.0, 0.7259350056
    solution = solve(Scene(X, tets, [NEO_HOOKE, *rollers(X, {0: stretch})]), solver="fenicsx", tolerance=1e-12)
    mu, lmbda, J = NEO_HOOKE.material.mu, NEO_HOOKE.material.lmbda, stretch * lateral**2
    psi = mu / 2 * (stretch**2 + 2 * lateral**2 - 3) - mu * np.log(J) + lmbda / 2 * np.log(J) ** 2
    assert abs(solution.energy - psi) < 1e-9


def short_bar():
    """A clamped bar of few tets, for quadratic elements."""
    X, tets = meshes.box((3, 1, 1), (3.0, 1.0, 1.0))
    end, skin = meshes.vertices_at(X, 0, 3.0), meshes.boundary_triangles(tets)
    others = [
        terms.SurfaceStrain(skin, np.linspace(1.0, 2.0, len(skin)), growth=1.1, rest=X * [1.0, 1.1, 0.9]),
        terms.Target(end, X[end] + [0.2, 0.3, 0.1], 0.7),
        terms.Fixed(meshes.vertices_at(X, 0, 0.0)),
        terms.Gravity((0, -1.0, 0.2), density=0.05),
    ]
    return X, tets, others


def soft_bar():
    """A clamped bar that bends under gravity, with springs at its end, a stiff skin, and a membrane inside."""
    X, tets = meshes.box((12, 2, 2), (6.0, 1.0, 1.0))
    mid = np.array([[a, b, c] for a, b, c in all_triangles(tets) if (X[[a, b, c], 2] == 0.5).all()])
    end = np.flatnonzero(X[:, 0] == 3.0)
    return (
        X,
        tets,
        [
            terms.SurfaceStrain(meshes.boundary_triangles(tets), 2.0, growth=1.1),
            terms.SurfaceStrain(mid, np.linspace(1.0, 2.0, len(mid))),
            terms.Target(end, X[end] + [0.3, 0.6, 0.2], np.linspace(0.5, 1.0, len(end))),
            terms.Fixed(X[:, 0] == 0),
            terms.Gravity((0, -1.0, 0.2), density=0.05),
        ],
    )


def all_triangles(tets):
    sides = np.concatenate([tets[:, list(side)] for side in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))])
    return np.unique(np.sort(sides, axis=1), axis=0)


BULK = {
    "neo-hooke": lambda m: [SOFT],
    "pd": lambda m: [terms.Strain(np.linspace(1, 3, m), limit=1.05), terms.Strain(0.5), terms.Volume(5.0, target=1.1)],
    "corotated and Mooney-Rivlin": lambda m: ENERGIES["corotated and Mooney-Rivlin"],
    "both": lambda m: [terms.Hyperelastic(SOFT.material, np.arange(m // 2)), terms.Strain(1.0), terms.Volume(5.0)],
}


@pytest.mark.parametrize("bulk", BULK)
@pytest.mark.parametrize("degree", [1, 2])
def test_gradient_and_hessian_are_derivatives_of_the_assembled_energy(degree, bulk):
    X, tets, others = soft_bar() if degree == 1 else short_bar()
    scene = Scene(X, tets, [*BULK[bulk](len(tets)), *others])
    problem = Problem(scene, Numbering(scene, degree))
    rng = np.random.default_rng(0)
    u, d = rng.normal(size=(2, *problem.numbering.X.shape)) * [[[0.03 if degree == 1 else 0.02]], [[1.0]]]
    h = 1e-6 if bulk == "pd" else 1e-4  # the strain limit has kinks

    def differences(f):
        return (8 * (f(u + h * d) - f(u - h * d)) - (f(u + 2 * h * d) - f(u - 2 * h * d))) / (12 * h)

    slope = float(np.sum(problem.at(u).gradient() * d))
    assert abs(differences(lambda v: problem.at(v).energy) - slope) < 1e-7 * abs(slope)
    matrix = csr(problem.at(u).hessian())
    change = differences(lambda v: problem.at(v).gradient()).ravel()
    assert np.abs(matrix @ d.ravel() - change).max() < 1e-6 * np.abs(change).max()
    assert abs(matrix - matrix.T).max() < 1e-12 * abs(matrix).max()
    projected = csr(problem.at(u).softened_hessian(0.0)).toarray()
    assert np.linalg.eigvalsh(projected).min() > -1e-10 * np.abs(projected).max()


@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_sequence_prepares_once(element):
    """Other targets, held positions and loads in a prepared scene give what a new preparation gives."""
    X, tets, others = soft_bar() if element == "P1" else short_bar()
    scene = Scene(X, tets, [SOFT, *others])
    prepared = prepare(scene, solver="fenicsx", element=element, linear_solver="mumps")
    prepared.solve()
    (target,) = scene.of(terms.Target)
    other = scene.with_targets(target.positions + [0.1, -0.4, 0.0]).with_fixed(X[X[:, 0] == 0] + [0.0, 0.1, 0.0])
    again = prepared.solve(other, tolerance=1e-10)
    assert again.converged
    fresh = solve(other, solver="fenicsx", element=element, tolerance=1e-10)
    assert np.abs(again.positions - fresh.positions).max() < 1e-8
    with pytest.raises(SceneError, match="Hyperelastic.material differs"):
        prepared.solve(Scene(X, tets, [NEO_HOOKE, *others]))


def test_neo_hooke_in_principal_stretches_equals_ufl():
    X, tets = meshes.unstructured(2)
    scene = Scene(X, tets, [NEO_HOOKE])
    problem = Problem(scene, Numbering(scene))
    state = problem.at(0.02 * np.random.default_rng(3).normal(size=X.shape))
    exact = csr(state.hessian())
    assert abs(csr(state.softened_hessian(1.0)) - exact).max() < 1e-11 * abs(exact).max()


def csr(matrix):
    indptr, indices, values = matrix.getValuesCSR()
    return csr_matrix((values.copy(), indices.copy(), indptr.copy()), shape=matrix.size)


@pytest.mark.parametrize("bulk", BULK)
def test_cg_and_mumps_agree(bulk):
    X, tets, rest = soft_bar()
    scene = Scene(X, tets, [*BULK[bulk](len(tets)), *rest])
    one, other = (
        solve(scene, solver="fenicsx", linear_solver=name, tolerance=1e-10, start=X * [1.02, 1, 1])
        for name in ("cg", "mumps")
    )
    assert one.converged and other.converged
    assert np.abs(one.positions - other.positions).max() < 1e-8
    assert abs(one.energy - other.energy) < 1e-10
    assert (np.diff(one.history.energy) <= 1e-12).all()
    assert one.detail["linear_iterations"] > one.detail["linear_solves"] == one.detail["assemblies"]


def test_convergence_is_quadratic_at_the_end():
    X, tets, rest = soft_bar()
    scene = Scene(X, tets, [SOFT, *rest])
    norms = solve(scene, solver="fenicsx", linear_solver="mumps", tolerance=1e-11).history.gradient_norm
    relative = norms[norms > 1e-13] / norms[0]
    order = np.log(relative[-1] / relative[-2]) / np.log(relative[-2] / relative[-3])
    assert order > 1.5


def test_numbering():
    X, tets = meshes.unstructured(3)
    spare = np.concatenate([[[9.0, 9.0, 9.0]], X])  # a vertex in no tet
    scene = Scene(spare, tets + 1, [SOFT])
    order = Numbering(scene)
    assert np.array_equal(order.X, spare[order.vertex]) and order.dof[0] == -1
    assert np.array_equal(order.dof[order.vertex], np.arange(len(X)))
    corners = np.sort(order.vertex[order.cell_dofs], axis=1)
    assert np.array_equal(corners, np.sort(scene.tets[order.tet], axis=1))
    geometry = order.space.mesh.geometry.x[:, :3]
    assert np.array_equal(np.sort(geometry, axis=0), np.sort(X, axis=0))
    values = np.random.default_rng(0).normal(size=spare.shape)
    assert np.array_equal(order.to_scene(order.to_dofs(values), np.zeros_like(values))[1:], values[1:])


def test_a_vertex_in_no_tet_stays_or_is_held():
    X, tets = meshes.unstructured(2)
    spare = np.concatenate([X, [[5.0, 5.0, 5.0], [6.0, 6.0, 6.0]]])
    n = len(X)
    face = np.flatnonzero(X[:, 0] == 0)
    scene = Scene(spare, tets, [SOFT, terms.Fixed([*face, n], np.concatenate([X[face], [[7.0, 7.0, 7.0]]]))])
    positions = solve(scene, solver="fenicsx").positions
    assert np.array_equal(positions[n:], [[7.0, 7.0, 7.0], [6.0, 6.0, 6.0]])
    assert np.allclose(positions[:n], X, atol=1e-12)


def test_a_large_motion_of_the_boundary_is_taken_in_load_steps():
    """A face turned by 150 degrees: a direct lift, and its elastic spread too, would invert tets."""
    X, tets = meshes.box((3, 2, 2))
    faces_ = [np.flatnonzero(X[:, 0] == end) for end in (0.0, 1.0)]
    turned = np.array(X[faces_[1]])
    c, d = np.cos(np.deg2rad(150.0)), np.sin(np.deg2rad(150.0))
    turned[:, 1:] = (turned[:, 1:] - 0.5) @ np.array([[c, d], [-d, c]]) + 0.5
    held = terms.Fixed(np.concatenate(faces_), np.concatenate([X[faces_[0]], turned]))
    solution = solve(Scene(X, tets, [SOFT, held]), solver="fenicsx", tolerance=1e-8)
    assert solution.converged, solution.reason
    assert solution.volume_ratio.min() > 0
    assert np.array_equal(solution.positions[faces_[1]], turned)
    fall = np.diff(solution.history.energy)
    assert (fall > 0).sum() == 1  # two load steps: the energy falls within each


def test_reasons():
    X, tets = meshes.unstructured(2)
    scene = Scene(X, tets, [SOFT, *rollers(X, {0: 2.0})])
    inverted = np.array(X)
    inverted[13] += 2.0
    prepared = prepare(scene, solver="fenicsx")
    assert prepared.solve(start=inverted).reason is Reason.NOT_FINITE
    assert prepared.solve(max_iterations=1).reason is Reason.MAX_ITERATIONS
    assert prepared.solve(on_iteration=lambda i, x, e, g: i == 1).reason is Reason.INTERRUPTED
    calls = []
    solution = prepared.solve(on_iteration=lambda i, x, e, g: calls.append((i, e, g)))
    assert [c[0] for c in calls] == list(range(solution.iterations + 1))
    assert calls[-1][1:] == (solution.energy, solution.history.gradient_norm[-1])


def test_refusals():
    X, tets = meshes.unstructured(2)
    scene = Scene(X, tets, [SOFT, terms.Fixed([0])])

    class Wind(terms.Term):
        pass

    for options, message in (
        ({"element": "P7"}, "unknown element 'P7'; there are P1, P2, P2P1"),
        ({"linear_solver": "jacobi"}, "unknown linear_solver 'jacobi'; there are cg, mumps"),
    ):
        with pytest.raises(SceneError, match=message):
            prepare(scene, solver="fenicsx", **options)
    with pytest.raises(SceneError, match="'fenicsx' cannot model Wind"):
        prepare(Scene(X, tets, [Wind()]), solver="fenicsx")
    spare = np.concatenate([X, [[5.0, 5.0, 5.0]]])
    with pytest.raises(SceneError, match="Target: vertex 27 is in no tet"):
        prepare(Scene(spare, tets, [SOFT, terms.Target([27], spare[[27]], 1.0)]), solver="fenicsx")
    loaded = [terms.Strain(1.0, tets=[0]), terms.Gravity((0, -1, 0), density=1.0)]
    with pytest.raises(SceneError, match="carries a load, but no energy acts on it"):
        prepare(Scene(X, tets, loaded), solver="fenicsx")
    prepared = prepare(scene, solver="fenicsx")
    for options, message in (
        ({"start": X[:5]}, "start: expected shape"),
        ({"tolerance": 0.0}, "tolerance must lie between 0 and 1, got 0.0"),
        ({"max_iterations": -1}, "max_iterations must be at least 0"),
    ):
        with pytest.raises(SceneError, match=message):
            prepared.solve(**options)


def test_unknown_versions_are_refused_in_one_line():
    assert parse_version("0.5.2") == (0, 5) and parse_version("0.9.0.post1") == (0, 9)
    for version in ("0.4.1", "0.10.0", "1.0.0"):
        with pytest.raises(MissingDependencyError, match=f"dolfinx {version} is installed; softdeca knows 0.5 to 0.9"):
            parse_version(version)


def test_dolfinx_is_loaded_when_asked_for_and_missed_in_one_line():
    program = (
        "import sys; sys.modules['dolfinx'] = None\n"
        "from softdeca.reference import MissingDependencyError, Scene, solve\n"
        "import numpy as np\n"
        "scene = Scene(np.vstack([np.zeros(3), np.eye(3)]), [[0, 1, 2, 3]], [])\n"
        "try:\n    solve(scene, solver='fenicsx')\n"
        "except MissingDependencyError as error:\n    print(error)\n"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert "needs dolfinx" in answer and "apt-get install python3-dolfinx" in answer and answer.count("\n") == 1
    program = "import sys, softdeca.reference; print('dolfinx' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "False\n"


def test_a_start_whose_projected_hessian_is_singular_is_left():
    """Stretched and not yet thinner, a neo-Hookean bar has lateral modes of negative stiffness, which projection drops.

    Under the nominal stress of twice its length (V2) it has to get there all the same.
    """
    X, tets = meshes.box((12, 2, 2), (6.0, 1.0, 1.0))
    rollers = [terms.Fixed(meshes.vertices_at(X, axis, 0.0), components=(axis,)) for axis in range(3)]
    pull = terms.Traction(meshes.triangles_at(X, tets, 0, 6.0), (0.5987962703, 0.0, 0.0))
    law = terms.Hyperelastic(materials.NeoHookean.from_young(1.0, 0.45))
    solution = solve(
        Scene(X, tets, [law, pull, *rollers]), solver="fenicsx", start=X * [1.8, 1.0, 1.0], tolerance=1e-10
    )
    assert solution.converged, solution.reason
    assert solution.positions == pytest.approx(X * [2.0, 0.7259350056, 0.7259350056], abs=1e-8)


def test_a_column_bends_under_a_dead_load_beyond_its_buckling():
    """The elastica (Timoshenko and Gere 1961, "Theory of Elastic Stability", Section 2.7), at 1.293 times Euler's load.

    The end's tangent has turned by 80 degrees, its height is .560 and its distance aside .719 of the length.
    """
    X, tets = meshes.box((8, 2, 2), (10.0, 1.0, 1.5))
    young = 1000.0
    critical = np.pi**2 * young / 12 / (4 * 10.0**2)
    tip = meshes.triangles_at(X, tets, 0, 10.0)
    load = terms.Traction(tip, (-1.293 * critical, 0.0, 0.0))
    law = terms.Hyperelastic(materials.NeoHookean.from_young(young, 0.3))
    scene = Scene(X, tets, [law, terms.Fixed(meshes.vertices_at(X, 0, 0.0)), load])
    solution = solve(scene, solver="fenicsx", element="P2", tolerance=1e-8)
    assert solution.converged, solution.reason
    end = solution.positions[np.unique(tip)].mean(axis=0)
    assert end[0] / 10.0 == pytest.approx(0.560, abs=0.03)
    assert abs(end[1] - 0.5) / 10.0 == pytest.approx(0.719, abs=0.03)


def test_numbering_of_quadratic_elements():
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


def test_a_membrane_is_that_of_its_quadratic_triangles():
    """An affine motion costs what linear triangles cost; a bump between vertices, unseen by those, more."""
    scene = Scene(*short_bar()[:2], short_bar()[2])
    surface = Scene(scene.vertices, scene.tets, [t for t in scene.terms if isinstance(t, terms.SurfaceStrain)])
    linear, quadratic = (Problem(surface, Numbering(surface, degree)) for degree in (1, 2))
    A = np.array([[1.1, 0.2, 0.0], [0.0, 0.9, 0.1], [0.1, 0.0, 1.2]]) - np.eye(3)
    energies = [problem.at(problem.numbering.X @ A.T).energy for problem in (linear, quadratic)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-12)
    bump = np.array(quadratic.numbering.X @ A.T)
    ends = quadratic.numbering.ends
    bump[ends[:, 0] != ends[:, 1], 1] += 0.05
    assert quadratic.at(bump).energy > energies[1] * 1.001


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
