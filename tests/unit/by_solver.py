"""One face of the three solvers, for tests that ask the same of each: unknowns, energy and its derivatives, nodes."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from softdeca.reference import MissingDependencyError, prepare, solve, terms

SOLVERS = ("projective", "fenicsx", "skfem")
ELEMENTS = (("fenicsx", "P1"), ("fenicsx", "P2"), ("skfem", "P1"), ("skfem", "P2"))
WAYS = (("projective", "P1"), *ELEMENTS)


def element_options(solver, element):
    """The option of `solve` that chooses an element; projective dynamics has linear tets alone."""
    return {} if solver == "projective" else {"element": element}


def prepare_by(solver, scene, **options):
    """A prepared scene; skips where the solver is not installed."""
    try:
        return prepare(scene, solver=solver, **options)
    except MissingDependencyError as missing:
        pytest.skip(str(missing))


def solve_by(solver, scene, *, tolerance=1e-11, **options):
    """The answer, as exact as asked or as rounding allows; skips where the solver is not installed."""
    try:
        answer = solve(scene, solver=solver, tolerance=tolerance, **options)
    except MissingDependencyError as missing:
        pytest.skip(str(missing))
    assert answer.is_balanced, answer.reason
    return answer


def dense(matrix):
    """A matrix of PETSc as an array."""
    indptr, columns, values = matrix.getValuesCSR()
    return csr_matrix((values, columns, indptr), matrix.size).toarray()


def projective_hessian(prepared, place, least=-1.0):
    """Projective dynamics' Hessian as an array: exact, or with no eigenvalue of an element below 0."""
    from softdeca.reference.projective.hessian.tangent import hessian
    from softdeca.reference.projective.unknowns.sparsity import Sparsity

    scene, energy, coordinates = prepared.scene, prepared.energy, prepared.system.coordinates
    sparsity = Sparsity.from_scene(scene, energy.parts, coordinates)
    return hessian(scene, energy, coordinates, sparsity, place, least=least).toarray()


class Projective:
    """Projective dynamics: free components, then six unknowns of each body."""

    def __init__(self, scene, element="P1"):
        assert element == "P1"
        self.prepared = prepare(scene)
        self.coordinates = self.prepared.system.coordinates
        self.size, self.nodes = self.coordinates.size, scene.vertices
        self.start = self.coordinates.start(np.zeros_like(scene.vertices))

    def at(self, positions):
        """The place at positions [mm] by vertex."""
        return self.coordinates.start(positions - self.nodes)

    def forces(self, positions):
        """The gradient by vertex."""
        return self.prepared.energy.evaluate(positions - self.nodes)[1]

    def move(self, place, step):
        return self.coordinates.move(place, step)

    def energy(self, place):
        return self.prepared.energy.evaluate(place.u)[0]

    def gradient(self, place):
        return self.coordinates.pull(self.prepared.energy.evaluate(place.u)[1], place)

    def hessian(self, place):
        return projective_hessian(self.prepared, place)

    def projected_hessian(self, place):
        return projective_hessian(self.prepared, place, least=0.0)


class Fenicsx:
    """FEniCSx: the components of all free nodes, then six unknowns of each body; nothing is held."""

    def __init__(self, scene, element="P1"):
        pytest.importorskip("dolfinx")
        from softdeca.reference.fenicsx.linear.problem import DiscreteProblem
        from softdeca.reference.fenicsx.mesh.numbering import DEGREE_OF, Numbering
        from softdeca.reference.fenicsx.strategies.bodies import RigidProblem

        self.order = Numbering(scene, DEGREE_OF[element])
        self.problem, self.nodes = DiscreteProblem(scene, self.order), self.order.X
        poses = ()
        if scene.of(terms.RigidBody):
            self.problem = RigidProblem(scene, self.order, self.problem)
            poses = (self.problem.rest(),)
        self.start = self.problem.at(np.zeros_like(self.order.X), *poses)
        self.size = self.start.gradient().size

    def move(self, state, step):
        return self.problem.moved(state, step)

    def energy(self, state):
        return state.energy

    def gradient(self, state):
        return state.gradient().ravel()

    def hessian(self, state):
        return dense(state.hessian())

    def projected_hessian(self, state):
        return dense(state.hessian(0.0))

    def at(self, positions):
        """The state at positions [mm] by node."""
        return self.problem.at(positions - self.order.X)

    def forces(self, positions):
        """The gradient by node."""
        return self.at(positions).gradient()

    def face_nodes(self, triangles):
        return self.order.face_dofs("faces", triangles)

    def held(self, vertices):
        return self.order.held(vertices)


class Skfem:
    """scikit-fem: degrees of freedom of all free nodes, then six unknowns of each body; nothing is held."""

    def __init__(self, scene, element="P1"):
        from softdeca.reference.skfem.discretisation import Discretisation
        from softdeca.reference.skfem.energy import Energy
        from softdeca.reference.skfem.unknowns import Body, Unknowns

        self.discretisation = Discretisation(scene, element)
        self._energy, bodies = Energy(scene, self.discretisation), Body.from_scene(scene, self.discretisation)
        self.start = self.discretisation.by_dof(scene.vertices)
        self.nodes = self.start[self.discretisation.dofs]
        of_bodies = [body.dofs.ravel() for body in bodies]
        free = np.setdiff1d(np.arange(self.discretisation.size), np.concatenate([*of_bodies, np.zeros(0, dtype=int)]))
        self.unknowns = Unknowns(free, self.discretisation.size, bodies)
        self.size = self.unknowns.count

    def move(self, x, step):
        return self.unknowns.move(x, step)

    def energy(self, x):
        return self._energy.value(x)

    def gradient(self, x):
        return self.unknowns.gradient(x, self._energy.gradient(x))

    def hessian(self, x):
        return self.unknowns.hessian(x, self._energy.gradient(x), self._energy.exact_hessian(x)).toarray()

    def projected_hessian(self, x):
        matrix = self._energy.projected_hessian(x)
        return self.unknowns.projected_hessian(x, self._energy.gradient(x), matrix).toarray()

    def at(self, positions):
        """Positions [mm] by node as degrees of freedom."""
        x = np.empty(self.discretisation.size)
        x[self.discretisation.dofs] = positions
        return x

    def forces(self, positions):
        """The gradient by node."""
        return self._energy.gradient(self.at(positions))[self.discretisation.dofs]

    def face_nodes(self, triangles):
        return self.discretisation.nodes_of("faces", triangles)

    def held(self, vertices):
        return self.discretisation.held_dofs(vertices)[self.discretisation.dofs]


DISCRETE = {"projective": Projective, "fenicsx": Fenicsx, "skfem": Skfem}
