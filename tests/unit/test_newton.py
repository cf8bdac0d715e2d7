"""Newton's method of both finite-element solvers: large motions in parts, orders, definiteness, hard equilibria."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softdeca.reference import Reason, Scene, materials, terms
from softdeca.reference.materials import NeoHookean
from softdeca.reference.problems import meshes
from softdeca.reference.problems.homogeneous import rollers

from .by_solver import prepare_by, solve_by

SOFT = terms.Hyperelastic(NeoHookean.from_young(1.0, 0.3))
FEM = pytest.mark.parametrize("solver", ["fenicsx", "skfem"])


def soft_bar():
    """A clamped bar that bends under gravity, with springs at its end, a stiff skin, and a membrane inside."""
    X, tets = meshes.box((12, 2, 2), (6.0, 1.0, 1.0))
    sides = np.concatenate([tets[:, list(side)] for side in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))])
    triangles = np.unique(np.sort(sides, axis=1), axis=0)
    middle = triangles[(X[triangles, 2] == 0.5).all(axis=1)]
    end = meshes.vertices_at(X, 0, 3.0)
    others = [
        terms.SurfaceStrain(meshes.boundary_triangles(tets), 2.0, growth=1.1),
        terms.SurfaceStrain(middle, np.linspace(1.0, 2.0, len(middle))),
        terms.Target(end, X[end] + [0.3, 0.6, 0.2], np.linspace(0.5, 1.0, len(end))),
        terms.Fixed(X[:, 0] == 0),
        terms.Gravity((0, -1.0, 0.2), density=0.05),
    ]
    return X, tets, others


BULK = {
    "neo-Hookean": lambda m: [SOFT],
    "PD": lambda m: [terms.Strain(np.linspace(1, 3, m), limit=1.05), terms.Strain(0.5), terms.Volume(5.0, target=1.1)],
    "corotated and Mooney-Rivlin": lambda m: [
        terms.Hyperelastic(materials.Corotated(1.0, 2.0)),
        terms.Hyperelastic(materials.MooneyRivlin(0.3, 0.1, 2.0, 0.1)),
    ],
    "both": lambda m: [terms.Hyperelastic(SOFT.material, np.arange(m // 2)), terms.Strain(1.0), terms.Volume(5.0)],
}


@pytest.mark.parametrize("bulk", BULK)
def test_cg_and_mumps_agree(bulk):
    X, tets, rest = soft_bar()
    scene = Scene(X, tets, [*BULK[bulk](len(tets)), *rest])
    one, other = (
        solve_by("fenicsx", scene, linear_solver=name, tolerance=1e-10, start=X * [1.02, 1, 1])
        for name in ("cg", "mumps")
    )
    assert np.abs(one.positions - other.positions).max() < 1e-8
    assert abs(one.energy - other.energy) < 1e-10
    assert (np.diff(one.history.energy) <= 1e-12).all()
    assert one.detail["linear_iterations"] > one.detail["linear_solves"] == one.detail["assemblies"]


def test_convergence_is_quadratic_at_the_end():
    X, tets, rest = soft_bar()
    scene = Scene(X, tets, [SOFT, *rest])
    norms = solve_by("fenicsx", scene, linear_solver="mumps").history.gradient_norm
    relative = norms[norms > 1e-13] / norms[0]
    order = np.log(relative[-1] / relative[-2]) / np.log(relative[-2] / relative[-3])
    assert order > 1.5


@FEM
def test_a_stretch_that_would_invert_elements_is_carried_inwards(solver):
    """Only the boundary is told of an affine map; put there alone it inverts tets. The answer is the map."""
    X, tets = meshes.unstructured(3)
    A, shift = np.diag([3.0, 0.6, 0.8]) + 0.5 * np.eye(3, k=1), np.array([4.0, 0.0, 0.0])
    boundary = np.unique(meshes.boundary_triangles(tets))
    goal = X @ A.T + shift
    scene = Scene(X, tets, [terms.Hyperelastic(NeoHookean(1.0, 5.0)), terms.Fixed(boundary, goal[boundary])])
    jumped = X.copy()
    jumped[boundary] = goal[boundary]
    assert prepare_by(solver, scene).solve(start=jumped).reason is Reason.NOT_FINITE
    assert np.abs(solve_by(solver, scene, tolerance=1e-12).positions - goal).max() < 1e-10


@pytest.mark.parametrize(
    ("solver", "element", "law", "degrees", "steps"),
    [
        ("fenicsx", "P1", SOFT.material, 150, 5),
        ("skfem", "P1", NeoHookean(1.0, 5.0), 150, 5),
        ("fenicsx", "P2P1", materials.Incompressible(NeoHookean(1.0, 1.0)), 120, 2),
    ],
)
def test_a_twist_is_taken_in_parts_to_where_small_steps_lead(solver, element, law, degrees, steps):
    """A direct lift, and its elastic spread too, would invert tets."""
    X, tets = meshes.box((3, 2, 2))
    ends = [meshes.vertices_at(X, 0, end) for end in (0.0, 1.0)]
    axis = np.array([0.0, 0.5, 0.5])

    def twisted(by):
        turned = Rotation.from_euler("x", by, degrees=True).apply(X[ends[1]] - axis) + axis
        held = terms.Fixed(np.concatenate(ends), np.concatenate([X[ends[0]], turned]))
        return Scene(X, tets, [terms.Hyperelastic(law), held])

    options = {"element": element, "tolerance": 1e-10 if element == "P1" else 1e-9}
    at_once = solve_by(solver, twisted(degrees), **options)
    assert at_once.volume_ratio.min() > 0
    held, places = twisted(degrees).dirichlet()
    assert np.array_equal(at_once.positions[held], places[held])
    if (solver, element) == ("fenicsx", "P1"):
        assert (np.diff(at_once.history.energy) > 0).sum() == 1  # two load steps: the energy falls within each
    positions = X
    for k in range(1, steps + 1):
        positions = solve_by(solver, twisted(degrees * k / steps), start=positions, **options).positions
    assert np.abs(at_once.positions - positions).max() < (1e-8 if element == "P1" else 1e-7)


def test_a_start_whose_projected_hessian_is_singular_is_left():
    """Stretched and not yet thinner, a neo-Hookean bar has lateral modes of negative stiffness, which projection drops.

    Under the nominal stress of twice its length (V2) it has to get there all the same.
    """
    X, tets = meshes.box((12, 2, 2), (6.0, 1.0, 1.0))
    pull = terms.Traction(meshes.triangles_at(X, tets, 0, 6.0), (0.5987962703, 0.0, 0.0))
    law = terms.Hyperelastic(NeoHookean.from_young(1.0, 0.45))
    solution = solve_by("fenicsx", Scene(X, tets, [law, pull, *rollers(X)]), start=X * [1.8, 1.0, 1.0], tolerance=1e-10)
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
    law = terms.Hyperelastic(NeoHookean.from_young(young, 0.3))
    scene = Scene(X, tets, [law, terms.Fixed(meshes.vertices_at(X, 0, 0.0)), load])
    end = solve_by("fenicsx", scene, element="P2", tolerance=1e-8).positions[np.unique(tip)].mean(axis=0)
    assert end[0] / 10.0 == pytest.approx(0.560, abs=0.03)
    assert abs(end[1] - 0.5) / 10.0 == pytest.approx(0.719, abs=0.03)


@pytest.mark.parametrize("poisson", [0.4999, 0.49999])
def test_a_nearly_incompressible_block_is_solved_to_the_end(poisson):
    """Factors solve it, whatever the usual solver is: CG's steps creep there."""
    X, tets = meshes.box((3, 3, 3))
    low, high = (meshes.vertices_at(X, 2, at) for at in (0.0, 1.0))
    law = terms.Hyperelastic(NeoHookean.from_young(10.0, poisson))
    scene = Scene(X, tets, [law, terms.Fixed(low), terms.Fixed(high, X[high] + [0.1, 0.05, 0.2])])
    answer = solve_by("fenicsx", scene, element="P2", tolerance=1e-9)
    assert answer.iterations < 40
    assert answer.detail["linear_iterations"] == answer.detail["linear_solves"]
    other = solve_by("skfem", scene, element="P2", start=answer.positions, tolerance=1e-9)
    assert np.abs(other.positions - answer.positions).max() < 1e-6
