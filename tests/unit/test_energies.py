"""Every energy of every solver: gradient and Hessian by differences, the projected Hessian, and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial.legendre import leggauss
from scipy.spatial.transform import Rotation

from softdeca.reference import Parameters, Scene, facial_scene, materials, terms
from softdeca.reference.problems import meshes
from softdeca.surrogate.corpus.spheres import Spheres

from .by_solver import DISCRETE, SOLVERS, WAYS, dense

X, TETS = meshes.unstructured(3, 3.0)
SKIN, TOP = meshes.boundary_triangles(TETS), meshes.triangles_at(X, TETS, 2, 3.0)
RNG = np.random.default_rng(0)
SOME = np.arange(0, len(TETS), 2)
SOFT = terms.Hyperelastic(materials.NeoHookean.from_young(1.0, 0.3))
TWO_LAWS = [
    terms.Hyperelastic(materials.MooneyRivlin(0.3, 0.1, 2.0, 0.1)),
    terms.Hyperelastic(materials.Corotated(1.0, 2.0), tets=SOME[::-1]),
]
GRADED = np.linspace(1.0, 1.5, len(TETS))
GROWN = [terms.Hyperelastic(term.material, growth=GRADED) for term in (SOFT, *TWO_LAWS)]
SPREAD = terms.Target(np.unique(SKIN), 1.1 * X[np.unique(SKIN)], RNG.uniform(1.0, 2.0, len(np.unique(SKIN))), SKIN[::2])
PULL = terms.Target(np.arange(20), X[:20] + RNG.normal(size=(20, 3)), RNG.uniform(1.0, 2.0, 20))
LOADS = [
    terms.Gravity((0.2, -1.0, 3.0), density=np.linspace(1.0, 2.0, len(TETS))),
    terms.Gravity((1.0, 0.0, 0.0), density=0.5, tets=[3, 1]),
    terms.Traction(TOP, (0.5, 0.0, 4.0)),
]
OTHER_SHAPE = X * [1.2, 0.9, 1.0] + 0.05 * RNG.normal(size=X.shape)
MEMBRANE = terms.SurfaceStrain(SKIN, RNG.uniform(1.0, 2.0, len(SKIN)), 1.1, rest=OTHER_SHAPE)
BENDING = terms.Bending(SKIN, RNG.uniform(1.0, 2.0, len(SKIN)))
PD = [terms.Strain(np.linspace(1.0, 3.0, len(TETS)), limit=1.05), terms.Volume(5.0, np.linspace(0.9, 1.2, len(TETS)))]
OVERLAPPING = [terms.Strain(0.5, tets=[0, 1, 2]), terms.Volume(0.2, tets=[2, 3]), terms.Strain(GRADED)]
BODIES = [terms.RigidBody(np.arange(40, 52)), terms.RigidBody(np.arange(56, 64), 1.1 * X[56:64])]
PRISMS = np.arange(len(TETS)).reshape(-1, 6)[:, [0, 1, 4, 2, 3, 5]].reshape(-1, 3)  # halves of the mesh's cells
EACH = np.linspace(1.0, 2.0, len(PRISMS))
ON_PRISMS = [
    terms.Strain(EACH, limit=1.02, tets=PRISMS),
    terms.Volume(5.0, 0.8 * EACH, tets=PRISMS),
    terms.Hourglass(EACH, PRISMS),
]
PRISMS_AND_TETS = [
    *ON_PRISMS,
    terms.Strain(2.0, tets=PRISMS[::3]),
    terms.Strain(1.0, tets=PRISMS[3:9]),
    terms.Volume(2.0, tets=PRISMS[5:12]),
    terms.Hourglass(1.0, PRISMS[4:7]),
    terms.Strain(GRADED, limit=1.1),
]
EVERYWHERE = terms.Target(np.arange(len(X)), X + RNG.normal(size=X.shape), RNG.uniform(1.0, 3.0, len(X)))
ENERGIES = {  # terms, size of the random displacement [mm], solvers
    "Strain": ([terms.Strain(RNG.uniform(1.0, 3.0, len(TETS)))], 0.3, SOLVERS),
    "Volume": ([terms.Volume(3.0, RNG.uniform(0.7, 1.4, len(TETS)))], 0.1, SOLVERS),
    "Volume, tangled": ([terms.Strain(1.0), terms.Volume(50.0, 1.2)], 1.5, SOLVERS),
    "all of projective dynamics, overlapping": ([*PD, *OVERLAPPING], 0.2, SOLVERS),
    "prisms": (ON_PRISMS, 0.2, SOLVERS),
    "prisms, tangled": ([terms.Strain(1.0, tets=PRISMS), terms.Volume(50.0, 1.2, tets=PRISMS)], 1.5, SOLVERS),
    "prisms among tets, overlapping": ([*PRISMS_AND_TETS, PULL, *BODIES], 0.2, SOLVERS),
    "grown by tet": (GROWN, 0.03, SOLVERS[1:]),
    "laws on the same tets": ([*TWO_LAWS, terms.Strain(1.0), terms.Volume(5.0, tets=SOME)], 0.03, SOLVERS[1:]),
    "SurfaceStrain": ([terms.SurfaceStrain(SKIN, 2.0, growth=1.3)], 0.3, SOLVERS),
    "SurfaceStrain of another rest": ([MEMBRANE], 0.3, SOLVERS),
    "Bending": ([BENDING], 0.3, SOLVERS[:2]),
    "Bending of another rest": ([terms.Bending(SKIN, 1.0, rest=OTHER_SHAPE)], 0.3, SOLVERS[:2]),
    "Target and loads": ([PULL, EVERYWHERE, SPREAD, replace(SPREAD, lumped=True), *LOADS], 1.0, SOLVERS),
    "bodies": ([*PD[1:], *OVERLAPPING, MEMBRANE, PULL, *BODIES], 0.2, SOLVERS),
    "held": ([terms.Strain(5.0), PULL, terms.Fixed([3, 4], components=1), terms.Fixed([7, 8])], 0.3, ("projective",)),
    "all but bending": ([*PD, SOFT, MEMBRANE, PULL, SPREAD, EVERYWHERE, *LOADS], 0.02, SOLVERS[1:]),
}
QUADRATIC = (
    "all of projective dynamics, overlapping",
    "laws on the same tets",
    "bodies",
    "all but bending",
    "Bending of another rest",
)
CASES = [
    (name, *way)
    for name, (_, _, solvers) in ENERGIES.items()
    for way in WAYS
    if way[0] in solvers and (way[1] == "P1" or name in QUADRATIC)
]


def place_of(name, solver, element):
    """A discrete scene, a random place of it, and its number of bodies."""
    parts, size, _ = ENERGIES[name]
    discrete = DISCRETE[solver](Scene(X, TETS, parts), element)
    step = size * np.random.default_rng(1).normal(size=discrete.size)
    bodies = sum(isinstance(part, terms.RigidBody) for part in parts)
    if bodies:
        step[-6 * bodies :] *= 10.0
    return discrete, discrete.move(discrete.start, step), bodies


def differences(function, step):
    """The derivative by a length along a line, by central differences of fourth order."""
    return (8 * (function(step) - function(-step)) - (function(2 * step) - function(-2 * step))) / (12 * step)


def check_derivatives(discrete, place, bodies, h=2e-5):
    """A body's own rows turn along with it: of those the second derivative along the line is compared."""
    matrix, free = discrete.hessian(place), discrete.size - 6 * bodies
    np.testing.assert_allclose(matrix, matrix.T, rtol=0.0, atol=1e-11 * np.abs(matrix).max())
    rng = np.random.default_rng(2)
    for share in (1.0, 1.0, 0.0)[: 3 if bodies else 2]:
        line = rng.normal(size=discrete.size)
        line[:free] *= share  # the last time bodies alone

        def along(s, line=line):
            return discrete.move(place, s * line)

        slope = differences(lambda s: discrete.energy(along(s)), h)
        rounding = np.finfo(float).eps * abs(discrete.energy(place)) / h
        assert discrete.gradient(place) @ line == pytest.approx(slope, rel=1e-7, abs=2.0 * rounding)
        change = differences(lambda s: discrete.gradient(along(s)), h)
        np.testing.assert_allclose((matrix @ line)[:free], change[:free], rtol=0.0, atol=1e-7 * np.abs(change).max())
        turning = differences(lambda s, line=line: discrete.gradient(along(s)) @ line, h)
        assert line @ matrix @ line == pytest.approx(turning, rel=1e-6, abs=1e-9 * np.abs(matrix).max())


@pytest.mark.parametrize(("name", "solver", "element"), CASES)
def test_gradient_and_hessian_are_derivatives(name, solver, element):
    discrete, place, bodies = place_of(name, solver, element)
    has_kinks = any(isinstance(part, terms.Strain) and np.any(part.limit > 1.0) for part in ENERGIES[name][0])
    check_derivatives(discrete, place, bodies, 3e-7 if has_kinks else 2e-5)
    projected = np.linalg.eigvalsh(discrete.projected_hessian(place))
    assert projected[0] > -1e-10 * projected[-1]
    if name in ("Volume, tangled", "bodies"):
        lowest = np.linalg.eigvalsh(discrete.hessian(place))[0]
        assert lowest < -1e-3 * projected[-1], "nothing to project: a tame case"


@pytest.mark.parametrize(("solver", "element"), WAYS)
@pytest.mark.parametrize("name", ["Strain", "SurfaceStrain"])
def test_projection_leaves_sound_elements_alone(name, solver, element):
    """Where all is in tension the Hessian has no negative eigenvalue."""
    discrete = DISCRETE[solver](Scene(X, TETS, ENERGIES[name][0]), element)
    stretched = discrete.at(1.3 * discrete.nodes)
    exact = discrete.hessian(stretched)
    np.testing.assert_allclose(discrete.projected_hessian(stretched), exact, rtol=1e-9, atol=1e-9)


def test_a_face_has_its_derivatives():
    """Layers, guards, skin, bending and a free mandible of a head, by projective dynamics."""
    space = Spheres(1)
    head = space.fit(space.skin(np.zeros(4)))
    scene = facial_scene(head, Parameters(skin_bending=20.0, gravity=2.0), head.skin.vertices)
    discrete = DISCRETE["projective"](scene)
    step = 2.0 * np.random.default_rng(0).normal(size=discrete.size)
    check_derivatives(discrete, discrete.move(discrete.start, step), len(scene.of(terms.RigidBody)))


def test_a_matrix_is_assembled_anew_at_every_state():
    """FEniCSx writes all of them into one."""
    discrete, place, _ = place_of("bodies", "fenicsx", "P1")
    before = discrete.hessian(place)
    other = discrete.hessian(discrete.move(place, np.full(discrete.size, 0.2)))
    assert np.abs(other - before).max() > 1e-3 * np.abs(before).max()
    np.testing.assert_allclose(discrete.hessian(place), before, rtol=0.0, atol=1e-12 * np.abs(before).max())


def test_a_softened_hessian_that_keeps_all_is_the_exact_one():
    """Compare singular values with UFL."""
    discrete, place, _ = place_of("laws on the same tets", "fenicsx", "P1")
    exact = discrete.hessian(place)
    np.testing.assert_allclose(
        dense(place.hessian(np.nextafter(1.0, 0.0))), exact, rtol=0.0, atol=1e-11 * np.abs(exact).max()
    )


def energy_of(way, parts, motion, mesh=(X, TETS)):
    """The energy of terms where a motion takes every node."""
    solver, element = way
    discrete = DISCRETE[solver](Scene(*mesh, parts), element)
    return discrete.energy(discrete.at(motion(discrete.nodes)))


@pytest.mark.parametrize(
    ("name", "element"),
    [
        (name, way)
        for name in ENERGIES
        for way in ("P1", "P2")
        if name != "held" and not (way == "P2" and "prisms" in name)
    ],
)
def test_solvers_measure_one_energy_and_its_forces(name, element):
    """At one disturbed state; on quadratic elements by each library's own tables of shapes and points."""
    parts, size, solvers = ENERGIES[name]
    free = [part for part in parts if not isinstance(part, terms.RigidBody)]
    energies, forces = [], []
    for solver in solvers if element == "P1" else [other for other in solvers if other != "projective"]:
        discrete = DISCRETE[solver](Scene(X, TETS, free), element)
        in_order = np.lexsort(np.round(discrete.nodes, 9).T)
        step = size * np.random.default_rng(4).normal(size=discrete.nodes.shape)
        places = np.empty_like(discrete.nodes)
        places[in_order] = discrete.nodes[in_order] + step
        energies.append(discrete.energy(discrete.at(places)) - discrete.energy(discrete.at(discrete.nodes)))
        forces.append(discrete.forces(places)[in_order])
    for energy, force in zip(energies[1:], forces[1:], strict=True):
        assert energy == pytest.approx(energies[0], rel=1e-11)
        np.testing.assert_allclose(force, forces[0], rtol=0.0, atol=1e-11 * np.abs(force).max())


TURN = Rotation.from_rotvec([0.3, -1.0, 2.0])
AREA, BULK = 9.0, 27.0  # of the top [mm²], of the block [mm³]
STRETCHED = np.array([1.3, 1 / 1.3, 1.0])
CLOSED_FORMS = {  # terms, motion, energy
    "Strain": ([terms.Strain(2.0)], lambda x: TURN.apply(x * [1.2, 0.9, 1.1]) + 4.0, BULK * 0.06),
    "Strain with a limit": (
        [terms.Strain(2.0, limit=1.1)],
        lambda x: TURN.apply(x * STRETCHED),
        BULK * (0.2**2 + (1 / 1.1 - 1 / 1.3) ** 2),
    ),
    "Strain within its limit": ([terms.Strain(2.0, limit=1.1)], lambda x: TURN.apply(x * [1.09, 0.95, 1.0]), 0.0),
    "Volume": ([terms.Volume(3.0, 1.728)], lambda x: 1.2 * TURN.apply(x), 0.0),
    "SurfaceStrain": ([terms.SurfaceStrain(TOP, 3.0)], lambda x: TURN.apply(x * [1.1, 1.0, 7.0]), AREA * 0.015),
    "SurfaceStrain, grown": ([terms.SurfaceStrain(TOP, 3.0, 1.44)], lambda x: 1.2 * TURN.apply(x), 0.0),
    "SurfaceStrain at another rest": (
        [terms.SurfaceStrain(TOP, 3.0, rest=X * [2.0, 1.0, 1.0])],
        lambda x: TURN.apply(x * [2.0, 1.0, 1.0]),
        0.0,
    ),
    "SurfaceStrain short of another rest": (
        [terms.SurfaceStrain(TOP, 3.0, 1.1, rest=1.2 * X)],
        lambda x: x,
        AREA * 3.0 * (1 / 1.2 - np.sqrt(1.1)) ** 2,
    ),
    "Bending": ([terms.Bending(SKIN, 3.0)], lambda x: TURN.apply(x) + 4.0, 0.0),
}


@pytest.mark.parametrize(
    ("name", "way"), [(name, way) for name in CLOSED_FORMS for way in WAYS if (name, way[0]) != ("Bending", "skfem")]
)
def test_closed_forms(name, way):
    parts, motion, expected = CLOSED_FORMS[name]
    assert energy_of(way, parts, motion) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("way", [way for way in WAYS if way[1] == "P1"], ids=" ".join)
def test_prisms_have_the_energy_of_tets_in_affine_motions(way):
    """And the hourglass none; in others it has what tets' deformations are off their mean, wherever that is turned."""
    F = TURN.as_matrix() @ [[1.2, 0.1, 0.3], [0.0, 0.8, 0.1], [0.0, 0.2, 1.1]]
    on_tets = [terms.Strain(2.0, 1.05), terms.Volume(5.0, 1.1)]
    on_prisms = [*(replace(term, tets=PRISMS) for term in on_tets), terms.Hourglass(100.0, PRISMS)]
    by_prisms, by_tets = (energy_of(way, parts, lambda x: x @ F.T + 4.0) for parts in (on_prisms, on_tets))
    assert by_prisms == pytest.approx(by_tets, rel=1e-11)

    def bend(x):
        return x * [1.2, 0.9, 1.0] + 0.3 * np.sin(x[:, [1, 2, 0]])

    scene = Scene(X, TETS, on_prisms)
    away = terms.Cells.from_mesh(scene, np.arange(len(TETS))).deformation(bend(X))[PRISMS]
    away -= scene.prism_cells.deformation(bend(X))[:, None]
    left = 0.5 * np.sum(EACH[:, None] * scene.volumes[PRISMS] * np.sum(away**2, axis=(2, 3)))
    for parts in ([terms.Hourglass(EACH, PRISMS)], ON_PRISMS):
        energy = energy_of(way, parts, bend)
        assert energy == pytest.approx(left, rel=1e-11) if len(parts) == 1 else energy > left > 0.01
        assert energy_of(way, parts, lambda x: TURN.apply(bend(x)) + 4.0) == pytest.approx(energy, rel=1e-11)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("flat", "expected"), [([1, 1, 0], 0.25), ([0, 0, 0], 0.5)])
def test_flat_triangles_have_a_finite_energy_and_gradient(solver, flat, expected):
    """One lost side costs 1/4 of the area, two cost 1/2; a floor rounds the tip off by less than 1e-4."""
    side = meshes.triangles_at(X, TETS, 1, 0.0)
    discrete = DISCRETE[solver](Scene(X, TETS, [terms.SurfaceStrain(side, 0.5)]))
    place = discrete.at(discrete.nodes * flat)
    assert discrete.energy(place) == pytest.approx(AREA * expected, abs=AREA * 1e-4)
    assert np.isfinite(discrete.gradient(place)).all()


SHEETS = {cells: meshes.box((*cells, 1), (1.0, 1.0, 0.1)) for cells in ((6, 4), (20, 6), (24, 24), (40, 12))}


def sheet_of(cells):
    """A thin slab, its lower side, and that side's area at the vertices that bend."""
    points, tets = SHEETS[cells]
    triangles = meshes.triangles_at(points, tets, 2, 0.0)
    border = np.flatnonzero(((points[:, :2] == 0.0) | (points[:, :2] == 1.0)).any(axis=1))
    inner = (~np.isin(triangles, border)).sum(axis=1)
    return (points, tets), triangles, inner


def roll(points, radius=0.8):
    """The slab's lower side on a cylinder about an axis along y: its lengths are kept."""
    angle, from_axis = points[:, 0] / radius, radius - points[:, 2]
    return np.column_stack([from_axis * np.sin(angle), points[:, 1], radius - from_axis * np.cos(angle)])


def unroll(points, radius=0.8):
    across, from_axis = np.arctan2(points[:, 0], radius - points[:, 2]), np.hypot(points[:, 0], radius - points[:, 2])
    return np.column_stack([radius * across, points[:, 1], radius - from_axis])


def areas(points, triangles):
    sides = (points[triangles[:, k]] - points[triangles[:, 0]] for k in (1, 2))
    return np.linalg.norm(np.cross(*sides), axis=1) / 2


@pytest.mark.parametrize("solver", SOLVERS[:2])
@pytest.mark.parametrize("cells", [(20, 6), (40, 12)])
def test_rolling_a_flat_sheet_and_unrolling_a_cylinder(solver, cells):
    """The Laplacian of a cylinder's positions is its curvature 1/r, so E = k/2 area / r², up to (h/r)²/12 of it."""
    (points, tets), triangles, inner = sheet_of(cells)
    rolled, k, error = roll(points), 3.0, (1.0 / cells[0] / 0.8) ** 2 / 6
    rolling, unrolling = (0.5 * k * areas(at, triangles) @ inner / 3 / 0.8**2 for at in (points, rolled))
    way, bending = (solver, "P1"), terms.Bending(triangles, k)
    assert energy_of(way, [bending], roll, (points, tets)) == pytest.approx(rolling, rel=error)
    assert energy_of(way, [bending], unroll, (rolled, tets)) == pytest.approx(unrolling, rel=error)
    towards = terms.Bending(triangles, k, rest=rolled)
    assert energy_of(way, [towards], lambda x: x, (points, tets)) == pytest.approx(unrolling, rel=error)


@pytest.mark.parametrize("solver", SOLVERS[:2])
def test_a_dent_costs_twice_the_curvature(solver):
    """A shallow cap of a sphere: |Δx| = 2/r, and the other way round, 4/r off."""
    (points, tets), triangles, inner = sheet_of((24, 24))
    height = np.sqrt(25.0 - np.sum((points[:, :2] - 0.5) ** 2, axis=1))
    cap = np.column_stack([points[:, :2], height + points[:, 2]])
    dent = 0.5 * 2.0 * areas(cap, triangles) @ inner / 3 * (4 / 5.0) ** 2
    found = energy_of((solver, "P1"), [terms.Bending(triangles, 2.0)], lambda x: x * [1, 1, -1], (cap, tets))
    assert found == pytest.approx(dent, rel=0.02)


@pytest.mark.parametrize("solver", SOLVERS[:2])
def test_bending_stiffness_is_the_mean_over_triangles_and_terms_add_up(solver):
    """All inner vertices of this grid are alike but for the stiffness; a triangle counts a third at each corner."""
    mesh, triangles, inner = sheet_of((6, 4))
    stiffness = np.random.default_rng(0).uniform(1.0, 3.0, len(triangles))

    def rolled(*factors):
        parts = [terms.Bending(triangles, factor * stiffness) for factor in factors]
        return energy_of((solver, "P1"), parts, roll, mesh)

    assert rolled(0.5, 1.5) == pytest.approx(2 * rolled(1.0), rel=1e-13)
    even = energy_of((solver, "P1"), [terms.Bending(triangles, 1.0)], roll, mesh)
    assert rolled(1.0) == pytest.approx(even * (stiffness @ inner) / inner.sum(), rel=1e-12)


@pytest.mark.parametrize("scale", [[1, 1, 0], [1, 0, 0], [0, 0, 0]])
def test_a_collapsed_ring_has_a_finite_energy_and_gradient(scale):
    discrete = DISCRETE["projective"](Scene(X, TETS, [terms.Bending(SKIN, 1.0)]))
    place = discrete.at(X * scale)
    assert np.isfinite(discrete.energy(place)) and np.isfinite(discrete.gradient(place)).all()


def quadratic(solver, parts):
    return DISCRETE[solver](Scene(X, TETS, parts), "P2")


@pytest.mark.parametrize("solver", SOLVERS[1:])
def test_energy_of_a_quadratic_displacement(solver):
    """St. Venant-Kirchhoff's is then a polynomial of degree 4, which the rule integrates exactly; so do Gauss'."""
    law = materials.StVenantKirchhoff(1.3, 2.1)
    H = np.random.default_rng(0).normal(0.0, 0.07, (3, 3, 3))  # u_i = X · H_i X / 2
    discrete = quadratic(solver, [terms.Hyperelastic(law)])
    nodes = discrete.nodes
    place = discrete.at(nodes + np.einsum("ijk,nj,nk->ni", H, nodes, nodes) / 2)
    t, w = leggauss(3)
    t, w = 3.0 * (t + 1) / 2, 3.0 * w / 2
    expected = 0.0
    for at in np.ndindex(3, 3, 3):
        F = np.eye(3) + np.einsum("ijk,j->ik", (H + H.transpose(0, 2, 1)) / 2, t[list(at)])
        E = (F.T @ F - np.eye(3)) / 2
        expected += np.prod(w[list(at)]) * (law.mu * np.sum(E**2) + law.lmbda / 2 * np.trace(E) ** 2)
    assert discrete.energy(place) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("solver", SOLVERS[1:])
def test_membrane_of_a_quadratic_stretch(solver):
    """On u = (a x²/2, b y²/2, 0) the stretches of the top are 1 + a x and 1 + b y: w/2 (a² + b²)/3 L² per mm²."""
    discrete = quadratic(solver, [terms.SurfaceStrain(TOP, 3.0)])
    place = discrete.at(discrete.nodes + discrete.nodes**2 * np.array([0.4, 0.3, 0.0]) / 2)
    assert discrete.energy(place) == pytest.approx(AREA * 1.5 * (0.16 + 0.09) / 3 * 9.0, rel=1e-12)


@pytest.mark.parametrize("solver", SOLVERS)
def test_linear_loads_are_the_scenes(solver):
    scene = Scene(X, TETS, [terms.Strain(1.0), *LOADS])
    discrete = DISCRETE[solver](scene)
    vertices = [np.argmin(np.linalg.norm(X - node, axis=1)) for node in discrete.nodes]
    np.testing.assert_allclose(-discrete.forces(discrete.nodes), scene.loads()[vertices], rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("solver", SOLVERS[1:])
def test_quadratic_loads_work_on_quadratic_fields(solver):
    """On u = x² e: gravity's integral over the block and the traction's over its top, both a third of L² times it."""
    gravity, pull = terms.Gravity((0, 2.0, -3.0), density=2.0), terms.Traction(TOP, (0.5, 0.0, 4.0))
    for load, whole in ((gravity, BULK * np.array([0, 4.0, -6.0])), (pull, AREA * np.array([0.5, 0.0, 4.0]))):
        discrete = quadratic(solver, [terms.Strain(1.0), load])
        work = -(discrete.nodes[:, 0] ** 2) @ discrete.forces(discrete.nodes)
        np.testing.assert_allclose(work, whole / 3 * 9.0, atol=1e-11)
