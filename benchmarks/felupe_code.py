"""FElupe, one more independent finite-element code, on scenes of the neo-Hookean law with springs and held vertices.

FElupe (PyPI `felupe`) is under the GPL-3 and optional: it is used through its library where it is installed.
"""

from __future__ import annotations

import importlib.util
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import splu

from ..lhm.base.errors import MissingDependencyError, SceneError, SoftdecaError
from ..lhm.base.mesh import Floats, Ints
from ..reference import Scene, materials, terms

TOLERANCE = 1e-10
"""The residual's norm over that of the forces at held vertices, as FElupe counts it."""
MOST, STEPS = 30, 4
"""Iterations of a step of the load, and such steps."""


def installed() -> bool:
    """Whether FElupe is there."""
    return importlib.util.find_spec("felupe") is not None


def solved(scene: Scene) -> tuple[Floats, int]:
    """Positions [mm], shape (n, 3), by FElupe's elements, law and Newton's method from rest, and its iterations.

    Raises MissingDependencyError without FElupe, SceneError for a term that is not modelled here, and SoftdecaError
    where it does not converge.
    """
    if not installed():
        raise MissingDependencyError("FElupe is not installed (softdeca[bench])")
    import felupe

    bodies, springs = _parts(scene)
    field = _field(felupe, scene.vertices, scene.tets)
    # A body of its own for each term: FElupe links their fields, which have the same vertices.
    items: list[Any] = [
        felupe.SolidBody(felupe.NeoHookeCompressible(law.mu, law.lmbda), _field(felupe, scene.vertices, tets))
        for law, tets in bodies
    ]
    items += [_Springs(field, each) for each in springs]
    held, places = scene.dirichlet()
    loose = np.setdiff1d(np.arange(len(scene.vertices)), scene.tets)
    fixed = held.copy()
    fixed[loose] = True
    dof0 = np.flatnonzero(fixed.ravel())
    dof1 = np.flatnonzero(~fixed.ravel())
    target = np.where(held, places - scene.vertices, 0.0).ravel()[dof0]
    iterations = 0
    for step in range(1, STEPS + 1):
        # FElupe takes whole steps of Newton's: in one go they turn tets inside out, where the law is infinite.
        for each in items[len(bodies) :]:
            each.share = step / STEPS
        found = felupe.newtonraphson(
            items=items, x0=field, dof0=dof0, dof1=dof1, ext0=target * step / STEPS, tol=TOLERANCE, maxiter=MOST,
            solver=_solve, verbose=0,
        )  # fmt: skip
        if not found.success:
            raise SoftdecaError(f"FElupe: step {step} of {STEPS} not converged after {MOST} iterations")
        field, iterations = found.x, iterations + int(found.iterations)
    return scene.vertices + field[0].values, iterations


def _field(felupe: Any, vertices: Floats, tets: Ints) -> Any:
    return felupe.FieldContainer([felupe.Field(felupe.RegionTetra(felupe.Mesh(vertices, tets, "tetra")), dim=3)])


def _solve(matrix: Any, right: Floats) -> Floats:
    # Symmetric: a quarter of the fill of the order that SciPy takes by itself.
    return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(right.ravel())


def _parts(scene: Scene) -> tuple[list[tuple[materials.NeoHookean, Ints]], list[terms.Target]]:
    """Each law with its tets (k, 4), and the springs."""
    for term in scene.terms:
        if not isinstance(term, (terms.Hyperelastic, terms.Target, terms.Fixed)):
            raise SceneError(f"FElupe: {type(term).__name__} is not modelled here")
    bodies = []
    for solid in scene.of(terms.Hyperelastic):
        if not isinstance(solid.material, materials.NeoHookean) or np.any(solid.growth != 1.0):
            raise SceneError(f"FElupe: {solid.material.name} with growth {solid.growth} is not modelled here")
        bodies.append((solid.material, scene.tets[scene.tets_of(solid)]))
    return bodies, list(scene.of(terms.Target))


class _Springs:
    """A Target as an item of FElupe: stiffness (target - x) at each of its vertices, `share` of the way there."""

    def __init__(self, field: Any, target: terms.Target):
        self.field = field
        self.results = SimpleNamespace(update_statevars=lambda: None)
        self.assemble = SimpleNamespace(vector=self._vector, matrix=self._matrix, multiplier=None)
        n = field[0].values.size
        k = np.zeros((n // 3, 3))
        np.add.at(k, target.vertices, np.broadcast_to(np.reshape(target.stiffness, (-1, 1)), target.positions.shape))
        sought = np.zeros((n // 3, 3))
        sought[target.vertices] = target.positions
        self.share = 1.0
        self._k, self._away = k.ravel(), (sought - field.region.mesh.points).ravel()

    def _vector(self, field: Any = None, **_: Any) -> csr_matrix:
        u = (self.field if field is None else field)[0].values.ravel()
        return csr_matrix((self._k * (u - self.share * self._away)).reshape(-1, 1))

    def _matrix(self, field: Any = None, **_: Any) -> csr_matrix:
        return diags(self._k).tocsr()
