"""The FEniCSx solver through the public entry: patch test, closed forms, numbering, linear solvers, refusals."""

import subprocess
import sys
from itertools import permutations

import numpy as np
import pytest
from scipy.sparse import csr_matrix

pytest.importorskip("dolfinx")

from softdeca.lhm.base.errors import MissingDependencyError
from softdeca.reference import Reason, Scene, SceneError, materials, prepare, solve, terms
from softdeca.reference.fenicsx.dolfinx_version import parse_version
from softdeca.reference.fenicsx.numbering import Numbering
from softdeca.reference.fenicsx.problem import Problem
from softdeca.reference.problems import meshes

NEO_HOOKE = terms.Hyperelastic(materials.NeoHookean.from_young(1.0, 0.45))
SOFT = terms.Hyperelastic(materials.NeoHookean.from_young(1.0, 0.3))


def box(n, size=(1.0, 1.0, 1.0)):
    """Vertices and tets of a box of n cubes along each axis, each split into six tets round its diagonal."""
    count = np.broadcast_to(n, 3)
    vertices = np.stack(np.meshgrid(*[np.arange(c + 1) for c in count], indexing="ij"), -1).reshape(-1, 3)
    corner = np.stack(np.meshgrid(*[np.arange(c) for c in count], indexing="ij"), -1).reshape(-1, 3)
    strides = np.array([(count[1] + 1) * (count[2] + 1), count[2] + 1, 1])
    tets = []
    for order in permutations(range(3)):
        path = [corner]
        for axis in order:
            path.append(path[-1] + np.eye(3, dtype=int)[axis])
        tet = np.stack([p @ strides for p in path], axis=1)
        odd = np.linalg.det(np.eye(3)[list(order)]) < 0
        tets.append(tet[:, [0, 1, 3, 2]] if odd else tet)
    return vertices / count * size, np.concatenate(tets)


def shaken_box(n, amount=0.2, seed=0):
    X, tets = box(n)
    inner = ((X > 0) & (X < 1)).all(axis=1)
    return X + inner[:, None] * np.random.default_rng(seed).uniform(-amount / n, amount / n, X.shape), tets, inner


def rollers(X, axis_lengths=None):
    """Symmetry planes x = y = z = 0, and the far faces of the axes in `axis_lengths` moved there."""
    held = [terms.Fixed(X[:, c] == 0, components=c) for c in range(3)]
    for c, length in (axis_lengths or {}).items():
        face = np.flatnonzero(X[:, c] == X[:, c].max())
        values = np.array(X[face])
        values[:, c] = length
        held.append(terms.Fixed(face, values, components=c))
    return held


@pytest.mark.parametrize("linear_solver", ["cg", "mumps"])
@pytest.mark.parametrize("energy", [[SOFT], [terms.Strain(1.0), terms.Volume(10.0)], [terms.Strain(1.0, limit=1.02)]])
def test_patch(energy, linear_solver):
    """V1: an affine motion of the boundary moves the interior alike."""
    X, tets, inner = shaken_box(3)
    A = np.array([[1.1, 0.05, 0.0], [0.0, 0.95, 0.1], [0.02, 0.0, 1.03]])
    goal = X @ A.T + [0.3, -0.2, 0.1]
    scene = Scene(X, tets, [*energy, terms.Fixed(~inner, goal[~inner])])
    solution = solve(scene, solver="fenicsx", linear_solver=linear_solver, tolerance=1e-12)
    assert solution.converged
    assert np.abs(solution.positions - goal).max() < 1e-12
    assert np.allclose(solution.volume_ratio, np.linalg.det(A), atol=1e-12)


@pytest.mark.parametrize(
    "stretch, lateral", [(0.5, 1.3508697467), (1.5, 0.8306789808), (2.0, 0.7259350056), (3.0, 0.5983147092)]
)
def test_uniaxial(stretch, lateral):
    """V2, E = 1, nu = .45; also its energy, the integral of the published law at the published stretches."""
    X, tets, _ = shaken_box(2)
    solution = solve(Scene(X, tets, [NEO_HOOKE, *rollers(X, {0: stretch})]), solver="fenicsx", tolerance=1e-12)
    assert solution.converged
    assert np.allclose(solution.positions, X * [stretch, lateral, lateral], atol=2e-10)
    mu, lmbda, J = NEO_HOOKE.material.mu, NEO_HOOKE.material.lmbda, stretch * lateral**2
    psi = mu / 2 * (stretch**2 + 2 * lateral**2 - 3) - mu * np.log(J) + lmbda / 2 * np.log(J) ** 2
    assert abs(solution.energy - psi) < 1e-9


@pytest.mark.parametrize("stretch, force", [(0.5, -1.0861028086), (1.5, 0.3586143519), (2.0, 0.5987962703)])
def test_uniaxial_under_traction(stretch, force):
    """V2's nominal stress P as a dead load gives the stretch back."""
    X, tets = box(2)
    triangles = np.array([t for t in faces(tets) if (X[t, 0] == 1).all()])
    start = X * [1 + 0.5 * (stretch - 1), 1, 1]
    scene = Scene(X, tets, [NEO_HOOKE, *rollers(X), terms.Traction(triangles, (force, 0, 0))])
    solution = solve(scene, solver="fenicsx", tolerance=1e-10, start=start)
    assert solution.converged
    assert np.allclose(solution.positions[:, 0], X[:, 0] * stretch, atol=1e-8)


@pytest.mark.parametrize("stretch, thickness", [(1.5, 0.4839184956), (2.0, 0.2770079198)])
def test_equibiaxial(stretch, thickness):
    X, tets, _ = shaken_box(2)
    scene = Scene(X, tets, [NEO_HOOKE, *rollers(X, {0: stretch, 1: stretch})])
    solution = solve(scene, solver="fenicsx", tolerance=1e-11)
    assert solution.converged
    assert np.allclose(solution.positions, X * [stretch, stretch, thickness], atol=2e-10)


@pytest.mark.parametrize(
    "volume, stretch, lateral",
    [(0, 0.5, 1.0), (0, 2.0, 1.0), (10, 0.5, 1.296099), (10, 1.5, 0.835426), (10, 2.0, 0.735254)],
)
def test_projective_energy_uniaxial(volume, stretch, lateral):
    """V3, ws = 1 and wv = volume: lateral stretches to the six digits that are published."""
    X, tets, _ = shaken_box(2)
    energy = [terms.Strain(1.0)] + ([terms.Volume(float(volume))] if volume else [])
    solution = solve(Scene(X, tets, [*energy, *rollers(X, {0: stretch})]), solver="fenicsx", tolerance=1e-11)
    assert solution.converged
    assert np.allclose(solution.positions, X * [stretch, lateral, lateral], atol=6e-7)


def test_strain_limit():
    """V3: P = ws (l - L) beyond the limit L, so a dead load P stretches to l = L + P/ws."""
    X, tets = box(2)
    triangles = np.array([t for t in faces(tets) if (X[t, 0] == 1).all()])
    terms_ = [terms.Strain(2.0, limit=1.2), *rollers(X), terms.Traction(triangles, (0.5, 0, 0))]
    solution = solve(Scene(X, tets, terms_), solver="fenicsx", tolerance=1e-10, start=X * [1.5, 1, 1])
    assert solution.converged
    assert np.allclose(solution.positions[:, 0], X[:, 0] * (1.2 + 0.5 / 2.0), atol=1e-9)


@pytest.mark.parametrize("linear_solver", ["cg", "mumps"])
def test_bar_under_its_own_weight(linear_solver):
    """V3: tip = rho g L² / (2 ws) at any size; L = 1, rho = 1000, g = 9.81, ws = 1e5."""
    X, tets = box((8, 1, 1), (1.0, 0.1, 0.1))
    still = [terms.Fixed(np.arange(len(X)), components=(1, 2)), terms.Fixed(X[:, 0] == 0, components=0)]
    scene = Scene(X, tets, [terms.Strain(1e5), *still, terms.Gravity((9.81, 0, 0), density=1000.0)])
    solution = solve(scene, solver="fenicsx", tolerance=1e-11, linear_solver=linear_solver)
    tip = solution.positions[X[:, 0] == 1, 0] - 1.0
    assert solution.converged
    assert np.allclose(tip.mean(), 0.04905, rtol=2e-3)  # six tets per cube share the end's load unevenly


def faces(tets):
    """Boundary triangles, oriented outwards or not."""
    sides = np.concatenate([tets[:, list(side)] for side in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))])
    _, first, count = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    return sides[first[count == 1]]


def soft_bar():
    """A clamped bar that bends under gravity, with springs at its end, a stiff skin, and a membrane inside."""
    X, tets = box((12, 2, 2), (6.0, 1.0, 1.0))
    mid = np.array([[a, b, c] for a, b, c in all_triangles(tets) if (X[[a, b, c], 2] == 0.5).all()])
    end = np.flatnonzero(X[:, 0] == 3.0)
    return (
        X,
        tets,
        [
            terms.SurfaceStrain(faces(tets), 2.0, growth=1.1),
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
    "both": lambda m: [terms.Hyperelastic(SOFT.material, np.arange(m // 2)), terms.Strain(1.0), terms.Volume(5.0)],
}


@pytest.mark.parametrize("bulk", BULK)
def test_gradient_and_hessian_are_derivatives_of_the_assembled_energy(bulk):
    X, tets, rest = soft_bar()
    scene = Scene(X, tets, [*BULK[bulk](len(tets)), *rest])
    problem = Problem(scene, Numbering(scene))
    rng = np.random.default_rng(0)
    u, d = rng.normal(size=(2, *problem.numbering.X.shape)) * [[[0.03]], [[1.0]]]
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


def test_neo_hooke_in_principal_stretches_equals_ufl():
    X, tets, _ = shaken_box(2)
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


def test_a_sequence_prepares_once():
    """Other targets, held positions and loads in a prepared scene give what a new preparation gives."""
    X, tets, rest = soft_bar()
    scene = Scene(X, tets, [SOFT, *rest])
    prepared = prepare(scene, solver="fenicsx", linear_solver="mumps")
    prepared.solve()
    target = next(term for term in rest if isinstance(term, terms.Target))
    other = scene.with_targets(target.positions + [0.1, -0.4, 0.0]).with_fixed(X[X[:, 0] == 0] + [0.0, 0.1, 0.0])
    again = prepared.solve(other, tolerance=1e-10)
    assert again.converged
    assert np.abs(again.positions - solve(other, solver="fenicsx", tolerance=1e-10).positions).max() < 1e-8
    with pytest.raises(SceneError, match="Hyperelastic.material differs"):
        prepared.solve(Scene(X, tets, [NEO_HOOKE, *rest]))


def test_numbering():
    X, tets, _ = shaken_box(3)
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
    X, tets, _ = shaken_box(2)
    spare = np.concatenate([X, [[5.0, 5.0, 5.0], [6.0, 6.0, 6.0]]])
    n = len(X)
    face = np.flatnonzero(X[:, 0] == 0)
    scene = Scene(spare, tets, [SOFT, terms.Fixed([*face, n], np.concatenate([X[face], [[7.0, 7.0, 7.0]]]))])
    positions = solve(scene, solver="fenicsx").positions
    assert np.array_equal(positions[n:], [[7.0, 7.0, 7.0], [6.0, 6.0, 6.0]])
    assert np.allclose(positions[:n], X, atol=1e-12)


def test_a_large_motion_of_the_boundary_is_taken_in_load_steps():
    """A face turned by 150 degrees: a direct lift, and its elastic spread too, would invert tets."""
    X, tets = box((3, 2, 2))
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
    X, tets, _ = shaken_box(2)
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
    X, tets, _ = shaken_box(2)
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
